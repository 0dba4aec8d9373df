"""A simulator's options as a command line, from the fields of its configuration.

The fields are made by :func:`crtk_sim_backends.options.option`.
"""

from __future__ import annotations

import argparse
import dataclasses
import logging
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from crtk_sim_backends.child_log import FORMAT
from crtk_sim_backends.process import Readiness


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


def parse(
    arguments: Sequence[str] | None, program: str, summary: str, config: type[Any]
) -> tuple[dict[str, Any], Readiness]:
    """Read a command line, those of this process when None, and set up logging as it says.

    Returns:
        Values for `config`, and the pipes to the parent process.
    """
    chosen = vars(parser(program, summary, config).parse_args(arguments))
    readiness = Readiness(chosen.pop("ready_fd"), chosen.pop("parent_fd"))
    level = logging.INFO if chosen.pop("verbose") else logging.WARNING
    logging.basicConfig(level=level, format=FORMAT)
    return chosen, readiness


def tell(line: object, to: Any = None) -> None:
    """Write a line to standard output, or elsewhere."""
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
