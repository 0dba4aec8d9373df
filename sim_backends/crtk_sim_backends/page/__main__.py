"""Run the server of the page: ``python -m crtk_sim_backends.page 127.0.0.2:40001``."""

import sys

from crtk_sim_backends.page.server import main

if __name__ == "__main__":
    sys.exit(main())
