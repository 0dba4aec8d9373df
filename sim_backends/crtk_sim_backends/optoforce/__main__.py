"""Run a simulated force sensor alone: ``python -m crtk_sim_backends.optoforce``."""

import sys

from crtk_sim_backends.optoforce import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
