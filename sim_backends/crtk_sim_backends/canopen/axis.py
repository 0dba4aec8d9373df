"""One axis of a drive: state machine, modes, controller, supervision, and the objects that show them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

from crtk_sim_backends.canopen.aborts import Abort, SdoAbort
from crtk_sim_backends.canopen.controller import PARAMETERS, Controller, position_range
from crtk_sim_backends.canopen.defects import AxisDefects, Measuring
from crtk_sim_backends.canopen.dictionary import DataType, Key, ObjectDictionary
from crtk_sim_backends.canopen.emcy import Emergency
from crtk_sim_backends.canopen.fitting import StandIn
from crtk_sim_backends.canopen.homing import METHODS, Homing, Switch
from crtk_sim_backends.canopen.machine import RAMPS, Command, Machine, Ramp, State
from crtk_sim_backends.canopen.modes import (
    HALT,
    TARGET_REACHED,
    Control,
    CyclicPosition,
    CyclicTorque,
    CyclicVelocity,
    InterpolatedPosition,
    Mode,
    ProfilePosition,
    ProfileTorque,
    ProfileVelocity,
    Setpoint,
    Window,
)
from crtk_sim_backends.canopen.objects import AXIS_STRIDE, MODES, TYPES
from crtk_sim_backends.canopen.personality import PERSONALITIES, Personality
from crtk_sim_backends.canopen.plant import Motor
from crtk_sim_backends.canopen.units import SCALING, Units

# Error codes of CiA 402-2, table 6
UNDERVOLTAGE: Final = 0x3220
MOTOR_BLOCKED: Final = 0x7121
FOLLOWING_ERROR: Final = 0x8611
SYNC_LOST: Final = 0x8700
SAFE_TORQUE_OFF: Final = 0xFF01  # of the vendor

_VOLTAGE: Final = 0x0010  # bits of the statusword
_WARNING: Final = 0x0080
_REMOTE: Final = 0x0200
_INTERNAL_LIMIT: Final = 0x0800
_INTERLOCK: Final = 1 << 3  # of the digital inputs 60FD

_TARGETS: Final = (0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60FF)
_DECELERATION: Final = {Ramp.SLOW: 0x6084, Ramp.QUICK: 0x6085, Ramp.LIMIT: 0x60C6}
_RAMP_SPEEDS: Final = {0x6083: (0x6081, 0), 0x6084: (0x6081, 0), 0x609A: (0x6099, 1)}
"""Speeds that ramps reach in their time, where the make takes times."""
_CYCLIC: Final = (CyclicPosition, CyclicVelocity, CyclicTorque)

_AT_REST: Final = 0.05  # rad/s at which a ramp down has ended
_RAMP_GRACE: Final = 0.5  # s after the ramp at which it has ended although the motor still turns
_BLOCKED_TIME: Final = 1.0  # s at the torque limit without motion
_DC_LINK: Final = 48_000  # mV


class Axis:
    """One axis.

    Args:
        number: 0, 1, ...; its objects lie 0x800 above those of the axis before.
        dictionary: of the node.
        emergency: of the node.
        motor: what it drives.
        modes: of operation that it has.
        make: what it does otherwise than others.
        defects: that it has.
        stand_ins: what it works with in place of values that only the file of a real drive allows; None: it
            is like no real drive.
    """

    def __init__(
        self,
        number: int,
        dictionary: ObjectDictionary,
        emergency: Emergency,
        motor: Motor,
        modes: frozenset[int] = frozenset(MODES),
        make: Personality = PERSONALITIES["standard"],
        defects: AxisDefects | None = None,
        stand_ins: Mapping[Key, StandIn] | None = None,
    ) -> None:
        self.number = number
        self._stand_ins = stand_ins
        self._measuring = Measuring(motor, number, defects)
        self._defects = self._measuring.defects
        self.motor = motor
        self._dictionary = dictionary
        self._offset = AXIS_STRIDE * number
        self._make = make
        self._codes = dict(make.codes)
        self._emergency = emergency
        self._values = dictionary.values
        objects = dictionary.objects
        self._units = partial(
            Units,
            has_feed=0x6092 + self._offset in objects,
            habits=make.habits,
            tells_acceleration=0x60AA + self._offset in objects,
        )
        self.units = self._units(self.value)
        self._controller = Controller(self.value, self.units, motor, self.switch, make.torque_unit)
        self.machine = Machine(self.value, self._permitted)
        self.setpoint = Setpoint()
        self.position = 0.0  # position units
        self.velocity = 0.0  # position units a second
        self.limited = False  # the target is outside of what is permitted
        self.supply = True
        self.safe_torque_off = False
        self.sync_period = 0.0  # s between the last two SYNC; 0: not known
        self.local = False  # somebody at the drive controls it: bit 9 of the statusword is 0
        self._zero = 0.0  # revolutions at which the position is 0
        self._torque = 0.0  # N·m
        self._braking = False  # on a ramp, whatever the mode
        self._ramp_rest = 0.0  # s since the setpoint of a ramp stands
        self._controlword = 0
        self._received = self._targeted = False
        self._persisting: set[int] = set()  # errors whose cause is there still
        self._outside, self._blocked = Window(), Window()
        self._homing = Homing(self)
        made = (Mode(self), ProfilePosition(self), ProfileVelocity(self), ProfileTorque(self),
                self._homing, InterpolatedPosition(self), *(kind(self) for kind in _CYCLIC))  # fmt: skip
        self._modes: dict[int, Mode] = {
            mode.number: mode for mode in made if mode.number in {0, *modes}
        }
        self._mode = self._modes[0]
        self._connect()
        self.reset()

    # The dictionary

    def _connect(self) -> None:
        od, offset = self._dictionary, self._offset
        for index in SCALING:
            od.written[index + offset] = lambda _: self._rescale()
            od.checks[index + offset] = partial(self._check_scale, index)
        for index in PARAMETERS:
            od.written[index + offset] = lambda _: self._controller.update()
        for index in _TARGETS:
            od.written[index + offset] = self._note_target
        od.written[0x6040 + offset] = self._note_controlword
        od.guards[0x6040 + offset] = self._guard_controlword
        od.checks[0x6060 + offset] = lambda _, mode: _require(mode in self._modes)
        od.checks[0x6098 + offset] = lambda _, method: _require(
            method in METHODS or self._stand_ins is not None
        )
        od.checks[0x607D + offset] = self._check_limits
        if self._make.tells_modes is not None:
            told = self._make.tells_modes
            od.live[0x6502 + offset, 0] = lambda: told
        if self._make.pulses is not None:
            od.written[self._make.pulses[0]] = lambda _: self._count_pulses()
        shown: dict[int, Callable[[], int]] = {
            0x6041: self.statusword,
            0x6061: lambda: self._mode.number,
            0x6062: lambda: _wrapped(self._demand()),
            0x6063: lambda: _wrapped(self._sensed()[0] * self.units.increments),
            0x6064: lambda: _wrapped((self._sensed()[0] - self._zero) * self.units.per_revolution),
            0x6069: self._actual_velocity,
            0x606B: lambda: _i32(self.setpoint.velocity * self.units.shown),
            0x606C: self._actual_velocity,
            0x6074: self._torque_permille,
            0x6077: self._torque_permille,
            0x6078: self._torque_permille,
            0x6079: lambda: _DC_LINK if self.supply else 0,
            0x60F4: lambda: _i32(self._demand() - self.position),
            0x60FA: self._control_effort,
            0x60FC: self._demand_increments,
            0x60FD: self._inputs,
        }
        for index, read in shown.items():
            if od.variables[index + offset, 0].type is TYPES[index]:
                od.live[index + offset, 0] = read

    def value(self, index: int, sub: int = 0) -> int:
        """Value of an object of the axis, of those that are not computed when read."""
        key = index + self._offset, sub
        return self._worked_with(key, self._values[key])  # type: ignore[arg-type]

    def _worked_with(self, key: Key, value: int) -> int:
        """What the machine works with where an object holds a value."""
        if self._stand_ins and (other := self._stand_ins.get(key)) is not None:
            return value if other.low <= value <= other.high else other.value
        return value

    def shown(self, index: int) -> int:
        """Value of an object of the axis as others read it."""
        return self._dictionary[index + self._offset, 0]

    def speed(self, index: int, sub: int = 0) -> float:
        """Value of a velocity object in position units a second."""
        return self.value(index, sub) / self.units.velocity

    def acceleration(self, index: int) -> float:
        """Value of an acceleration object in position units a second squared."""
        ramp = self.units.ramp_time
        if ramp is None or index not in _RAMP_SPEEDS:
            return self.value(index) / self.units.acceleration
        # To no speed at all a ramp would have no acceleration: then it is that to one unit.
        speed = self.speed(*_RAMP_SPEEDS[index]) or 1.0 / self.units.velocity
        return speed / (self.value(index) * ramp)

    @property
    def period(self) -> float:
        """Interpolation time period, s; that of SYNC for a drive that is not told it, or 0."""
        told = 0x60C2 + self._offset in self._dictionary.objects
        if self.sync_period and not (told and self._values[0x60C2 + self._offset, 1]):
            return self.sync_period
        return float(self.value(0x60C2, 1) * 10.0 ** self.value(0x60C2, 2))

    def _note_target(self, sub: int) -> None:
        self._targeted = True

    def _note_controlword(self, sub: int) -> None:
        self._received = True

    def _guard_controlword(self, sub: int, word: int) -> None:
        if self.local:
            raise SdoAbort(Abort.LOCAL_CONTROL)

    def _check_limits(self, sub: int, value: int) -> None:
        low, high = (value if sub == n else self.value(0x607D, n) for n in (1, 2))
        if low > high:
            raise SdoAbort(Abort.MAX_BELOW_MIN)

    def _check_scale(self, index: int, sub: int, value: int) -> None:
        """Refuse a value with which nothing could be counted any more."""
        key = index + self._offset, sub
        wanted = self._worked_with(key, value)

        def tried(other: int, part: int = 0) -> int:
            return wanted if (other, part) == (index, sub) else self.value(other, part)

        try:
            sane = self._units(tried).sane
        except ArithmeticError:
            sane = False
        _require(sane)

    def _count_pulses(self) -> None:
        assert self._make.pulses is not None
        self._values[0x608F + self._offset, 1] = 4 * self._dictionary[self._make.pulses]
        self._rescale()

    def _rescale(self) -> None:
        self.units.update()
        self._controller.update()
        self._measure()
        self._align()

    def _control_effort(self) -> int:
        reference = self._controller.reference_velocity(self.setpoint, self.position)
        return _i32(reference * self.units.velocity)

    def _demand(self) -> float:
        following = self.setpoint.control is Control.POSITION and self.powered
        return self.setpoint.position if following else self.position

    def _demand_increments(self) -> int:
        revolutions = self._demand() / self.units.per_revolution + self._zero
        return _wrapped(revolutions * self.units.increments)

    def _torque_permille(self) -> int:
        permille = 1000 * self._sensed()[2] / (self.value(0x6076) * self._make.torque_unit)
        return max(-0x8000, min(0x7FFF, round(permille))) * self.forward

    def _actual_velocity(self) -> int:
        return _i32(self._sensed()[1] * self._controller.scale * self.units.shown)

    def _sensed(self) -> tuple[float, float, float]:
        return self._measuring.tell(self._torque)

    def _inputs(self) -> int:
        switches = sum(1 << switch.value for switch in Switch if self.switch(switch))
        return switches | (_INTERLOCK if self.safe_torque_off else 0)

    # What modes and homing see

    @property
    def powered(self) -> bool:
        """Whether the motor has current."""
        return self.machine.powered

    @property
    def idle(self) -> bool:
        """Whether nothing changes with time."""
        return not self.powered and self.motor.at_rest and not self._measuring.changes

    @property
    def revolutions(self) -> float:
        """Position of the motor, revolutions."""
        return self.motor.revolutions

    @property
    def forward(self) -> int:
        """1, or -1 when the polarity turns the motor round."""
        return 1 if self.units.per_revolution > 0 else -1

    @property
    def saturated(self) -> bool:
        """Whether the torque is at its limit."""
        return self._controller.saturated

    def switch(self, switch: Switch) -> bool:
        """Whether a switch is active; limit switches by the direction of the axis."""
        if switch is Switch.HOME:
            return self.motor.home
        positive = (switch is Switch.POSITIVE) == (self.forward > 0)
        return self.motor.positive_limit if positive else self.motor.negative_limit

    def edge_between(self, switch: Switch, first: float, last: float) -> float:
        """Where between two positions (revolutions) a switch has its edge; `last` if it has none."""
        config = self.motor.config
        edges = config.home
        if switch is not Switch.HOME:
            edges = (config.negative_limit, config.positive_limit)
        low, high = min(first, last), max(first, last)
        return next((edge for edge in edges if low <= edge <= high), last)

    def set_home(self, revolutions: float) -> None:
        """Let the position be that of the home offset 607C, or of what the make has for it, where the motor
        stood at `revolutions`.
        """
        before = self._zero
        position = self.value(0x607C)
        if self._make.offset_to_zero:
            position = -position
        if self._make.home_position is not None:
            position = self._dictionary[self._make.home_position] - self.home_move
        self._zero = revolutions - position / self.units.per_revolution
        self.setpoint.position -= (self._zero - before) * self.units.per_revolution
        self._measure()

    @property
    def per_revolution(self) -> float:
        """Position units in one revolution of the motor, negative when reversed."""
        return self.units.per_revolution

    @property
    def home_move(self) -> int:
        """How far it goes after homing, position units."""
        return self._dictionary[self._make.home_move] if self._make.home_move is not None else 0

    def within_limits(self, position: float) -> float:
        """Bring a position within the software limits; sets `limited` when it was not."""
        low, high = position_range(self.value)
        inside = min(max(position, low), high)
        self.limited = inside != position
        return inside

    @property
    def following_error(self) -> bool:
        """Whether the position is out of the following error window."""
        outside = abs(self._demand() - self.position) > self._controller.window
        return outside and not self._homing.searches_stop

    # Commands

    def reset(self) -> None:
        """Begin anew, as a reset of the node does; the motor keeps what motion it has."""
        self.machine.reset()
        self._mode = self._modes[0]
        self._controlword = 0
        self._received = self._targeted = False
        self._zero = 0.0
        self._torque = 0.0
        self.units.update()
        self._controller.update()
        self._measure()
        self._align()

    def process(self, *, sync: bool = False) -> None:
        """Do what has been written since the last call: mode, controlword, targets.

        With `sync`, the targets in the dictionary are valid now, whether they are new or not.
        """
        mode = self._modes[self.value(0x6060)]
        if mode is not self._mode:
            self._measure()
            if self.setpoint.control is not Control.POSITION:
                self._align()
            self._mode = mode
            self._enter_mode()
        if self._received:
            self._received = False
            self._control(self.value(0x6040))
        if self._targeted or sync:
            self._targeted = False
            if self.machine.enabled and self.machine.ramp is None:
                self._mode.targets()

    def _control(self, word: int) -> None:
        before, self._controlword = self._controlword, word
        machine = self.machine
        was_enabled, was_faulted = machine.enabled, machine.faulted
        if word == before and was_enabled and machine.ramp is None:
            return
        machine.control(word, fault_present=bool(self._persisting))
        if was_faulted and not machine.faulted:
            self._set_error(0)
            self._emergency.ends_of(self.number)
        if not machine.enabled:
            return
        if not was_enabled:
            self._align()
            self._enter_mode()
            before &= ~0x7F  # a bit that was set before counts as an edge now
        if word & HALT and not before & HALT and self._mode is self._homing:
            self._homing.halt()
        self._mode.control(word, before)

    def _enter_mode(self) -> None:
        self.limited = False
        self._outside, self._blocked = Window(), Window()
        self._mode.enter()

    def _permitted(self, transition: int) -> bool:
        if self._make.faults_at_stop and self.safe_torque_off:
            if transition in (3, 4):
                self.fault(SAFE_TORQUE_OFF, persists=True)
            return transition not in (3, 4)
        if transition == 2:
            return not self.safe_torque_off
        if transition in (3, 4):
            return self.supply and not self.safe_torque_off
        return True

    # Errors

    def _set_error(self, code: int) -> None:
        self._dictionary[0x603F + self._offset, 0] = code

    def fault(self, code: int, vendor: bytes = b"", *, persists: bool = False) -> None:
        """Have an error: EMCY, error code 603F, and the fault reaction.

        Args:
            code: error code.
            vendor: up to 5 bytes of the manufacturer.
            persists: it cannot be reset until `recovered` is called with the code.
        """
        code = self._codes.get(code, code)
        if persists:
            self._persisting.add(code)
        self._set_error(code)
        self._emergency.begin(code, vendor, self.number)
        self.machine.fault()

    def recovered(self, code: int) -> None:
        """The cause of an error is gone, so that the fault can be reset."""
        self._persisting.discard(self._codes.get(code, code))

    def set_supply(self, on: bool) -> None:
        """Switch the power supply of the motor; that of the electronics stays."""
        self.supply = on
        if on:
            self.recovered(UNDERVOLTAGE)
        elif self.powered:
            self.fault(UNDERVOLTAGE, persists=True)
            self.machine.cut_power(fault=True)
        elif self.machine.state is State.SWITCHED_ON:
            self.machine.cut_power(fault=False)

    def set_safe_torque_off(self, active: bool) -> None:
        """Activate or release the STO inputs."""
        self.safe_torque_off = active
        if not active:
            self.recovered(SAFE_TORQUE_OFF)
            if not self.machine.faulted:
                self._emergency.end(SAFE_TORQUE_OFF, self.number)
            return
        if self.powered:
            self.fault(SAFE_TORQUE_OFF, persists=True)
            self.machine.cut_power(fault=True)
            return
        if self._make.faults_at_stop:
            return
        self._emergency.begin(SAFE_TORQUE_OFF, b"", self.number)
        if self.machine.state in (State.READY_TO_SWITCH_ON, State.SWITCHED_ON):
            self.machine.cut_power(fault=False)

    def connection_lost(self, code: int) -> None:
        """Do what 6007 asks for when the master is gone or has stopped the node."""
        if self._defects.ignores_watchdog:
            return
        match self.value(0x6007):
            case 1:
                self.fault(code)
            case 2:
                self.machine.control(Command.DISABLE_VOLTAGE.value[1], fault_present=True)
            case 3:
                self.machine.quick_stop()

    def sync_lost(self) -> None:
        """Fault when the mode needs SYNC."""
        if self._defects.ignores_watchdog:
            return
        if self.machine.enabled and isinstance(self._mode, _CYCLIC):
            self.fault(SYNC_LOST)

    # Time

    def step(self, dt: float) -> None:
        """Advance by one control period."""
        self._measuring.live(dt, powered=self.powered)
        if not self.powered:
            self._torque = 0.0
            self.motor.step(0.0, dt, powered=False)
            self._measure()
            self._align()
            return
        ramp = self._present_ramp()
        if ramp is None:
            self._braking = False
            self._ramp_rest = 0.0
            self._mode.step(dt)
        else:
            self._brake(ramp, dt)
        aside = self._defects.following_offset / math.tau * self.units.per_revolution
        self._torque = self._controller.torque(self.setpoint, self.position - aside, dt)
        self.motor.step(self._torque, dt, powered=True)
        self._measure()
        self._supervise(dt)

    def _present_ramp(self) -> Ramp | None:
        if self.machine.ramp is not None:
            return self.machine.ramp
        return RAMPS[0x605D][self.value(0x605D)] if self._halted else None

    @property
    def _halted(self) -> bool:
        return bool(self._controlword & HALT) and self._mode.halts

    def _brake(self, ramp: Ramp, dt: float) -> None:
        """Ramp down whatever the mode does, and stay there."""
        setpoint = self.setpoint
        if setpoint.control is not Control.POSITION or not self._braking:
            self._begin_to_brake()
        change = self.acceleration(_DECELERATION[ramp]) * dt / self._defects.slow_stop
        setpoint.velocity = math.copysign(
            max(0.0, abs(setpoint.velocity) - change), setpoint.velocity
        )
        setpoint.position += setpoint.velocity * dt
        if setpoint.velocity:
            self._ramp_rest = 0.0
            return
        self._ramp_rest += dt
        if abs(self.motor.velocity) < _AT_REST or self._ramp_rest > _RAMP_GRACE:
            self.machine.rested()

    def _begin_to_brake(self) -> None:
        """Let the ramp begin with the setpoint, or with the motor when that has not followed."""
        setpoint = self.setpoint
        follows = (
            self.machine.state is not State.FAULT_REACTION
            and not self.following_error
            and abs(setpoint.velocity / self._controller.scale) <= self._controller.fastest
        )
        if setpoint.control is not Control.POSITION or not follows:
            setpoint.position = self.position
        if setpoint.control is Control.TORQUE or not follows:
            setpoint.velocity = self.velocity
        setpoint.control = Control.POSITION
        setpoint.torque = 0.0
        self._braking = True

    def _supervise(self, dt: float) -> None:
        """Look for what is an error in operation."""
        if not self.machine.enabled:
            return
        setpoint = self.setpoint
        if setpoint.control is Control.POSITION:
            self._outside.hold(self.following_error, dt)
            if self._outside.seconds and self._outside.lasted(self.value(0x6066)):
                self.fault(FOLLOWING_ERROR)
            if setpoint.velocity and self._mode is not self._homing:
                ahead = Switch.POSITIVE if setpoint.velocity > 0 else Switch.NEGATIVE
                if self.switch(ahead):
                    self.fault(self._make.limit_codes[ahead is Switch.POSITIVE])
        elif setpoint.control is Control.VELOCITY:
            self._blocked.hold(self.saturated and abs(self.motor.velocity) < _AT_REST, dt)
            if self._blocked.seconds >= _BLOCKED_TIME:
                self.fault(MOTOR_BLOCKED)

    def _measure(self) -> None:
        self.position = (self.motor.revolutions - self._zero) * self.units.per_revolution
        self.velocity = self.motor.velocity * self._controller.scale

    def _align(self) -> None:
        """Let the setpoint stand where the axis is."""
        self.setpoint.control = Control.POSITION
        self.setpoint.position = self.position
        self.setpoint.velocity = self.velocity if self.powered else 0.0
        self.setpoint.torque = 0.0
        self._controller.reset(self.setpoint.velocity)
        self._braking = False
        self._ramp_rest = 0.0

    def statusword(self) -> int:
        """Object 6041."""
        machine = self.machine
        word: int = machine.word
        word |= _VOLTAGE if self.supply else 0
        word |= _WARNING if self.safe_torque_off else 0
        word |= 0 if self.local else _REMOTE
        if machine.powered:
            if self.limited or self._controller.saturated or self._controller.held:
                word |= _INTERNAL_LIMIT
            if machine.enabled:
                word |= self._mode.status(self._halted)
            elif machine.state is State.QUICK_STOP_ACTIVE and not self.setpoint.velocity:
                word |= TARGET_REACHED
        return word


def _require(condition: bool) -> None:
    if not condition:
        raise SdoAbort(Abort.VALUE)


def _i32(value: float) -> int:
    low, high = DataType.I32.limits
    return max(low, min(high, round(value)))


def _wrapped(value: float) -> int:
    """Position as 32-bit number, which wraps as the counter of a drive does."""
    return (round(value) + 0x8000_0000 & 0xFFFF_FFFF) - 0x8000_0000
