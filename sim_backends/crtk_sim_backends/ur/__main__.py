"""Run the simulated controller alone: ``python -m crtk_sim_backends.ur --model ur10e``."""

from __future__ import annotations

import argparse
import dataclasses
import logging
import sys
from collections.abc import Sequence

from crtk_sim_backends.process import Readiness, SimStartError
from crtk_sim_backends.ur import SIM, ConfigError, SimConfig


def parser() -> argparse.ArgumentParser:
    """Build the command line from the fields of :class:`SimConfig`."""
    result = argparse.ArgumentParser(prog="python -m crtk_sim_backends.ur", description=SIM.summary)
    for entry in dataclasses.fields(SimConfig):
        flag = "--" + entry.name.replace("_", "-")
        description = f"{entry.metadata['help']} (default: {_readable(entry.default)})"
        if isinstance(entry.default, bool):
            result.add_argument(
                flag,
                action=argparse.BooleanOptionalAction,
                default=entry.default,
                help=description,
            )
        else:
            result.add_argument(
                flag,
                type=type(entry.default),
                default=entry.default,
                choices=entry.metadata["choices"] or None,
                help=description,
            )
    result.add_argument("--verbose", action="store_true", help="log connections and faults")
    for pipe in ("--ready-fd", "--parent-fd"):
        result.add_argument(pipe, type=int, default=None, help=argparse.SUPPRESS)
    return result


def _readable(default: object) -> object:
    if isinstance(default, bool):
        return "yes" if default else "no"
    return "none" if default == "" else default


def main(arguments: Sequence[str] | None = None) -> int:
    """Run until stopped; 0 when that went well, 1 when it could not start."""
    options = vars(parser().parse_args(arguments))
    readiness = Readiness(options.pop("ready_fd"), options.pop("parent_fd"))
    level = logging.INFO if options.pop("verbose") else logging.WARNING
    logging.basicConfig(level=level, format="%(name)s: %(message)s")
    spawned = readiness.parent_fd is not None
    try:
        return SIM.run(
            SimConfig(**options),
            report=logging.info if spawned else lambda line: print(line, flush=True),  # noqa: T201
            readiness=readiness,
        )
    except (ConfigError, SimStartError) as error:
        readiness.tell(error=str(error))
        if not spawned:
            print(error, file=sys.stderr)  # noqa: T201
        return 1


if __name__ == "__main__":
    sys.exit(main())
