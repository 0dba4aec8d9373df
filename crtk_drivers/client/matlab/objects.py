"""What MATLAB has made: layers (``crtk.ral``), devices (``crtk.utils``) and moves, by number."""

from __future__ import annotations

import itertools
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from crtk_drivers.client.matlab.wire import Encoded, arguments_of, decoded, encoded, parts_of
from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.client.remote import CONNECT_TIMEOUT, SERVICE_TIMEOUT, RemoteDevice, connect
from crtk_drivers.commands import COMMANDS, Command, Direction, find
from crtk_drivers.errors import CommandRefused, ConfigError, CrtkError, DataTimeout
from crtk_drivers.front.base import PARTS
from crtk_drivers.ros import environment
from crtk_drivers.state import Status

KEPT_MOVES = 1000
"""Moves that can still be asked about; MATLAB does not tell when it has dropped a handle."""
KEPT_EVENTS = 1000
UNLIMITED = 1e6
"""Seconds for a timeout of Inf, which is null in JSON."""

_NODE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


@dataclass
class _Layer:
    name: str
    devices: list[RemoteDevice] = field(default_factory=list)


@dataclass(frozen=True)
class _Event:
    """A change of the operating state, or a refusal; what does not belong to it is empty."""

    kind: str
    time: float
    state: str = ""
    is_homed: bool = False
    is_busy: bool = False
    command: str = ""
    reason: str = ""
    message: str = ""


class _Events:
    """What a device has told and MATLAB has not taken yet."""

    def __init__(self, device: RemoteDevice) -> None:
        self._events: deque[_Event] = deque(maxlen=KEPT_EVENTS)
        self._arrived = threading.Condition()
        device.on_status(self._status)
        device.on_refusal(self._refusal)

    def _status(self, status: Status) -> None:
        state = str(status.state)
        self._add(_Event("status", time.time(), state, status.is_homed, status.is_busy))

    def _refusal(self, refusal: CommandRefused) -> None:
        command, reason = refusal.command, str(refusal.reason)
        self._add(
            _Event("refusal", time.time(), command=command, reason=reason, message=str(refusal))
        )

    def _add(self, event: _Event) -> None:
        with self._arrived:
            self._events.append(event)
            self._arrived.notify_all()

    def take(self, timeout: float = 0.0) -> list[_Event]:
        """Return all, after waiting for the first."""
        with self._arrived:
            self._arrived.wait_for(lambda: self._events, timeout)
            taken = list(self._events)
            self._events.clear()
            return taken


