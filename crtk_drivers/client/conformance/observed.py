"""What was seen of a device from outside: its endpoints, its messages, and what it was sent.

Plain values without checks: what a device gets wrong must arrive here as it was sent.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from crtk_drivers.commands import Command, Direction, Level, find, is_name

STATE_SERVICE: Final = "crtk_msgs/srv/TriggerOperatingState"


@dataclass(frozen=True, slots=True)
class Endpoint:
    """A publisher or a subscription in the namespace of the device.

    Attributes:
        name: below the namespace: ``local/measured_cp``.
        direction: published or commanded, seen from the node that has it.
        ros_type, type_hash: of its messages; the hash is empty where it is not known.
        node: full name.
        reliable, latched: its quality of service.
    """

    name: str
    direction: Direction
    ros_type: str
    type_hash: str = ""
    node: str = "/device"
    reliable: bool = True
    latched: bool = False

    @property
    def command(self) -> Command | None:
        """The row of the command table; None if it has none, or goes the other way."""
        row = find(self.name) if is_name(self.name) else None
        return row if row is not None and row.direction is self.direction else None


@dataclass(frozen=True)
class Graph:
    """What a namespace holds, without what clients have there.

    Attributes:
        namespace: ``/ur5``.
        endpoints: all of them but those of this tool.
        services: types by name below the namespace.
        known_hashes: of the message types that are installed here.
    """

    namespace: str
    endpoints: tuple[Endpoint, ...] = ()
    services: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    known_hashes: Mapping[str, str] = field(default_factory=dict)

    def published(self) -> Iterator[tuple[Endpoint, Command]]:
        """Yield the publishers of CRTK names."""
        for each in self.endpoints:
            row = each.command
            if row is not None and row.direction is Direction.PUBLISHED:
                yield each, row

    def commanded(self) -> Iterator[tuple[Endpoint, Command]]:
        """Yield the subscriptions of CRTK names that are the device's: not those of a recorder beside it."""
        nodes = {each.node for each, _ in self.published()}
        found = [
            (each, row)
            for each in self.endpoints
            if (row := each.command) is not None and row.direction is Direction.COMMANDED
        ]
        own = [(each, row) for each, row in found if each.node in nodes]
        yield from own or found

    def offered(self) -> dict[str, Command]:
        """Return the topics of CRTK that the device has, with their rows."""
        return {each.name: row for each, row in (*self.published(), *self.commanded())}


@dataclass(frozen=True, slots=True)
class Heard:
    """A message.

    Attributes:
        at: when it arrived, in monotonic s.
        wall_ns: when it arrived, in ns since the epoch.
        stamp_ns: of its header.
        frame: of its header.
    """

    at: float
    wall_ns: int
    stamp_ns: int
    frame: str


@dataclass(frozen=True, slots=True)
class JointsHeard(Heard):
    """A JointState: rad or m, rad/s or m/s, N·m or N."""

    name: tuple[str, ...] = ()
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class CartesianHeard(Heard):
    """A pose (7,): x y z in m and a quaternion x y z w; a twist or a wrench (6,), linear part first.

    `child` is the frame that a transform of ``/tf`` leads to.
    """

    numbers: tuple[float, ...] = ()
    child: str = ""


@dataclass(frozen=True, slots=True)
class MatrixHeard(Heard):
    """A matrix, row by row."""

    sizes: tuple[int, ...] = ()
    numbers: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class StateHeard(Heard):
    """An operating state."""

    state: str = ""
    is_homed: bool = False
    is_busy: bool = False


@dataclass(frozen=True, slots=True)
class Sent:
    """A command that was sent."""

    at: float
    stamp_ns: int
    name: str
    numbers: tuple[float, ...] = ()
    text: str = ""


@dataclass(frozen=True)
class Trace:
    """What was heard and sent from `began` to `ended` (monotonic s).

    Attributes:
        joints, cartesian, matrices: by CRTK name, oldest first.
        states: as a volatile subscription had them.
        transforms: of ``/tf``.
        sent: commands, oldest first.
        told: refusals and log records of the device, with when they arrived.
        marks: when something was begun, by name.
    """

    began: float = 0.0
    ended: float = 0.0
    joints: Mapping[str, tuple[JointsHeard, ...]] = field(default_factory=dict)
    cartesian: Mapping[str, tuple[CartesianHeard, ...]] = field(default_factory=dict)
    matrices: Mapping[str, tuple[MatrixHeard, ...]] = field(default_factory=dict)
    states: tuple[StateHeard, ...] = ()
    transforms: tuple[CartesianHeard, ...] = ()
    sent: tuple[Sent, ...] = ()
    told: tuple[tuple[float, str], ...] = ()
    marks: Mapping[str, float] = field(default_factory=dict)

    @property
    def seconds(self) -> float:
        """How long it lasted."""
        return self.ended - self.began

    def stamped(self) -> dict[str, tuple[JointsHeard, ...] | tuple[CartesianHeard, ...]]:
        """Return the messages with joint and Cartesian values, by name."""
        return {**self.joints, **self.cartesian}

    def measured(self) -> dict[str, tuple[JointsHeard, ...] | tuple[CartesianHeard, ...]]:
        """Return those of them that were measured."""
        return {
            name: heard
            for name, heard in self.stamped().items()
            if find(name).level is Level.MEASURED
        }


@dataclass(frozen=True, slots=True)
class Answer:
    """What a kinematics service said.

    Attributes:
        seconds: that it took; infinite if none came.
        result, message: as it said.
        numbers: joints (n,) or pose (7,).
        asked: joints or pose of the request.
    """

    seconds: float
    result: bool = False
    message: str = ""
    numbers: tuple[float, ...] = ()
    asked: tuple[float, ...] = ()


@dataclass(frozen=True)
class Answers:
    """What the services of a device answered while it was at rest.

    Attributes:
        states: each with what the topic said last before it, and first after it.
        forward: at the measured joints, then each joint in turn moved by `NUDGE`.
        inverse: of the measured pose, from the measured joints.
        unreachable: inverse kinematics of a pose far out of reach.
        reference: the measured joints.
    """

    states: tuple[tuple[StateHeard | None, StateHeard, StateHeard | None], ...] = ()
    forward: tuple[Answer, ...] = ()
    inverse: tuple[Answer, ...] = ()
    unreachable: tuple[Answer, ...] = ()
    reference: tuple[float, ...] = ()


NUDGE: Final = 1e-4
"""rad or m by which a joint is moved in a question to `forward_kinematics`."""


@dataclass(frozen=True)
class Observation:
    """All that was seen of a device that nobody moved.

    Attributes:
        own_lateness: p99 of how late this tool itself woke up meanwhile, in s.
    """

    graph: Graph
    trace: Trace = field(default_factory=Trace)
    answers: Answers = field(default_factory=Answers)
    manifest: Mapping[str, object] = field(default_factory=dict)
    own_lateness: float = 0.0
