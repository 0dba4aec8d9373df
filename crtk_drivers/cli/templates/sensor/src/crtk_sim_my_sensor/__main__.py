"""Run a simulated sensor alone: ``python -m crtk_sim_my_sensor``."""

import sys

from crtk_sim_my_sensor import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
