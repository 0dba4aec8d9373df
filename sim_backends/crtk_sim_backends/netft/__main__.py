"""Run the simulated sensor box alone: ``python -m crtk_sim_backends.netft --preset mini45``."""

import sys

from crtk_sim_backends.netft import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
