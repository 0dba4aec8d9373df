"""Run a virtual CAN bus alone: ``python -m crtk_sim_backends.can --bitrate 1000000``."""

import sys

from crtk_sim_backends.can import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
