"""Run a simulated Inverse service alone: ``python -m crtk_sim_backends.haply``."""

import sys

from crtk_sim_backends.haply import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
