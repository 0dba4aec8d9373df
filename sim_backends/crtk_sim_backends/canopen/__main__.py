"""Run simulated CANopen drives alone: ``python -m crtk_sim_backends.canopen --nodes 6``."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from crtk_sim_backends import command_line
from crtk_sim_backends.canopen import SIM, ConfigError, SimConfig


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until stopped; 0 when that went well, 1 when it could not start."""
    program = "python -m crtk_sim_backends.canopen"
    return command_line.main(arguments, program, SIM.summary, SimConfig, SIM.run, ConfigError)


if __name__ == "__main__":
    sys.exit(main())
