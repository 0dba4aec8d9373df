"""Run the simulated controller alone: ``python -m crtk_sim_backends.ur --model ur10e``."""

import sys

from crtk_sim_backends.ur import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
