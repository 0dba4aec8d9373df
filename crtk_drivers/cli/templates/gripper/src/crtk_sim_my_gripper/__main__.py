"""Run a simulated gripper alone: ``python -m crtk_sim_my_gripper``."""

import sys

from crtk_sim_my_gripper import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