class Session:
    """Carries requests out. The names of its public methods are the requests; all return what JSON can hold.

    One request at a time, except that another may come while one still waits.
    """

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._layers: dict[int, _Layer] = {}
        self._devices: dict[int, RemoteDevice] = {}
        self._events: dict[int, _Events] = {}
        self._moves: dict[int, RemoteMove] = {}
        self._requests: Mapping[str, Callable[..., Any]] = MappingProxyType(
            {
                "ral": self.ral,
                "device": self.device,
                "add": self.add,
                "get": self.get,
                "send": self.send,
                "solve": self.solve,
                "state": self.state,
                "wait": self.wait,
                "is_busy": self.is_busy,
                "check_connections": self.check_connections,
                "now": time.time,
                "close_device": self.close_device,
                "shutdown": self.shutdown,
                "is_shutdown": self.is_shutdown,
            }
        )

    def perform(self, do: str, **fields: Any) -> Any:
        """Carry out the request `do`."""
        return self._requests[do](**fields)

    def close(self) -> None:
        """Leave ROS. The devices go on as they are."""
        for ral in list(self._layers):
            self.shutdown(ral)

    # ------------------------------------------------------------------------------------ life cycle

    def ral(self, name: str) -> int:
        """Return the number of a new layer whose nodes have this name.

        Raises:
            MissingExtra, ConfigError: ROS 2 cannot be used, or that is no name of a node.
        """
        environment.check()
        if not _NODE_NAME.fullmatch(name):
            raise ConfigError(
                f"{name!r} is no name of a ROS node",
                remedy="Use letters, digits and underscores, and no digit first.",
            )
        number = next(self._numbers)
        self._layers[number] = _Layer(name)
        return number

    def device(
        self, ral: int, namespace: str, parent: int = 0, timeout: float = CONNECT_TIMEOUT
    ) -> int:
        """Return the number of the device in `namespace`, connected.

        With a `parent`, whose namespace must begin this one, its operating state is that of the parent.
        """
        layer = self._layer(ral)
        full = f"/{namespace.strip('/')}"
        if parent:
            device = self._child(self._device(parent), full, timeout)
        else:
            count = len(layer.devices)
            node = layer.name if count == 0 else f"{layer.name}_{count + 1}"
            ros_args = ["--ros-args", "-r", f"__node:={node}"]
            device = connect(full, timeout=timeout, ros_args=ros_args)
            layer.devices.append(device)
        number = next(self._numbers)
        self._devices[number] = device
        return number

    @staticmethod
    def _child(parent: RemoteDevice, namespace: str, timeout: float) -> RemoteDevice:
        prefix = f"{parent.namespace}/"
        if not namespace.startswith(prefix):
            raise ConfigError(
                f"{namespace} is not below {parent.namespace}, whose operating state it should have",
                remedy=f"Name it {prefix}..., or leave the operating_state_instance out.",
            )
        return parent.child(namespace.removeprefix(prefix), timeout)

    def close_device(self, device: int) -> None:
        """Let one device go; what was closed before is no error."""
        gone = self._devices.pop(device, None)
        for layer in self._layers.values():
            if gone in layer.devices:  # and is no child of another
                layer.devices.remove(gone)
                gone.close()

    def shutdown(self, ral: int) -> None:
        """Close all devices of a layer; what was shut down before is no error."""
        layer = self._layers.pop(ral, _Layer(""))
        for device in layer.devices:
            device.close()
        namespaces = {device.namespace for device in layer.devices}
        for number, device in list(self._devices.items()):
            if any(f"{device.namespace}/".startswith(f"{above}/") for above in namespaces):
                del self._devices[number]

    def is_shutdown(self, ral: int) -> bool:
        """Whether a layer was shut down."""
        return ral not in self._layers

    def check_connections(self, ral: int, timeout: float) -> None:
        """Wait until all topics and services in use have met their other end."""
        deadline = time.monotonic() + timeout
        for device in self._layer(ral).devices:
            device.check_connections(max(0.0, deadline - time.monotonic()))

    def _layer(self, ral: int) -> _Layer:
        if ral not in self._layers:
            raise ConfigError("this crtk.ral was shut down", remedy="Make a new one: crtk.ral(...)")
        return self._layers[ral]

    def _device(self, device: int) -> RemoteDevice:
        if device not in self._devices:
            raise ConfigError(
                "this device was closed, or its crtk.ral was shut down",
                remedy="Make a new one: crtk.utils(...)",
            )
        return self._devices[device]

    # ------------------------------------------------------------------------------------- features

    def add(self, device: int, name: str) -> list[dict[str, str]]:
        """Connect a CRTK name; return the methods that come with it, and the kind of each.

        Raises:
            AttributeError: the device does not offer it.
            ConnectionFailed: it has no other end.
        """
        owner = self._device(device)
        if name == "operating_state":
            owner.operating_state()
            if device not in self._events:
                self._events[device] = _Events(owner)
            return [{"name": method, "kind": "state"} for method in _STATE_METHODS]
        command = _row(name)
        _method(owner, name)
        parts = [part for part, (whole, _) in PARTS.items() if whole == name]
        return [{"name": method, "kind": _kind(command)} for method in (name, *parts)]

    def get(
        self, device: int, name: str, age: float | None = None, wait: float | None = None
    ) -> dict[str, Any]:
        """Return a feedback and its stamp in s; ``missing`` names the topic if nothing ever came.

        Raises:
            DataTimeout: what came is older than `age`, or not valid.
        """
        getter = _method(self._device(device), name)
        try:
            value, stamp = getter(age=age, wait=wait, extra=True)
        except DataTimeout:
            if _ever(getter):
                raise
            return {"missing": f"{self._device(device).namespace}/{name}"}
        return {"values": [encoded(part) for part in (*parts_of(value), np.array([stamp]))]}

    def send(self, device: int, name: str, arguments: Sequence[Encoded]) -> int:
        """Send a command; return the number of the move that it began, 0 if it is no move.

        Raises:
            CommandRefused: it was refused.
        """
        owner = self._device(device)
        arrays = [decoded(argument) for argument in arguments]
        move = _method(owner, name)(*arguments_of(_row(name), arrays, owner.namespace))
        if not isinstance(move, RemoteMove):
            return 0
        number = next(self._numbers)
        self._moves[number] = move
        if len(self._moves) > KEPT_MOVES:
            del self._moves[next(iter(self._moves))]
        return number

    def solve(self, device: int, name: str, arguments: Sequence[Encoded]) -> list[Encoded]:
        """Return the answer of a kinematics service.

        Raises:
            CommandRefused: it takes other arguments.
            KinematicsError: there is none.
        """
        owner = self._device(device)
        arrays = [decoded(argument) for argument in arguments]
        given = arguments_of(_row(name), arrays, owner.namespace)
        answer = _method(owner, name)(*given, timeout=SERVICE_TIMEOUT)
        return [encoded(part) for part in parts_of(answer)]

    # ----------------------------------------------------------------------------------------- moves

    def wait(self, move: int, is_busy: bool, timeout: float | None = None) -> bool:
        """Wait until a move has ended or, with `is_busy`, begun; return whether it was in time.

        Raises:
            MotionAborted: it ended elsewhere.
        """
        return self._move(move).wait(timeout, is_busy)

    def is_busy(self, move: int) -> bool:
        """Whether a move has not ended."""
        return self._move(move).is_busy()

    def _move(self, move: int) -> RemoteMove:
        if move not in self._moves:
            raise ConfigError(
                f"this move is not known any more: only the last {KEPT_MOVES} are",
                remedy="Wait for a move before so many others are sent.",
            )
        return self._moves[move]

    # ------------------------------------------------------------------------------- operating state

    def state(self, device: int, method: str, arguments: Sequence[Any]) -> Any:
        """Call one of the methods that come with the operating state.

        Raises:
            CommandRefused, TransitionFailed, ConnectionLost: see `RemoteDevice`.
        """
        owner = self._device(device)
        given = [UNLIMITED if argument is None else argument for argument in arguments]
        if method == "events":
            return [asdict(event) for event in self._events[device].take(*given)]
        answer = getattr(owner, _STATE_METHODS[method])(*given)
        if isinstance(answer, Status):
            return {
                "state": str(answer.state),
                "is_homed": answer.is_homed,
                "is_busy": answer.is_busy,
            }
        return True if answer is None else answer


