"""A WSG gripper by its commands: one joint, the opening between its fingers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_weiss_wsg.config import WsgConfig
from crtk_driver_weiss_wsg.link import WsgLink
from crtk_driver_weiss_wsg.orders import Order
from crtk_driver_weiss_wsg.tables import BUSY, STATUS, Command, Flag, Grasping, Status
from crtk_drivers import samples
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Answer,
    Capabilities,
    Condition,
    JointLimits,
    Mode,
    Note,
    Reading,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import CrtkError, DeviceError, DeviceFault, TransitionFailed, raise_first
from crtk_drivers.kit import until
from crtk_drivers.kit.gripping import (
    Adjustable,
    Doing,
    Fault,
    GripperDevice,
    Hand,
    HandService,
    Measured,
    Weight,
    When,
    not_made_ready,
)
from crtk_drivers.samples import Number, Stamp, Value
from crtk_drivers.state import OperatingState

__all__ = ["WsgHand", "create"]

TURN: Final = 2.0
"""Seconds in which a command that moves nothing must have its effect."""
SLACK: Final = 5.0
"""Seconds that a motion may take beyond its time at half of its speed."""
HOMING: Final = 20.0
"""Seconds in which it must find its reference."""
OTHERS: Final = 0.25
"""Seconds of motion without a command of ours, which are another program's: from one time that it is told to
another. One that is read late tells nothing of what came since."""
CLEARANCE: Final = 5e-4
"""Metres beyond the width of a part that is held from which on a position is one to open to."""
_DIRECTIONS: Final = {"as set": 0, "open": 1, "close": 2}
_ENABLE: Final = "Enable it."
_ALWAYS: Final = "it finds its reference at each enable (home: always)"
_DOES: Final[Mapping[Grasping, Doing]] = {
    Grasping.IDLE: Doing.STOPPED,
    Grasping.GRASPING: Doing.PRESSING,
    Grasping.NO_PART: Doing.NOTHING,
    Grasping.PART_LOST: Doing.LOST,
    Grasping.HOLDING: Doing.HOLDS,
    Grasping.RELEASING: Doing.RELEASING,
    Grasping.POSITIONING: Doing.MOVING,
    Grasping.ERROR: Doing.ERROR,
}


def create(config: WsgConfig) -> GripperDevice:
    """Return the device; nothing is opened."""
    by_line = config.link == "serial"
    address = config.port if by_line else f"{config.host}:{config.tcp_port}"
    return GripperDevice(WsgHand(config), address, config.on_close)


class Goal(NamedTuple):
    """Where the fingers are sent: opening in m, share of the speed."""

    width: float
    ratio: float


class WsgHand(Hand):
    """One gripper."""

    def __init__(self, config: WsgConfig) -> None:
        self._config = config
        self._move: Order | None = None
        self._foreign: tuple[float, float] | None = None  # from when to when it was told
        self._force = Adjustable(
            "force", "force of the next grip, in N", config.force, self._forces, "N"
        )
        text = "width in m of what the next grip is to find"
        widths = 0.0, config.data.stroke
        self._part_width = Adjustable("part_width", text, config.part_width, lambda: widths, "m")
        data = config.data
        self._speed = config.speed or data.speed[1]
        period = round(1000.0 / config.rate) / 1000.0
        self._link = WsgLink(config, period)
        limits = JointLimits(
            lower=config.range[0],
            upper=config.range[1],
            velocity=self._speed,
            acceleration=config.acceleration or data.acceleration[1],
            jerk=1000.0 * data.speed[1],
            effort=data.force[1],
        )
        by_line = config.link == "serial"
        self.capabilities = Capabilities(
            joints=(config.joint,),
            joint_units=("m",),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION}),
            native_moves=frozenset({"move_jp"}),
            rate=1.0 / period,
            paced_by_stream=True,
            enable_moves=True,
            transition_timeout=HOMING + 4.0 * TURN,
            stop=StopPolicy(
                data.stroke / data.speed[0] if by_line else 0.1,
                "goes on to where it was sent last"
                if by_line
                else "the gripper stops fast when the connection ends without a goodbye (if its web page "
                "says so, as delivered); a cable that is pulled out it does not notice",
                time=2.0,
            ),
        )

    def _forces(self) -> tuple[float, float]:
        low, high = self._link.told.get(Command.LIMITS, (0.0,) * 5 + self._config.data.force)[5:7]
        return low, high

    @property
    @override
    def where(self) -> str:
        return self._link.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"strange_bytes": self._link.codec.strange}

    # ------------------------------------------------------------------------------------- the link

    @property
    @override
    def is_open(self) -> bool:
        return self._link.is_open

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._move = self._foreign = None
        self._link.open(deadline, given_up)

    @override
    def close(self, *, moves: bool) -> None:
        """Say goodbye, but not while it moves against what is wanted: without one it stops fast."""
        with contextlib.suppress(DeviceError):  # there may be nobody to take leave of
            if self._link.is_open and not moves:
                self._link.last(Order(Command.GOODBYE))
        self._link.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        while not (fresh := self._link.receive(deadline)):
            if fresh is None:
                return None
            self._look(time.monotonic())
            if time.monotonic() > deadline:
                return None
        self._look(time.monotonic())
        told = self._link.told
        (width,), (speed,), (force,) = (
            told[about] for about in (Command.WIDTH, Command.SPEED, Command.FORCE)
        )
        return Measured(Stamp.now(), width, speed, 0.0 - force, is_setpoint=True)

    def _look(self, now: float) -> None:
        """See whether somebody else moves it."""
        link = self._link
        if link.grasping not in BUSY or link.orders.running or not link.orders.settled:
            self._foreign = None
        else:
            began = now if self._foreign is None else self._foreign[0]
            self._foreign = began, now

    # ---------------------------------------------------------------------------------- what moves it

    def _to(self, width: float, ratio: float = 1.0) -> Order:
        """Return what leads to a width; from a part that is held only to let it go."""
        link, speed = self._link, max(ratio * self._speed, self._config.data.speed[0])
        if link.grasping is not Grasping.HOLDING:
            return Order(Command.MOVE, (width, speed))
        if width > link.width + CLEARANCE:
            return Order(Command.RELEASE, (width, speed, width - link.width))
        return Order(Command.MOVE, status=Status.OK)

    def _go(self, width: float, ratio: float = 1.0) -> Order:
        order = self._to(width, ratio)
        return order if order.status is not None else self._link.put(order)

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> Goal:
        return Goal(value, ratio)

    @override
    def go(self, order: Goal, *, at_once: bool) -> None:
        self._move = self._go(*order)

    @override
    def halt(self, *, aside: bool) -> None:
        if not self._link.rests or self._link.orders.running is not None:
            self._link.stop()  # which lets go of what is held

    @override
    def let_go(self) -> None:
        self._go(self._config.range[1])

    @property
    @override
    def is_told(self) -> bool:
        return self._link.orders.settled

    @property
    @override
    def rests(self) -> bool:
        return not self._link.moves

    @property
    @override
    def has_reached(self) -> bool:
        return self._move is not None and self._move.status in (Status.OK, Status.BLOCKED)

    @property
    @override
    def disobeys(self) -> bool:
        return self._move is None or not (self._move.status is None or self.has_reached)

    @property
    @override
    def doing(self) -> Doing:
        link, move = self._link, self._move
        if not link.told:
            return Doing.UNKNOWN
        if link.is_stopped_fast:
            return Doing.ERROR
        if move is not None and move.status is None:
            return Doing.MOVING
        if link.grasping is Grasping.IDLE and self._is_blocked:
            return Doing.HOLDS
        if link.grasping is Grasping.IDLE and self.has_reached:
            return Doing.THERE
        return _DOES[link.grasping]

    @property
    def _is_blocked(self) -> bool:
        ended = self._move is not None and self._move.status == Status.BLOCKED
        return not self._link.moves and (ended or bool(self._link.flags & Flag.BLOCKED))

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def fault(self) -> Fault | None:
        if self._link.fault is not None:
            return Fault(*self._link.fault, Weight.RESET)
        failed = self._move if self._move and self._move.status in STATUS else None
        if failed is None or failed.status == Status.ABORTED:
            return None
        return Fault(*self._words(failed), Weight.PASSES)

    @property
    @override
    def taken_over(self) -> bool:
        return self._foreign is not None and self._foreign[1] - self._foreign[0] > OTHERS

    @property
    @override
    def is_in_doubt(self) -> bool:
        foreign = self._foreign
        is_recent = foreign is not None and time.monotonic() - foreign[0] < 2.0 * OTHERS
        return is_recent and not self.taken_over

    @override
    def unfit(self, *, enabled: bool) -> Condition | None:
        if self._link.is_stopped_fast:
            state = OperatingState.FAULT if enabled else OperatingState.DISABLED
            return Condition(state, f"it was stopped fast. {_ENABLE}")
        if not self._link.flags & Flag.REFERENCED:
            return Condition(OperatingState.DISABLED, STATUS[Status.NOT_REFERENCED][0])
        return None

    @override
    def adopt(self) -> None:
        self._move = self._foreign = None

    @override
    def obstacles(self, *, may_hold: bool) -> tuple[CrtkError, ...]:
        if self._must_acknowledge:
            return ()  # `enable` does that first: it can be judged only then
        return self._of_fault() or self._of_reference(may_hold)

    def _of_fault(self) -> tuple[DeviceFault, ...]:
        """Return what it reports to be wrong with it."""
        fault = self._link.fault
        return () if fault is None else (DeviceFault(fault[0], where=self.where, remedy=fault[1]),)

    def _of_reference(self, may_hold: bool) -> tuple[CrtkError, ...]:
        """Return why it may not look for its reference, if it would."""
        policy = self._config.home
        is_referenced = bool(self._link.flags & Flag.REFERENCED)
        if is_referenced and policy != "always":
            return ()
        return not_made_ready(
            _ALWAYS if is_referenced else STATUS[Status.NOT_REFERENCED][0],
            policy,
            "reference",
            may_hold=may_hold,
            where=self.where,
            verb="find its reference",
        )

    @override
    def make_ready(self, *, may_hold: bool) -> Steps:
        if self._must_acknowledge:
            yield from self._do(Order(Command.ACKNOWLEDGE))
            yield from until(self._has_acknowledged, TURN)
        raise_first(self._of_fault())
        if self._link.is_stopped_fast:
            raise self._failed("it does not leave its fast stop", "Look at its web page.")
        raise_first(self._of_reference(may_hold))
        if self._config.home == "always" or not self._link.flags & Flag.REFERENCED:
            yield from self._find_reference()

    @override
    def sort_out(self) -> Steps:
        config = self._config
        yield from self._do(Order(Command.SET_FORCE, (self._force.value,)))
        if config.acceleration is not None:
            yield from self._do(Order(Command.SET_ACCELERATION, (config.acceleration,)))
        if config.soft_limits is not None:
            yield from self._do(Order(Command.SET_SOFT_LIMITS, config.soft_limits))

    @property
    def _must_acknowledge(self) -> bool:
        return self._link.is_stopped_fast or self._link.grasping is Grasping.ERROR

    def _has_acknowledged(self) -> bool:
        """Whether it has left its fast stop, or tells a fault for which it does not."""
        lasts = self._link.orders.settled and self._link.fault is not None
        return not self._link.is_stopped_fast or lasts

    def _find_reference(self) -> Steps:
        direction = _DIRECTIONS[self._config.home_direction]
        yield from self._do(Order(Command.HOME, (direction,)), HOMING)
        if not (yield from until(lambda: bool(self._link.flags & Flag.REFERENCED), TURN)):
            raise self._failed("it has not found its reference")

    def _do(self, order: Order, timeout: float = TURN) -> Steps:
        """Have an order carried out.

        Raises:
            TransitionFailed: it was refused, or has failed, or takes too long.
        """
        self._link.put(order)
        yield from until(lambda: order.status is not None, timeout)
        if order.status is None:
            self._link.stop()
            raise self._failed(f"{order.command.name.lower()} has not ended in {timeout:g} s")
        if order.status != Status.OK:
            raise self._failed(
                f"{order.command.name.lower()}: {self._words(order)[0]}", self._words(order)[1]
            )

    def _failed(self, text: str, remedy: str = "Are the fingers free to move?") -> TransitionFailed:
        return TransitionFailed(text, where=self.where, remedy=remedy)

    @staticmethod
    def _words(order: Order) -> tuple[str, str]:
        return STATUS.get(order.status or 0, (f"status {order.status}", "See its manual."))

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, HandService]:
        return {
            "grip": HandService(
                "grip a part of part_width with force, and watch over it", self._grip
            ),
            "release": HandService("let a part go, by release_by", self._release),
            "reference": HandService(
                "find its reference, for which it moves to an end of its stroke and drops what it holds",
                self._reference,
                When.NOT_ENABLED,
            ),
        }

    def _grip(self) -> Answer:
        self._move = None
        if self._link.grasping is not Grasping.HOLDING:
            force = self._force.value
            yield from self._do(Order(Command.SET_FORCE, (force,)))
            values = self._part_width.value, self._speed, force
            yield from self._do(Order(Command.GRASP, values), self._longest)
            yield from until(lambda: self._link.rests, TURN)
        return f"{self.doing}, {1e3 * self._link.width:.1f} mm wide"

    def _release(self) -> Answer:
        width = min(self._link.width + self._config.release_by, self._config.range[1])
        self._move = order = self._go(width)
        yield from until(lambda: order.status is not None and self._link.rests, self._longest)
        if order.status != Status.OK:
            raise self._failed(*self._words(order))
        return f"open to {1e3 * self._link.width:.1f} mm"

    def _reference(self) -> Answer:
        if self._link.is_stopped_fast:
            raise self._failed("it was stopped fast", _ENABLE)
        yield from self._find_reference()
        return "it has found its reference"

    @property
    def _longest(self) -> float:
        return SLACK + 2.0 * self._config.data.stroke / self._speed

    @property
    @override
    def adjustables(self) -> tuple[Adjustable, ...]:
        return self._force, self._part_width

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        text = "whether it knows its opening"
        return {
            "force": Reading("of the fingers, in N", Payload.NUMBER, self._tell_force),
            "referenced": Reading(text, Payload.FLAG, self._tell_referenced),
        }

    def _tell_force(self) -> Value | None:
        force = self._link.told.get(Command.FORCE)
        return None if force is None else Number(force[0])

    def _tell_referenced(self) -> Value | None:
        return samples.Flag(bool(self._link.flags & Flag.REFERENCED)) if self._link.told else None

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        flags = self._link.flags
        return tuple(
            Note(Severity.WARNING, key, text)
            for flag, (key, text) in _NOTES.items()
            if flags & flag
        )


_NOTES: Final[Mapping[Flag, tuple[str, str]]] = {
    Flag.WARM: ("temperature", "it is getting warm"),
    Flag.SOFT_LIMIT: ("soft limit", "it is at a soft limit"),
    Flag.SCRIPT: ("script", "a script runs in it"),
    Flag.SCRIPT_FAILED: ("script failed", "a script in it has failed"),
}
