"""Who commands now: the mailbox between the clients' threads and the I/O thread.

It is one deep. A newer absolute command replaces an older one; increments are added up, so that none
is lost; `hold`, `free` and moves replace whatever lies there.

A stream has an owner, the client that began it, until it has ended: by its owner's move, by anybody's
`hold`, or because no command came for its timeout. Streams, moves and `free` of others are refused meanwhile.
Who goes on sending after somebody else's `hold` is refused as well, until it has been silent as long. Nor do
two kinds of stream alternate: another kind of the same owner is refused until the first has been silent for
the dwell.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from crtk_drivers.commands import Level, find
from crtk_drivers.device import Goal, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.geometry.frames import both
from crtk_drivers.motion.move import Move
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import EMPTY, Pose, Value, Vector, empty, vector
from crtk_drivers.trajectory.tolerances import Tolerances
from crtk_drivers.trajectory.waypoints import Spline


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """A trajectory that is to be gone along.

    Attributes:
        spline: the trajectory.
        starts: monotonic seconds at which its time is 0; None: when its order is begun.
        tolerances: within which the joints are to be.
    """

    spline: Spline
    starts: float | None
    tolerances: Tolerances


@dataclass(frozen=True, slots=True, eq=False)
class Order:
    """A command that passed its checks.

    A command has what it needs of this; hold and free have a name only.

    Attributes:
        name: of the command.
        setpoint: of a servo that is sent as it comes, or the joints that reach `target`.
        increment: (n,) to the joint setpoint, or to the newest target of a stream that goes on by itself.
        target: of a stream that goes on between its commands.
        displacement: of a relative Cartesian command, in the frame of its sub-namespace.
        goal: of a move.
        path: of a move that goes along a given trajectory.
        joints: (n,) where the goal lies.
        goals: what ``goal_*`` will say of a move.
        move: its handle.
        stamp_ns: the sender's stamp, 0 if it gave none.
        after_hold: it took the place of a `hold` that was not carried out yet: refused, it leaves that.
    """

    name: str
    setpoint: Setpoint | None = None
    increment: Vector = field(default_factory=empty)
    target: Value | None = None
    displacement: Pose | None = None
    goal: Goal | None = None
    path: Path | None = None
    joints: Vector = field(default_factory=empty)
    goals: Mapping[str, Value] = field(default_factory=dict)
    move: Move | None = None
    stamp_ns: int = 0
    after_hold: bool = False

    @property
    def frame(self) -> str:
        """The frame that its command's sub-namespace names, see `crtk_drivers.geometry.frames`."""
        return find(self.name).frame

    @property
    def level(self) -> Level:
        """The level of its command."""
        return find(self.name).level

    @property
    def is_stream(self) -> bool:
        """Whether its command belongs to a stream."""
        return find(self.name).is_stream


class Client:
    """Somebody who commands. Two objects are two clients, unless a subclass says otherwise in `is_same`.

    Args:
        name: for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._is_there = True

    @property
    def name(self) -> str:
        """For messages."""
        return self._name

    @property
    def is_there(self) -> bool:
        """Whether it may still command. Must not wait."""
        return self._is_there

    def leave(self) -> None:
        """It commands no more: what it has begun ends."""
        self._is_there = False

    def is_same(self, other: Client) -> bool:
        """Whether the two are one client. Must not wait."""
        return self is other


NOBODY = Client("an unnamed client")
"""Commands for whom no client is given: all of them are one client's."""


