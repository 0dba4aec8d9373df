"""Run simulated buses alone: ``python -m crtk_sim_backends.dynamixel --servos koch``."""

import sys

from crtk_sim_backends.dynamixel import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
