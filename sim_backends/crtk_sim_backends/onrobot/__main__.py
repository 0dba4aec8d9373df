"""Run a simulated gripper alone: ``python -m crtk_sim_backends.onrobot``."""

import sys

from crtk_sim_backends.onrobot import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
