"""What the commands that use a running device share: how it is found, and how an interrupt stops it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.terminal import ERR, plain
from crtk_drivers.errors import ConfigError
from crtk_drivers.ros import environment

if TYPE_CHECKING:
    from crtk_drivers.client import RemoteDevice

Namespace = Annotated[
    str,
    typer.Argument(metavar="NAMESPACE", help="Of the device: /ur5.", show_default=False),
]
Timeout = Annotated[
    float,
    typer.Option(
        "--timeout", metavar="SECONDS", min=0.1, help="Longest time to find the device, in s."
    ),
]
FIND_TIMEOUT = 5.0
"""Seconds in which a device that runs is found: three when DDS loses the first exchange, and some more."""

INTERRUPTED = 130
"""The exit code after Ctrl-C, as of any program that a signal ends."""
STOP_TIMEOUT = 5.0
"""Seconds to wait after `hold` for the device to stand."""


class Interrupted(BaseException):
    """The user, or the system, wants an end. No `Exception`: nothing on the way may handle it."""


def prepare() -> None:
    """Make ready to use ROS 2 from this process.

    Raises:
        MissingExtra, ConfigError: it cannot be used here.
    """
    set_up_logging(ERR, "warning", LogFormat.TEXT)
    environment.check()
    environment.share_no_memory()


@contextmanager
def reached(namespace: str, timeout: float, child: str = "") -> Iterator[RemoteDevice]:
    """The device in a namespace, or in the sub-namespace `child` of it.

    Raises:
        MissingExtra, ConfigError: ROS 2 cannot be used here, or that is no namespace.
        ConnectionFailed: there is none; says which there are.
    """
    from crtk_drivers.client import connect  # not needed to show a help

    prepare()
    with ERR.status(f"looking for {plain(namespace)} ..."):
        device = connect(namespace, timeout=timeout)
    with device:
        yield device.child(child) if child else device


def need(device: RemoteDevice, name: str) -> None:
    """Make sure that a device offers a CRTK name, and set it up.

    Raises:
        ConfigError: it does not; says what it offers.
        ConnectionFailed: it does, and nobody is at the other end.
    """
    offered = device.crtk_commands
    if name not in offered:
        raise ConfigError(
            f"does not offer {name}",
            where=device.namespace,
            remedy=f"It offers: {', '.join(offered) or 'nothing'}.",
        )
    device.add(name)


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGINT, SIGTERM and SIGHUP raise `Interrupted` within; after the first they are ignored."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        raise Interrupted

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        for number in numbers:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held_when_interrupted(device: RemoteDevice) -> Iterator[None]:
    """Hold the device at Ctrl-C, SIGTERM or SIGHUP, and end this program.

    The topic `hold` is set up beforehand: nothing has to be found when it is needed.
    """
    need(device, "hold")
    with interruptible():
        try:
            yield
        except Interrupted:
            device.hold()
            stands = device.wait_for_busy(False, STOP_TIMEOUT)
            how = "and stands" if stands else f"and was not seen to stand in {STOP_TIMEOUT:g} s"
            ERR.print(f"[yellow]interrupted:[/] {plain(device.namespace)} was told to hold, {how}")
            raise typer.Exit(INTERRUPTED) from None
