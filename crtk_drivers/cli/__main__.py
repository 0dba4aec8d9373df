"""``python -m crtk_drivers.cli``: the same as ``crtk-driver``."""

import sys

from crtk_drivers.cli import main

sys.exit(main())
