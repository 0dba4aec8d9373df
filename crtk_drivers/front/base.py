"""What the two fronts have in common: a device in this process and one on the far side of ROS."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from inspect import cleandoc
from types import MappingProxyType
from typing import Any, Protocol, Self

from numpy.typing import ArrayLike

from crtk_drivers.commands import COMMANDS, Command, Direction, Kind, Payload
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.front.method_forms import (
    DEFAULT_AGE,
    DEFAULT_WAIT,
    QUERY_TIMEOUT,
    summary_of,
)
from crtk_drivers.front.payloads import converted
from crtk_drivers.samples import EMPTY, JointState, Number, Pose, Vector
from crtk_drivers.state import OperatingState, StateCommand, Status

PARTS: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        f"{command.name[:-1]}{kind}": (command.name, field)
        for command in COMMANDS.values()
        if command.payload is Payload.JOINT_STATE and command.kind is Kind.STATE
        for kind, field in (("p", "position"), ("v", "velocity"), ("f", "effort"))
    }
)
"""``measured_jp`` is the position of ``measured_js``."""

Reader = Callable[[float, float], tuple[Any, int]]
"""Reads a feedback at most so many seconds old, waiting at most so many: the value, and its stamp in ns."""


class Operated(Protocol):
    """What every device has, of whatever kind: the life cycle and the operating state.

    Closed at the end of a ``with`` statement.
    """

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Let the device go."""

    @property
    @abstractmethod
    def crtk_commands(self) -> Mapping[str, Command]:
        """The CRTK names that this device offers."""

    @abstractmethod
    def operating_state(self) -> Status:
        """Return state, is_homed and is_busy."""

    @abstractmethod
    def wait_for_status(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for an announced status; return whether it did in time."""

    @abstractmethod
    def state_command(self, command: str, timeout: float = 30.0) -> None:
        """Send a state command and wait until it is carried out.

        Args:
            command: enable, disable, pause, resume, home or unhome.
            timeout: in seconds; 0 does not wait.

        Raises:
            CommandRefused: invalid in this state, or refused by the device.
            TransitionFailed: it ended in another state, or did not end in time.
            ConnectionFailed, DataTimeout: over ROS at the first use, the other end was not found, or no state
                was heard, in time.
            ConnectionLost: over ROS, the device is not heard any more.
        """

    def is_enabled(self) -> bool:
        """Whether the state is ENABLED."""
        return self.operating_state().state is OperatingState.ENABLED

    def is_homed(self) -> bool:
        """Whether positions can be trusted."""
        return self.operating_state().is_homed

    def is_busy(self) -> bool:
        """Whether a move or homing is running."""
        return self.operating_state().is_busy

    def wait_for_busy(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Wait until is_busy is as asked; return whether it was in time."""
        return self.wait_for_status(lambda status: status.is_busy is is_busy, timeout)

    def wait_for_operating_state(self, state: str, timeout: float = 30.0) -> bool:
        """Wait until the state is as asked; return whether it was in time."""
        return self.wait_for_status(lambda status: status.state == state, timeout)

    def enable(self, timeout: float = 30.0) -> None:
        """Power up and accept motion commands. See `state_command`."""
        self.state_command(StateCommand.ENABLE, timeout)

    def disable(self, timeout: float = 30.0) -> None:
        """Power down. See `state_command`."""
        self.state_command(StateCommand.DISABLE, timeout)

    def pause(self, timeout: float = 30.0) -> None:
        """Stop and ignore motion commands, with power on. See `state_command`."""
        self.state_command(StateCommand.PAUSE, timeout)

    def resume(self, timeout: float = 30.0) -> None:
        """Go on after PAUSED. See `state_command`."""
        self.state_command(StateCommand.RESUME, timeout)

    def home(self, timeout: float = 60.0) -> None:
        """Find the reference positions. See `state_command`."""
        self.state_command(StateCommand.HOME, timeout)

    def unhome(self, timeout: float = 30.0) -> None:
        """Forget the reference positions. See `state_command`."""
        self.state_command(StateCommand.UNHOME, timeout)


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return which names are near one that is none of them, as a question with a space behind; or nothing."""
    near = near_names(name, names, most=3)
    return f"Did you mean {' or '.join(near)}? " if near else ""


_ALSO = (
    "",
    "And, as every device: enable(), disable(), pause(), resume(), home(), unhome(), is_enabled(),",
    "close(). `measured_jp` is the position of `measured_js`, `setpoint_jp` that of `setpoint_js`, ...",
)


class OfferedDoc:
    """The docstring of a class; for an object of it, also what that offers: ``help(arm)``.

    Args:
        text: the docstring.
    """

    def __init__(self, text: str) -> None:
        self._text = cleandoc(text)

    def __get__(self, device: DeviceFront | None, owner: type) -> str:
        if device is None:
            return self._text
        offered = device.summaries()
        width = max(map(len, offered), default=0)
        lines = (
            f"    {name.replace('/', '.'):{width}}  {summary}" for name, summary in offered.items()
        )
        return "\n".join((f"{self._text}\n\nIt offers:\n", *lines, *_ALSO))


class DeviceFront(Operated, ABC):
    """A device whose CRTK names are methods.

    `_reader`, `_sender` and `_query` carry values to the device and back; the methods that users call are
    made of these.
    """

    def summaries(self) -> Mapping[str, str]:
        """Return what the device offers, with one line for each name."""
        return {name: summary_of(command) for name, command in self.crtk_commands.items()}

    @property
    @abstractmethod
    def _named(self) -> str:
        """What a refusal calls the device."""

    @abstractmethod
    def _reader(self, name: str) -> Reader:
        """Return what reads a feedback; it raises DataTimeout when there is none like that."""

    @abstractmethod
    def _sender(self, name: str, command: Command) -> Callable[..., Any]:
        """Return what sends a command: of its value, or of nothing."""

    @abstractmethod
    def _query(self, name: str, command: Command) -> Callable[..., Any]:
        """Return what asks for kinematics: of joints, or of a pose and a reference; and of seconds."""

    def _method(self, name: str, command: Command, field: str = "") -> Callable[..., Any]:
        """Return the method of a CRTK name; with `field`, of that part of its value."""
        if command.direction is Direction.PUBLISHED:
            method = _getter(self._reader(name), field)
        elif command.direction is Direction.COMMANDED:
            method = self._sender(name, command)
        elif command.payload is Payload.FORWARD_KINEMATICS:
            method = _forward(self._query(name, command), name, self._named)
        else:
            method = _inverse(self._query(name, command), name, self._named)
        return method


def _getter(read: Reader, field: str) -> Callable[..., Any]:
    def getter(age: float | None = None, wait: float | None = None, extra: bool = False) -> Any:
        value, stamp_ns = read(
            DEFAULT_AGE if age is None else age, DEFAULT_WAIT if wait is None else wait
        )
        told = value.value if isinstance(value, Number) else value
        told = getattr(told, field) if field else told
        return (told, stamp_ns / 1e9) if extra else told

    return getter


def _joints(name: str, value: Any, where: str) -> Vector:
    state = converted(name, Payload.JOINT_STATE, value, where)
    assert isinstance(state, JointState)
    return state.position


def _forward(ask: Callable[[Vector, float], Pose], name: str, where: str) -> Callable[..., Pose]:
    def forward(joints: ArrayLike, timeout: float = QUERY_TIMEOUT) -> Pose:
        return ask(_joints(name, joints, where), timeout)

    return forward


def _inverse(
    ask: Callable[[Pose, Vector, float], Vector], name: str, where: str
) -> Callable[..., Vector]:
    def inverse(pose: Any, reference: ArrayLike = EMPTY, timeout: float = QUERY_TIMEOUT) -> Vector:
        wanted = converted(name, Payload.POSE, pose, where)
        assert isinstance(wanted, Pose)
        return ask(wanted, _joints(name, reference, where), timeout)

    return inverse
