"""Run simulated pedals, joystick and mouse alone: ``python -m crtk_sim_backends.inputs``."""

import sys

from crtk_sim_backends.inputs import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
