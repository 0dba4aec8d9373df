"""Run a simulated Raven alone: ``python -m crtk_sim_backends.raven``."""

import sys

from crtk_sim_backends.raven import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
