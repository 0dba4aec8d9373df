"""Run a simulated gripper alone: ``python -m crtk_sim_backends.robotiq``."""

import sys

from crtk_sim_backends.robotiq import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