class Arbiter:
    """The mailbox. Thread-safe.

    Args:
        options: how long a stream must be silent before it has ended, and before one of another kind may
            take over: an interpolated stream, whose commands are far apart, until it has ended at least.
        where: the device, for messages.
    """

    def __init__(self, options: EngineOptions, where: str) -> None:
        dwell, slow = options.mode_switch_dwell, options.interpolate_timeout
        self._options = options
        self._dwells = {Level.SERVO: dwell, Level.INTERPOLATE: max(dwell, slow)}
        self._where = where
        self._lock = threading.Lock()
        self._order: Order | None = None
        self._stream = ""
        self._level = Level.SERVO
        self._streamed = 0.0
        self._owner = NOBODY
        self._holder: Client | None = None  # who ended the owner's stream

    def admit(self, name: str, client: Client, now: float) -> None:
        """Judge whether a client may ask for a motion now, whatever its value.

        Raises:
            CommandRefused: another client owns the stream that is running, or has held this one's.
        """
        if name == "hold":
            return
        with self._lock:
            stream, holder, owner = self._stream, self._holder, self._owner
            timeout = self._options.silence(self._level)
            if not stream or now - self._streamed >= timeout:
                return
        is_owner = client.is_same(owner)
        is_stream = find(name).is_stream
        if holder is None and not is_owner:
            raise CommandRefused(
                name,
                Reason.STREAM_OWNED,
                f"{owner.name} streams {stream}",
                where=self._where,
                remedy=f"Wait until it has been silent for {timeout:g} s, or send hold, which ends it.",
            )
        if holder is not None and is_owner and is_stream:
            with self._lock:
                self._streamed = now
            raise CommandRefused(
                name,
                Reason.STREAM_OWNED,
                f"{holder.name} ended this stream with hold",
                where=self._where,
                remedy=f"Send nothing for {timeout:g} s, then begin from where the device is.",
            )

    def put(self, order: Order, now: float, client: Client = NOBODY) -> Move | None:
        """Leave an order for the I/O thread, and return the move that it replaced unexecuted.

        Raises:
            CommandRefused: see `admit`; or another kind of stream is running.
        """
        self.admit(order.name, client, now)
        with self._lock:
            if order.is_stream:
                self._keep_stream(order, now, client)
            elif client.is_same(self._owner):
                self._stream = ""
            elif self._stream and self._holder is None:
                self._holder = client
            before = self._order
            replaced = before.move if before is not None else None
            self._order = combined(before, order)
            if before is not None and (before.after_hold or before.name == "hold"):
                self._order = replace(self._order, after_hold=True)
        return replaced

    @property
    def waiting_move(self) -> Move | None:
        """The move that lies in the mailbox, not begun yet; None if there is none."""
        order = self._order
        return None if order is None else order.move

    def silent_for(self, now: float) -> float:
        """Return the seconds since the newest command of a stream came."""
        return now - self._streamed

    def streams(self, now: float) -> bool:
        """Whether an order lies in the mailbox, or a stream's last command came within its dwell."""
        with self._lock:
            return self._streams(now) or self._order is not None

    def take(self, accept: Callable[[Order], bool] = lambda order: True) -> Order | None:
        """Return the newest order, once; leave it there if it is not to be taken now."""
        if self._order is None:
            return None
        with self._lock:
            order = self._order
            if order is None or not accept(order):
                return None
            self._order = None
        return order

    def clear(self) -> Move | None:
        """Empty the mailbox and forget which stream ran; return the move that is lost by it."""
        with self._lock:
            lost = self._order.move if self._order is not None else None
            self._order = None
            self._stream = ""
        return lost

    def _streams(self, now: float) -> bool:
        """Whether a stream runs that one of another kind may not replace yet."""
        is_running = self._stream != "" and self._holder is None
        return is_running and now - self._streamed < self._dwells[self._level]

    def _keep_stream(self, order: Order, now: float, client: Client) -> None:
        name = order.name
        if self._stream != name and self._streams(now):
            raise CommandRefused(
                name,
                Reason.MODE_SWITCH,
                f"a stream of {self._stream} is running",
                where=self._where,
                remedy=f"Stop it for {self._dwells[self._level]} s, or send hold, before you send {name}.",
            )
        self._stream, self._level, self._streamed = name, order.level, now
        self._owner, self._holder = client, None


def combined(old: Order | None, new: Order) -> Order:
    """Return the order that stands for both: the newer one, with the increments of the older one added."""
    if old is None or not find(new.name).is_relative:
        return new
    if old.name == new.name and old.increment.size:
        return replace(new, increment=vector(old.increment + new.increment))
    if old.name == new.name and old.displacement is not None and new.displacement is not None:
        return replace(new, displacement=both(old.displacement, new.displacement, new.frame))
    on_position = old.setpoint is not None and old.setpoint.mode is Mode.JOINT_POSITION
    if on_position and new.level is Level.SERVO and new.increment.size:
        assert old.setpoint is not None
        moved = vector(old.setpoint.values + new.increment)
        return replace(new, setpoint=Setpoint(Mode.JOINT_POSITION, moved), increment=EMPTY)
    return new
