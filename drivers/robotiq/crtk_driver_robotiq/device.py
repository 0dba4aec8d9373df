"""A Robotiq gripper by its registers: one joint, the opening between its fingers."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Final

from typing_extensions import override

from crtk_driver_robotiq.activated import TURN, ActivatedHand, Turn
from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.faults import fault_of
from crtk_driver_robotiq.grip import Grip
from crtk_driver_robotiq.links import (
    ControllerRegisters,
    GripperAnswer,
    GripperRegisters,
    Link,
    UrcapLink,
)
from crtk_driver_robotiq.registers import COUNTS, Activation, Command, Status
from crtk_driver_robotiq.scale import Scale
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Condition,
    JointLimits,
    Mode,
    Reading,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import DeviceError
from crtk_drivers.kit.gripping import (
    HELD,
    Adjustable,
    Doing,
    Echo,
    Fault,
    GripperDevice,
    Measured,
)
from crtk_drivers.kit.modbus_link import ModbusLink, first_answer
from crtk_drivers.plugins import modbus_ways
from crtk_drivers.samples import Number, Value
from crtk_drivers.state import OperatingState

__all__ = ["RobotiqHand", "create", "make_link"]

SETTLING: Final = 0.1
"""Time constant of the velocity in s: one count of the position is 0.4 mm."""
SWEEP: Final = 10.0
"""Seconds that an activation may take."""
HELD_UP: Final = 0.25
"""Seconds without a status after which a stop waits for no answer: a question or its answer may be lost."""
CYCLES: Final = 2.0
"""In which a stop comes to it: it is sent in the next one, and has until its end."""


def create(config: RobotiqConfig) -> GripperDevice:
    """Return the device; nothing is opened."""
    return GripperDevice(RobotiqHand(config), config.place, config.on_close, SETTLING)


def _may_be_told(status: Status) -> bool:
    """Whether a command that writes rACT activates nothing: it has it already."""
    return status.activation is Activation.DONE


def _never() -> bool:
    return False


def make_link(config: RobotiqConfig, aborted: Callable[[], bool] = _never) -> Link:
    """Return the way to a gripper; nothing is opened.

    Args:
        config: where it is.
        aborted: whether to give up what waits.
    """
    way = modbus_ways.transport_of(config, "robotiq", aborted)
    if config.link == "urcap":
        return UrcapLink(way)
    framing, timeout = modbus_ways.framing_of(config), config.reply_timeout
    if config.link == "controller":
        return ModbusLink(ControllerRegisters(), way, framing, timeout)
    return ModbusLink(GripperRegisters(), way, framing, timeout)


class RobotiqHand(ActivatedHand[Command]):
    """One gripper.

    What moves it leaves rACT alone (`Command.only_goal`), so that a gripper that a pendant resets just then
    is not activated by it. Only where rGTO is not set yet, after an activation or a stop by others, the first
    motion must write both: it follows a status with gACT by one exchange. So does a stop from outside of
    the I/O thread, which does not wait for one.
    """

    drops = "reset it and activate it, which opens and closes it fully and drops what it holds"
    hint = "Is it free to open and close?"

    def __init__(self, config: RobotiqConfig) -> None:
        super().__init__(config.activate)
        self._config = config
        self._given_up: Callable[[], bool] = _never
        self._link = make_link(config, lambda: self._given_up() and self._status is None)
        ratio = config.travel / config.data.stroke
        slow, fast = (ratio * speed for speed in config.data.speeds)
        self._scale = Scale(config.open_count, config.closed_count, config.travel, (slow, fast))
        self._speed = min(config.speed or fast, fast)
        text = "force of the next motions: 0 (the least) to 1 (the greatest)"
        self._force = Adjustable("force", text, config.force, lambda: (0.0, 1.0))
        self._grip = Grip()
        self._status: Status | None = None
        self._asked_at = 0.0  # for the status
        self._halt: Command | None = None
        self._sweeps = False
        limits = JointLimits(
            lower=0.0,
            upper=config.travel,
            velocity=self._speed,
            acceleration=20.0 * fast,
            jerk=1000.0 * fast,
            effort=0.0,
        )
        self.capabilities = Capabilities(
            model=config.data.title,
            joints=(config.joint,),
            joint_units=("m",),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION}),
            native_moves=frozenset({"move_jp"}),
            enable_moves=True,
            rate=config.rate,
            transition_timeout=2.0 * SWEEP,
            stop=StopPolicy(
                config.travel / slow,
                "goes on to where it was sent last, which is one setpoint or one move away; keeps its grip",
            ),
            velocity_resolution=(self._scale.step / SETTLING,),
        )

    @property
    @override
    def where(self) -> str:
        return self._link.where

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._link.counters

    # ------------------------------------------------------------------------------------- the link

    @property
    @override
    def is_open(self) -> bool:
        return self._status is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._given_up = given_up
        self._status = self._pending = self._halt = None
        self._activating = self._sweeps = False
        self._grip.begin()
        self._keep(first_answer(self._link, deadline, given_up))

    @override
    def close(self, *, moves: bool) -> None:
        """Have a stop go out first where fingers move: where the link is bad, nothing else may come to it."""
        status = self._status
        if moves and status is not None and not self.rests:
            halts = Command(position=status.requested, halts=True)
            with contextlib.suppress(DeviceError):
                self._link.shout(Command(activate=False) if self._is_activated else halts)
        self._status = None
        self._link.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        after = _may_be_told if self._writes_activation else None
        answer = self._link.exchange(self._pending, deadline, after)
        if answer is None:
            return None
        self._keep(answer)
        opening = self._scale.opening(answer.status.position)
        return Measured(answer.stamp, opening, effort=self._effort(answer.status))

    def _keep(self, answer: GripperAnswer) -> None:
        if answer.delivered is not None:
            halts = answer.delivered is self._halt
            self._grip.delivered(answer.delivered, time.monotonic(), halts=halts)
            if self._pending is answer.delivered:
                self._pending = None
        self._status, self._grip.offered = answer.status, self._pending
        self._asked_at = answer.stamp.monotonic
        self._grip.see(answer.status, self._asked_at)
        self._sweeps = self._activating or (self._sweeps and not self._has_ended(answer))
        activates = self._pending is not None and self._pending.activate
        if activates and not (self._activating or self._is(Activation.DONE)):
            self._pending = None  # one that was reset would be activated by it
        elif self._pending is not None and self._pending.go and answer.status.goes:
            self._pending = self._only_goal(self._pending)

    def _has_ended(self, answer: GripperAnswer) -> bool:
        """Whether an activation that was broken off is over: reset after that, or at its end."""
        delivered = answer.delivered
        is_reset = delivered is not None and not delivered.activate
        return is_reset or answer.status.activation is Activation.DONE

    def _effort(self, status: Status) -> float | None:
        """Return the effort in N: of the motor, so none where the fingers hold without it."""
        factor = self._config.newtons_per_ampere
        if factor is None or status.current is None:
            return None
        closes = status.requested > status.position
        return factor * status.current * (-1.0 if closes else 1.0)

    # ---------------------------------------------------------------------------------- what moves it

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> Command:
        scale = self._scale
        return Command(
            go=True,
            position=scale.position(value),
            speed=scale.speed(ratio * self._speed),
            force=scale.force(self._force.value),
        )

    @override
    def go(self, order: Command, *, at_once: bool) -> None:
        sent = None if self.taken_over else self._grip.echo.command
        goes_on = sent is not None and self._only_goal(sent) == self._only_goal(order)
        if goes_on and not at_once and self._pending is None:
            return  # and is told
        goes = self._status is not None and self._status.goes
        self._pending = self._only_goal(order) if goes else order

    @staticmethod
    def _only_goal(command: Command) -> Command:
        return command if command.only_goal else replace(command, only_goal=True)

    @override
    def let_go(self) -> None:
        self.go(self.order(Mode.JOINT_POSITION, self._config.travel, 1.0), at_once=True)

    @override
    def halt(self, *, aside: bool) -> None:
        status, pending = self._status, self._pending
        if self._is_activated:
            if pending is None or pending.activate:
                self._pending = Command(activate=False)
        elif status is None or not self._is(Activation.DONE):
            self._pending = None
        elif aside and not self.rests:
            self._halt = self._pending = Command(position=status.requested, halts=True)
        elif pending is None and (self.rests or self._halts):
            return  # a grip is kept, and a stop goes on
        elif pending is None or pending is not self._halt:
            self._halt = self._pending = self._staying(status)
        is_held_up = time.monotonic() - self._asked_at > HELD_UP
        if (aside or is_held_up) and self._pending is not None:
            self._link.shout(self._pending)

    @property
    def _is_activated(self) -> bool:
        """Whether it is being activated, so that its fingers move, by us or by somebody else."""
        return self._activating or self._sweeps or self._is(Activation.RUNNING)

    @property
    def _halts(self) -> bool:
        """Whether it has a stop of ours, and nothing has come after that."""
        echo = self._grip.echo
        return self._halt is not None and echo.command is self._halt and not echo.taken_over

    def _staying(self, status: Status) -> Command | None:
        """Return what has the fingers stay where they are, or hold on; None: they go nowhere.

        They go on until it comes. So it is where they may be then: behind them it would lead back, and let go
        of what they have just met, which is told later still.
        """
        if not status.goes:
            return None
        sent = self._grip.echo.command
        position = status.requested
        if self.doing not in HELD:
            seconds = time.monotonic() - self._asked_at + CYCLES / self._config.rate
            position = status.ahead(self._scale.gone(sent.speed if sent else COUNTS, seconds))
        sent = sent or Command()
        return Command(True, True, position, sent.speed, sent.force, only_goal=True)

    @property
    def _writes_activation(self) -> bool:
        """Whether what is sent next writes rACT, for a gripper that must have it already."""
        pending = self._pending
        if pending is None or self._activating:
            return False
        return pending.activate and not pending.only_goal

    @property
    @override
    def doing(self) -> Doing:
        return self._grip.doing

    @property
    @override
    def rests(self) -> bool:
        return not (self._grip.moves or self._is_activated) and super().rests

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def fault(self) -> Fault | None:
        return None if self._status is None else fault_of(self._status)

    @property
    @override
    def _echo(self) -> Echo[Command]:
        return self._grip.echo

    @override
    def unfit(self, *, enabled: bool) -> Condition | None:
        if self._is(Activation.DONE):
            return None
        return Condition(OperatingState.DISABLED, "it is not activated")

    @override
    def adopt(self) -> None:
        self._grip.echo.adopt()

    @override
    def _turns(self) -> Iterator[Turn]:
        if not self._is(Activation.RUNNING) or self.fault is not None:
            reset = Command(activate=False)
            yield Turn(reset, lambda: self._is(Activation.RESET), TURN, "be reset")
            begin: Command | None = Command()
        else:
            begin = None
        yield Turn(begin, lambda: self._is(Activation.DONE), SWEEP, "finish activation")

    @override
    def _activate(self) -> Steps:
        """Reset it if it must be, and activate it: the fingers open and close fully."""
        yield from super()._activate()
        self._sweeps = False

    def _is(self, activation: Activation) -> bool:
        return self._status is not None and self._status.activation is activation

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def adjustables(self) -> tuple[Adjustable, ...]:
        return (self._force,)

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        return {"current": Reading("of the motor, in A", Payload.NUMBER, self._tell_current)}

    def _tell_current(self) -> Value | None:
        current = self._status.current if self._status else None
        return None if current is None else Number(current)
