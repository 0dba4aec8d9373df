"""Run the simulated robot alone: ``python -m crtk_sim_backends.ros2_control --joints a,b,c``."""

import sys

from crtk_sim_backends.ros2_control import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
