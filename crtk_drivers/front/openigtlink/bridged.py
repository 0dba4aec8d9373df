"""A device as OpenIGTLink sees it: what it tells and takes, by the names of messages."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from crtk_drivers.commands import Command, Direction, Level, Payload
from crtk_drivers.errors import ConfigError, ConnectionLost, CrtkError, DataTimeout
from crtk_drivers.front.base import DeviceFront
from crtk_drivers.front.openigtlink.bodies import NAME, STATUS, StatusBody
from crtk_drivers.front.openigtlink.codec import Message
from crtk_drivers.front.openigtlink.message_values import METRES, TOLD, body_of, is_taken
from crtk_drivers.front.openigtlink.peer_streams import Ownership
from crtk_drivers.state import OperatingState, StateCommand

ERROR: Final = "error"
"""Under this name of a device refusals are told, as sawOpenIGTLink does."""

HOME_BEGINS: Final = 1.0
"""Seconds in which a device that was told to go home is seen to be busy."""

OVERTAKEN: Final = 0.5
"""Seconds after a command in which a `hold` may arrive at the device before it."""

_CODES: Final[Mapping[OperatingState, str]] = {
    OperatingState.ENABLED: "ok",
    OperatingState.DISABLED: "disabled",
    OperatingState.PAUSED: "manual mode",
    OperatingState.FAULT: "hardware failure",
}


def method(front: Any, name: str) -> Callable[..., Any]:
    """Return the method of a CRTK name, which may be in a sub-namespace."""
    for part in name.split("/"):
        front = getattr(front, part)
    found: Callable[..., Any] = front
    return found


def starter(front: Any, name: str, command: Command) -> Callable[..., Any]:
    """Return what sends a command, and does not wait whether a move is accepted: `hold` may come next."""
    place, _, last = name.rpartition("/")
    owner: Any = method(front, place) if place else front
    if command.level is Level.MOVE and hasattr(type(owner), "starter"):
        found: Callable[..., Any] = owner.starter(last)
        return found
    return method(owner, last)


class Feed:
    """One value that a device tells again and again.

    Args:
        front: the device.
        name: in CRTK.
        device: in OpenIGTLink.
        scale: of lengths of poses.
    """

    def __init__(self, front: Any, name: str, device: str, scale: float) -> None:
        self.name = name
        self.device = device
        self._read = method(front, name)
        self._scale = scale
        self._told = 0.0

    def newest(self) -> Message | None:
        """Return the newest value; None if it was told already, is not valid, or there is none."""
        try:
            value, stamp = self._read(age=0.0, wait=0.0, extra=True)
        except (DataTimeout, ConnectionLost):
            return None
        if not stamp or stamp == self._told:
            return None
        self._told = stamp
        metadata = {"unit": "m" if self._scale == METRES else "mm"}
        if frame := getattr(value, "frame_id", ""):
            metadata["frame_id"] = frame
        return Message(
            self.device, body_of(value, self._scale), stamp_ns=round(stamp * 1e9), metadata=metadata
        )


class BridgedDevice:
    """One device.

    Args:
        name: of it in OpenIGTLink: its messages are ``name/measured_cp``, ...
        front: of it, in this process or on the far side of ROS.
        scale: of lengths of poses.
        only: the CRTK names that are told, if it has them; None: all, but none in a sub-namespace.
        takes: whether it can be commanded.

    Attributes:
        name: as given.
        front: as given.
        tells: the CRTK names that it could tell.
        feeds: what it tells.
        commands: what it takes, by the names of messages.
        senders: the methods of these, by their CRTK names: set up now, so that the first does not wait.
        ownership: who moves it.
        begun: when (monotonic, s) it was sent a command last, other than `hold`.

    Raises:
        ConfigError: a name that has no room in a message.
    """

    def __init__(
        self,
        name: str,
        front: DeviceFront,
        scale: float,
        only: Iterable[str] | None = None,
        takes: bool = True,
    ) -> None:
        self.name = name
        self.front = front
        self.ownership = Ownership(name)
        self.begun = -math.inf
        self._homing: tuple[object, float] | None = None
        offered = front.crtk_commands
        self.tells = tuple(each for each, command in offered.items() if _is_told(command))
        wanted = [each for each in self.tells if "/" not in each] if only is None else only
        chosen = [each for each in wanted if each in self.tells]
        names = {each: _message_name(name, offered[each]) for each in chosen}
        for message in (*names.values(), f"{name}/{ERROR}"):
            _check_room(message)
        self.feeds = tuple(Feed(front, each, message, scale) for each, message in names.items())
        self.commands = {
            f"{name}/{each}": command
            for each, command in offered.items()
            if takes and _is_command(command) and len(f"{name}/{each}") <= NAME
        }

        self.senders = {
            command.name: starter(front, command.name, command)
            for command in self.commands.values()
        }

    def began(self, peer: object, command: Command, value: object) -> None:
        """A command of a peer was sent on: by the next one it is forgotten whose `home` it was."""
        if command.name != "hold":
            self.begun = time.monotonic()
        homes = command.name == "state_command" and value == StateCommand.HOME
        self._homing = (peer, time.monotonic()) if homes else None

    def hold(self) -> None:
        """Hold, and again after what was sent just before: nothing keeps the order of two topics."""
        self.senders["hold"]()
        if time.monotonic() - self.begun < OVERTAKEN:
            self.senders["hold"]()

    def stops_homing(self, peer: object) -> bool:
        """Forget a peer that is gone; return whether the device goes home because it said so."""
        homing = self._homing
        if homing is None or homing[0] is not peer:
            return False
        self._homing = None
        if time.monotonic() - homing[1] < HOME_BEGINS:
            return True
        try:
            return self.front.is_busy()
        except CrtkError:
            return True

    def status(self) -> StatusBody:
        """Return how it is."""
        try:
            status = self.front.operating_state()
        except CrtkError as error:
            return StatusBody(STATUS["not ready"], "", f"{error}")
        text = f"{status.detail} {'busy' if status.is_busy else ''}".strip()
        return StatusBody(STATUS[_CODES[status.state]], status.state.value, text)


def _message_name(device: str, command: Command) -> str:
    """Return the name of what is told; all that a tracker sees goes by the tracker's own."""
    return device if command.payload is Payload.POSES else f"{device}/{command.name}"


def _is_told(command: Command) -> bool:
    return (
        command.direction is Direction.PUBLISHED
        and command.level in (Level.MEASURED, Level.SETPOINT, Level.GOAL)
        and command.payload in TOLD
    )


def _is_command(command: Command) -> bool:
    if command.direction is not Direction.COMMANDED or not is_taken(command):
        return False
    return command.is_motion or command.level is Level.STATE or command.payload is Payload.EMPTY


def _check_room(device: str) -> None:
    if len(device.encode()) > NAME:
        raise ConfigError(
            f"has {len(device.encode())} letters, and messages have room for {NAME}",
            where=device,
            remedy="Give the device a shorter name (ptr=/polaris/pointer), or leave this value out.",
        )
