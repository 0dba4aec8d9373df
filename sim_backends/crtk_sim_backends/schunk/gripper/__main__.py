"""Run a simulated gripper alone: ``python -m crtk_sim_backends.schunk.gripper``."""

import sys

from crtk_sim_backends.schunk.gripper import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
