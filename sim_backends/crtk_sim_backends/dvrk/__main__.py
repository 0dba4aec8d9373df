"""Run a simulated dVRK controller alone: ``python -m crtk_sim_backends.dvrk``."""

import sys

from crtk_sim_backends.dvrk import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
