"""Run a simulated Galil controller alone: ``python -m crtk_sim_backends.galil``."""

import sys

from crtk_sim_backends.galil import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
