"""Run a simulated force sensor alone: ``python -m crtk_sim_backends.robotiq.ft300``."""

import sys

from crtk_sim_backends.robotiq.ft300 import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
