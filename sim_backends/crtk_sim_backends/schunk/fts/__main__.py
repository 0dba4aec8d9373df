"""Run a simulated FTS alone: ``python -m crtk_sim_backends.schunk.fts``."""

import sys

from crtk_sim_backends.schunk.fts import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
