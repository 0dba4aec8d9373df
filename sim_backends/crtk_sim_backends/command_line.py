"""A simulator's options as a command line, from the fields of its configuration, and its process.

The configuration is a dataclass whose fields have a default, ``metadata["help"]``, and perhaps
``metadata["choices"]``. ``python -m <simulator>`` calls :func:`main`; :func:`flags` gives the
arguments for :func:`crtk_sim_backends.process.spawn`.
"""

from __future__ import annotations

import argparse
import dataclasses
import logging
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from crtk_sim_backends.process import Readiness, SimStartError


def flags(config: Any) -> list[str]:
    """Return the arguments for a configuration."""
    arguments = []
    for entry in dataclasses.fields(config):
        value = getattr(config, entry.name)
        flag = "--" + entry.name.replace("_", "-")
        if isinstance(value, bool):
            arguments.append(flag if value else "--no-" + flag.removeprefix("--"))
        else:
            arguments.append(f"{flag}={value}")
    return arguments


def parser(program: str, summary: str, config: type[Any]) -> argparse.ArgumentParser:
    """Return the parser for the options of a configuration."""
    result = argparse.ArgumentParser(prog=program, description=summary)
    for entry in dataclasses.fields(config):
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
                choices=entry.metadata.get("choices") or None,
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


def main(
    arguments: Sequence[str] | None,
    program: str,
    summary: str,
    config: type[Any],
    run: Callable[..., int],
    wrong_config: type[Exception],
) -> int:
    """Run a simulator until it is stopped; 0 when that went well, 1 when it could not start.

    Args:
        arguments: of the command line; those of this process when None.
        program: name for the help.
        summary: one line for the help.
        config: the dataclass of its options.
        run: runs it, given the configuration, `report` and `readiness`.
        wrong_config: what `config` raises.
    """
    options = vars(parser(program, summary, config).parse_args(arguments))
    readiness = Readiness(options.pop("ready_fd"), options.pop("parent_fd"))
    level = logging.INFO if options.pop("verbose") else logging.WARNING
    logging.basicConfig(level=level, format="%(name)s: %(message)s")
    spawned = readiness.parent_fd is not None
    try:
        return run(
            config(**options),
            report=logging.info if spawned else _tell,
            readiness=readiness,
        )
    except (wrong_config, SimStartError) as error:
        readiness.tell(error=str(error))
        if not spawned:
            _tell(error, sys.stderr)
        return 1


def _tell(line: object, to: Any = None) -> None:
    print(line, file=to, flush=True)


@contextmanager
def stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on SIGINT and SIGTERM; elsewhere than in the main thread do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, lambda *_: stop()) for number in signals]
    try:
        yield
    finally:
        for number, handler in zip(signals, previous, strict=True):
            signal.signal(number, handler)
