"""Run a simulated stage alone: ``python -m crtk_sim_one_axis --port 7890``."""

import sys

from crtk_sim_one_axis import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
