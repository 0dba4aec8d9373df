"""Run a simulated scale alone: ``python -m crtk_sim_sartorius``."""

import sys

from crtk_sim_sartorius import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
