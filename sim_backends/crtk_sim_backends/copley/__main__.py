"""Run simulated Copley drives alone: ``python -m crtk_sim_backends.copley``."""

import sys

from crtk_sim_backends.copley import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
