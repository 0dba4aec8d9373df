"""Run the simulated tracker alone: ``python -m crtk_sim_backends.ndi --family aurora``."""

import sys

from crtk_sim_backends.ndi import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
