"""Run a simulated Touch alone: ``python -m crtk_sim_backends.openhaptics``."""

import sys

from crtk_sim_backends.openhaptics import SIM

if __name__ == "__main__":
    sys.exit(SIM.main())
