"""Run a simulated Force Dimension device alone: ``python -m crtk_sim_backends.force_dimension``."""

import sys

from crtk_sim_backends.force_dimension import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
