"""What must not be while an arm is driven, by what its boards tell: tables, and how long each may last. Pure.

Source: ``mtsRobot1394::CheckState`` of sawRobotIO1394: 65 °C, 1.2 of the largest current and 50 mA, and the
potentiometers' tolerances are dVRK's own.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_dvrk.arm import Joints, States
from crtk_driver_dvrk.motor_file import Motor
from crtk_driver_dvrk.registers import AxisState, BoardState

HOT: Final = 65.0
"""°C at which amplifiers are switched off."""

WARM: Final = 60.0
"""°C at which that is warned of."""

_CURRENT: Final = 0.1
"""Seconds for which a current may be another one than was asked for."""

_SHARE: Final = 1.2
_NOISE: Final = 0.05
"""Of the largest current, and A beside it, that may be measured."""

_ENCODER: Final = 0.02
"""Seconds for which the signals of an encoder may be wrong."""

_LEAST: Final = 3
"""Samples in which something must be wrong that may last a time."""

_COUNTS: Final = 400.0
_LEAP: Final = 20_000.0
"""Counts, beside half of its way, by which an encoder may have moved otherwise than its velocity
says, for some time; and in no case."""


@dataclass(frozen=True, slots=True)
class Trouble:
    """What is wrong, and what to do."""

    words: str
    remedy: str

    @override
    def __str__(self) -> str:
        return f"{self.words}. {self.remedy}"


class _OfBoard(NamedTuple):
    is_so: Callable[[BoardState], bool]
    words: str
    remedy: str


class _OfAxis(NamedTuple):
    is_so: Callable[[AxisState], bool]
    words: str
    remedy: str


_CHAIN: Final = (
    "Is an emergency stop pressed, or the safety chain open? Close it, then send enable."
)
_ENCODERS: Final = "Look at its cable; home the arm with dVRK's program, then send enable."
_MOTOR: Final = "Look at the motor and its cable, and let it cool down; then send enable."

_BOARDS: Final = (
    _OfBoard(
        lambda board: board.timed_out,
        "its watchdog has expired and has switched all amplifiers off",
        "Nothing reached it in time: look at the load of this computer and at the network; then send enable.",
    ),
    _OfBoard(lambda board: not board.relay_closed, "its safety relay is open", _CHAIN),
    _OfBoard(
        lambda board: board.supply_fault,
        "the supply of its motors has a fault (over-voltage, over-current)",
        "Look at the power supply, then send enable.",
    ),
    _OfBoard(
        lambda board: not (board.power and board.voltage_good),
        "its motors have lost their voltage",
        _CHAIN,
    ),
    _OfBoard(
        lambda board: board.encoder_supply_fault,
        "the supply of its encoders has a fault",
        _ENCODERS,
    ),
    _OfBoard(
        lambda board: max(board.temperatures) > HOT,
        f"its amplifiers are hotter than {HOT:g} °C",
        "Let the controller cool down, then send enable.",
    ),
)

_AXES: Final = (
    _OfAxis(
        lambda axis: axis.is_tripped,
        "its amplifier was switched off by the board: its current was not what was asked for",
        _MOTOR,
    ),
    _OfAxis(
        lambda axis: axis.has_fault,
        "its amplifier tells a fault: too hot, or a short circuit?",
        _MOTOR,
    ),
    _OfAxis(
        lambda axis: not axis.is_on,
        "its amplifier is off",
        "Has another program switched it off? Then send enable.",
    ),
    _OfAxis(lambda axis: axis.overflow, "its encoder has counted beyond its range", _ENCODERS),
)


class Lasting:
    """Since when, and in how many samples in a row, each of several things is so."""

    def __init__(self) -> None:
        self._since: dict[Hashable, tuple[float, int]] = {}

    def clear(self) -> None:
        """Begin anew."""
        self._since.clear()

    def lasts(self, what: Hashable, longest: float, at: float, *, is_so: bool) -> bool:
        """Whether something has been so for longer than some seconds, and in three samples at least.

        Args:
            what: names it.
            longest: seconds.
            at: monotonic seconds of this sample.
            is_so: in this sample.
        """
        if not is_so:
            self._since.pop(what, None)
            return False
        since, count = self._since.get(what, (at, 0))
        self._since[what] = since, count + 1
        return count + 1 >= _LEAST and at - since > longest


class Safeguards:
    """Judges the samples of an arm whose amplifiers are on.

    Args:
        joints: of the arm.
        motors: of it, in their order.
        current_error: A by which a current may be another one than was asked for, for 0.1 s.
    """

    def __init__(self, joints: Joints, motors: tuple[Motor, ...], current_error: float) -> None:
        self._joints = joints
        self._motors = motors
        self._current_error = current_error
        self._lasting = Lasting()
        self._before: States = {}
        self._at = 0.0

    def begin(self) -> None:
        """The amplifiers have been switched on: nothing has lasted yet."""
        self._lasting.clear()
        self._before = {}

    def trouble(self, states: States, at: float) -> Trouble | None:
        """Return what is wrong; None if nothing is.

        Args:
            states: of all boards.
            at: monotonic seconds at which they were asked for.
        """
        before, self._before = self._before, states
        seconds, self._at = at - self._at, at
        found = of_boards(states) or self._of_axes(states) or self._of_positions(states, at)
        if found:
            return found
        for motor in self._motors:
            last = before.get(motor.board)
            found = self._of_current(motor, states, at) or self._of_encoder(
                motor, states, last, at, seconds
            )
            if found:
                return found
        return None

    def _of_axes(self, states: States) -> Trouble | None:
        for motor in self._motors:
            axis = states[motor.board].axes[motor.axis]
            for row in _AXES:
                if row.is_so(axis):
                    return Trouble(f"{motor.where}: {row.words}", row.remedy)
        return None

    def _of_positions(self, states: States, at: float) -> Trouble | None:
        encoders, sensed = (each.tolist() for each in self._joints.of_actuators(states))
        for motor, here, told in zip(self._motors, encoders, sensed, strict=True):
            if not motor.lower <= here <= motor.upper:
                return Trouble(
                    f"{motor.where}: at {here:.4f} it is outside [{motor.lower:g}, {motor.upper:g}]",
                    "Move it back by hand, then send enable.",
                )
            is_apart = motor.apart > 0.0 and abs(told - here) > motor.apart
            if self._lasting.lasts((motor, "apart"), motor.latency, at, is_so=is_apart):
                return Trouble(
                    f"{motor.where}: its potentiometer says {told:.4f}, its encoder {here:.4f}: more than "
                    f"{motor.apart:g} apart",
                    _ENCODERS,
                )
        return None

    def _of_current(self, motor: Motor, states: States, at: float) -> Trouble | None:
        axis = states[motor.board].axes[motor.axis]
        measured = motor.of_bits.of(axis.current)
        asked = (axis.command - motor.to_bits.offset) / motor.to_bits.scale
        most = _SHARE * motor.most + _NOISE
        is_too_much = abs(measured) >= most
        if self._lasting.lasts((motor, "most"), _CURRENT, at, is_so=is_too_much):
            words = f"{measured:.3f} A, more than {most:.3f} A"
            return Trouble(f"{motor.where}: {words}", _MOTOR)
        is_other = abs(measured - asked) > self._current_error
        if self._lasting.lasts((motor, "other"), _CURRENT, at, is_so=is_other):
            words = f"{measured:.3f} A where {asked + 0.0:.3f} A are asked for"
            return Trouble(f"{motor.where}: {words}", _MOTOR)
        return None

    def _of_encoder(
        self, motor: Motor, states: States, last: BoardState | None, at: float, seconds: float
    ) -> Trouble | None:
        axis = states[motor.board].axes[motor.axis]
        if self._lasting.lasts((motor, "signals"), _ENCODER, at, is_so=axis.jumped):
            words = "the signals of its encoder change as none does"
            return Trouble(f"{motor.where}: {words}", _ENCODERS)
        if last is None:
            return None
        before = last.axes[motor.axis]
        told = 0.5 * (before.velocity + axis.velocity) * seconds
        beside = abs(axis.counts - before.counts - told)
        room = 0.25 * (abs(before.velocity) + abs(axis.velocity)) * seconds
        if beside > _LEAP + room:
            return Trouble(f"{motor.where}: its encoder has leapt", _ENCODERS)
        is_odd = beside > _COUNTS + room
        if self._lasting.lasts((motor, "velocity"), _ENCODER, at, is_so=is_odd):
            words = "its encoder does not move as the velocity that it tells"
            return Trouble(f"{motor.where}: {words}", _ENCODERS)
        return None


def of_boards(states: States) -> Trouble | None:
    """Return what is wrong with boards that should have power; None if nothing is."""
    for number, state in states.items():
        for row in _BOARDS:
            if row.is_so(state):
                return Trouble(f"board {number}: {row.words}", row.remedy)
    return None
