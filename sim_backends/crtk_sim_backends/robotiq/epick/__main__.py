"""Run a simulated vacuum gripper alone: ``python -m crtk_sim_backends.robotiq.epick``."""

import sys

from crtk_sim_backends.robotiq.epick import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
