"""Run a simulated arm alone: ``python -m crtk_sim_my_arm``."""

import sys

from crtk_sim_my_arm import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
