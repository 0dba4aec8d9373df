"""Run simulated CANopen drives alone: ``python -m crtk_sim_backends.canopen --nodes 6``."""

import sys

from crtk_sim_backends.canopen import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
