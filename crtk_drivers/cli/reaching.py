"""What the commands that use a running device share: how it is found, and how an interrupt stops it."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import zip_longest
from types import FrameType
from typing import TYPE_CHECKING, Annotated

import typer

from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.terminal import ERR, plain
from crtk_drivers.errors import ConfigError, CrtkError
from crtk_drivers.ros import environment
from crtk_drivers.status.stop_request import INTERRUPTED, StopRequest

if TYPE_CHECKING:
    from crtk_drivers.client import RemoteDevice
    from crtk_drivers.samples import JointState, Pose

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

STOP_TIMEOUT = 5.0
"""Seconds to wait after `hold` for the device to stand."""
STILL = 1e-3
"""rad or m by which what stands seems to move in `STILL_TIME`."""
STILL_TIME = 0.5
"""Seconds in which it is seen to stay where it is: what goes by 2 mm/s moves."""
LOOK_PERIOD = 0.01


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
def interruptible() -> Iterator[StopRequest]:
    """Let SIGINT, SIGTERM and SIGHUP raise `Interrupted` within; after the first they are ignored.

    The request that it gives is set, too, and a loop looks at it: the exception is lost where it is raised in
    Python code that a library calls from C, as rclpy does to make a message, or the collector of garbage.
    """
    asked = StopRequest()

    def interrupt(number: int, frame: FrameType | None) -> None:
        for each in before:
            signal.signal(each, signal.SIG_IGN)
        asked.set()
        raise Interrupted

    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    try:
        for number in numbers:
            signal.signal(number, interrupt)
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def held_when_interrupted(device: RemoteDevice) -> Iterator[Callable[[], None]]:
    """Hold the device at Ctrl-C, SIGTERM or SIGHUP, or where something unexpected ends this program.

    A loop calls what it gives, which raises what was lost: see `interruptible`. The topics are set up
    beforehand: nothing has to be found when it is needed.
    """
    for name in ("hold", *filter(None, (place_of(device),))):
        need(device, name)
    with interruptible() as asked:

        def heed() -> None:
            if asked.is_set():
                raise Interrupted

        try:
            yield heed
        except Interrupted:
            device.hold()
            stands = is_seen_to_stand(device, STOP_TIMEOUT)
            how = "stands still" if stands else f"was not seen to stand in {STOP_TIMEOUT:g} s"
            name = plain(device.namespace)
            ERR.print(f"[yellow]interrupted:[/] hold was sent to {name}, and it {how}")
            raise typer.Exit(INTERRUPTED) from None
        except CrtkError:
            raise  # it says what has become of the motion, which may be another client's by now
        except BaseException:
            device.hold()  # the motion goes on, and nobody looks at it any more
            raise


def is_seen_to_stand(device: RemoteDevice, timeout: float) -> bool:
    """Return whether a device that was told to hold is seen to stand; see `why_not_standing`."""
    return not why_not_standing(device, timeout)


def why_not_standing(device: RemoteDevice, timeout: float, *, has_state: bool = True) -> str:
    """Return "" once a device that was told to hold is not busy, and tells anew that it stays where it is.

    Not to be busy says nothing of a stream: none makes a device busy. One that tells no place is believed.

    Args:
        device: that was told to hold.
        timeout: in seconds.
        has_state: it has an operating state, and may be busy.

    Returns:
        What is wrong otherwise, in words.
    """
    deadline = time.monotonic() + timeout
    if has_state and not device.wait_for_busy(False, timeout):
        return "it is still busy"
    name = place_of(device)
    if not name:
        return ""
    units = units_by_joint(device)
    rest: list[float] = []
    since = first = 0.0
    while time.monotonic() < deadline:
        try:
            value, stamp = getattr(device, name)(extra=True)
        except CrtkError as error:
            return error.message
        place, now = [*_place_in(value, units)], time.monotonic()
        pairs = list(zip(place, rest, strict=False))
        if not pairs or not all(abs(one - other) <= STILL for one, other in pairs):
            rest, since, first = place, now, stamp
        elif now - since >= STILL_TIME and stamp != first:
            return ""
        time.sleep(LOOK_PERIOD)
    return f"{name} still changes"


def units_by_joint(device: RemoteDevice) -> dict[str, str]:
    """Return the unit of each joint's position by its name, as the manifest has it; empty: not known."""
    joints = device.manifest.get("joints", ())
    return {each["name"]: each.get("unit", "") for each in joints}


def _place_in(value: JointState | Pose, units: Mapping[str, str]) -> Iterator[float]:
    """Yield the numbers that stay the same while a device stands: a vacuum in Pa need not."""
    if hasattr(value, "orientation"):
        yield from (*value.position, *value.orientation)
        return
    positions = value.position.tolist()
    for name, position in zip_longest(value.name[: len(positions)], positions):
        if units.get(name, "") in ("rad", "m", ""):
            yield position


def place_of(device: RemoteDevice) -> str:
    """Return the CRTK name by which a device tells where it is; empty if it does not."""
    told = device.crtk_commands
    return next((name for name in ("measured_js", "measured_cp") if name in told), "")