_STATE_METHODS: Mapping[str, str] = MappingProxyType(
    {
        **{
            name: name
            for name in (
                "operating_state",
                "state_command",
                "wait_for_operating_state",
                "wait_for_busy",
                "is_enabled",
                "is_homed",
                "is_busy",
                "enable",
                "disable",
                "pause",
                "resume",
                "home",
                "unhome",
                "events",
            )
        },
        "operating_state_command": "state_command",
    }
)
"""What `add("operating_state")` adds in MATLAB, and the method of `RemoteDevice` that does it."""


def _row(name: str) -> Command:
    try:
        return find(name)
    except KeyError:
        raise AttributeError(f"there is no CRTK command {name}") from None


def _method(device: RemoteDevice, name: str) -> Callable[..., Any]:
    """Return the method of a CRTK name, which may carry a sub-namespace."""
    space, slash, base = name.rpartition("/")
    if not slash or name in COMMANDS:
        space, base = "", name
    method: Callable[..., Any] = getattr(device.child(space) if space else device, base)
    return method


def _ever(getter: Callable[..., Any]) -> bool:
    """Whether a feedback ever came."""
    try:
        getter(age=0.0, wait=0.0)
    except DataTimeout:
        return False
    return True


def _kind(command: Command) -> str:
    if command.direction is Direction.SERVICE:
        return "query"
    return "feedback" if command.direction is Direction.PUBLISHED else "command"


_SHORT = {
    "CommandRefused": "Refused",
    "ConfigError": "Config",
    "DataTimeout": "Timeout",
    "KinematicsError": "Kinematics",
    "AttributeError": "NotOffered",
}


def described(error: Exception) -> dict[str, str]:
    """Return an error as MATLAB raises it: ``crtk:Refused``, and the whole text with the remedy."""
    kind = type(error).__name__
    if not isinstance(error, (CrtkError, AttributeError)):
        return {"identifier": "crtk:Error", "message": f"{kind}: {error}"}
    return {"identifier": f"crtk:{_SHORT.get(kind, kind)}", "message": str(error)}
