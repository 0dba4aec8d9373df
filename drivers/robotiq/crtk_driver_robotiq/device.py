"""A Robotiq gripper as a CRTK device: one joint, the opening between its fingers."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Final

from typing_extensions import override

from crtk_driver_robotiq.config import RobotiqConfig
from crtk_driver_robotiq.faults import Fault, Weight, fault_of
from crtk_driver_robotiq.grip import Doing, Grip
from crtk_driver_robotiq.links import Answer, Link, ModbusLink, UrcapLink
from crtk_driver_robotiq.modbus import Mbap, Rtu
from crtk_driver_robotiq.registers import Activation, Command, Status
from crtk_driver_robotiq.scale import Scale
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Answer as Told,
)
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Goal,
    Input,
    JointLimits,
    Mode,
    MoveProgress,
    Note,
    Reading,
    Service,
    Setpoint,
    Severity,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    DeviceError,
    DeviceFault,
    Reason,
    TransitionFailed,
    with_remedy,
)
from crtk_drivers.kit import TcpTransport, until
from crtk_drivers.samples import Flag, JointState, Number, Sample, Text, Value, vector
from crtk_drivers.state import OperatingState

__all__ = ["RobotiqDevice", "make_link"]

SETTLING: Final = 0.1
"""Time constant of the velocity in s: one count of the position is 0.4 mm."""
SWEEP: Final = 10.0
"""Seconds that an activation may take."""
TURN: Final = 2.0
"""Seconds in which a command must show."""
PIECE: Final = 0.05
"""Seconds after which `open` looks whether it is given up."""
FAREWELL: Final = 0.5
"""Seconds in which `on_close: release` is told to it."""


def _never() -> bool:
    return False


def make_link(config: RobotiqConfig, aborted: Callable[[], bool] = _never) -> Link:
    """Return the way to a gripper; nothing is opened.

    Args:
        config: where it is.
        aborted: whether to give up what waits.
    """
    if config.link == "serial":
        from crtk_drivers.kit.serial_port import SerialPort  # needs pyserial

        port = SerialPort(config.port, config.baud)
        return ModbusLink(port, Rtu(config.address), config.reply_timeout)
    remedy = "Check the address, the network, and that the robot is on."
    tcp = TcpTransport(
        config.host, config.number, f"robotiq {config.link}", remedy, aborted=aborted
    )
    if config.link == "urcap":
        return UrcapLink(tcp)
    framing = Rtu(config.address) if config.link == "tool" else Mbap(config.address)
    return ModbusLink(tcp, framing, config.reply_timeout)


class RobotiqDevice(Device):
    """One gripper."""

    def __init__(self, config: RobotiqConfig) -> None:
        self._config = config
        self._link = make_link(config, lambda: self._closing and self._status is None)
        ratio = config.travel / config.data.stroke
        slow, fast = (ratio * speed for speed in config.data.speeds)
        self._scale = Scale(config.open_count, config.closed_count, config.travel, (slow, fast))
        self._speed = min(config.speed or fast, fast)
        self._force = config.force
        self._grip = Grip()
        self._status: Status | None = None
        self._pending: Command | None = None
        self._activating = False
        self._was_enabled = self._closing = False
        self._io: int | None = None
        self._motion: tuple[float, float, float] | None = None  # when, where, how fast
        limits = JointLimits(
            lower=0.0,
            upper=config.travel,
            velocity=self._speed,
            acceleration=20.0 * fast,
            jerk=1000.0 * fast,
            effort=0.0,
        )
        self._capabilities = Capabilities(
            joints=(config.joint,),
            limits=(limits,),
            modes=frozenset({Mode.JOINT_POSITION}),
            native_moves=frozenset({"move_jp"}),
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
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        if self._config.link == "serial":
            return self._config.port
        return f"{self._config.host}:{self._config.number}"

    # ------------------------------------------------------------------------------------- the link

    @override
    def open(self, deadline: float) -> None:
        self._io = threading.get_ident()
        self._status = self._pending = self._motion = None
        self._activating = self._was_enabled = False
        self._grip.begin()
        self._link.open(deadline)
        while self._read(min(deadline, time.monotonic() + PIECE)) is None:
            if self._closing or time.monotonic() >= deadline:
                text, remedy = self._link.trouble
                self._link.close()
                raise ConnectionFailed(text, where=self._link.where, remedy=remedy)

    @override
    def abort_open(self) -> None:
        self._closing = True

    @override
    def close(self) -> None:
        if self._closing and self._was_enabled and self._config.on_close == "release":
            self._release()
        self._was_enabled = False
        self._status = None
        self._link.close()

    def _release(self) -> None:
        """Open it, the last act of a program that ends in good order."""
        if self.condition.allows is not OperatingState.ENABLED:
            return
        self._pending = opening = self._to(self._config.travel, self._speed)
        deadline = time.monotonic() + FAREWELL
        try:
            while self._pending is opening and time.monotonic() < deadline:
                self._read(deadline)
        except DeviceError:
            self._was_enabled = False

    @override
    def read(self, deadline: float) -> Sample | None:
        self._io = threading.get_ident()
        answer = self._read(deadline)
        if answer is None:
            return None
        at, status = answer.stamp.monotonic, answer.status
        position = self._scale.opening(status.position)
        _, before, velocity = self._motion or (at, position, 0.0)
        elapsed = at - self._motion[0] if self._motion else 0.0
        if elapsed > 0.0:
            share = elapsed / (SETTLING + elapsed)
            velocity += share * ((position - before) / elapsed - velocity)
        self._motion = at, position, velocity
        effort = self._effort(status)
        state = JointState(
            vector([position]),
            vector([velocity]),
            vector([] if effort is None else [effort]),
            name=self._capabilities.joints,
        )
        return Sample(answer.stamp, {"measured_js": state})

    def _read(self, deadline: float) -> Answer | None:
        """Exchange once, and keep what was told."""
        answer = self._link.exchange(self._pending, deadline)
        if answer is None:
            return None
        now = time.monotonic()
        if answer.delivered is not None:
            self._grip.delivered(answer.delivered, now)
            if self._pending is answer.delivered:
                self._pending = None
        self._status = answer.status
        self._grip.see(answer.status, now)
        return answer

    def _effort(self, status: Status) -> float | None:
        """Return the effort in N: of the motor, so none where the fingers hold without it."""
        factor = self._config.newtons_per_ampere
        if factor is None or status.current is None:
            return None
        closes = status.requested > status.position
        return factor * status.current * (-1.0 if closes else 1.0)

    # ---------------------------------------------------------------------------------- what moves it

    def _to(self, opening: float, speed: float) -> Command:
        scale = self._scale
        return Command(
            go=True,
            position=scale.position(opening),
            speed=scale.speed(speed),
            force=scale.force(self._force),
        )

    @override
    def write(self, setpoint: Setpoint) -> None:
        self._pending = self._to(float(setpoint.values[0]), self._speed)

    @override
    def move(self, goal: Goal) -> None:
        assert goal.joints is not None
        self._pending = self._to(float(goal.joints[0]), goal.ratios.velocity * self._speed)

    @override
    def move_progress(self) -> MoveProgress:
        if self._grip.taken_over or self._grip.doing in (Doing.STOPPED, Doing.INACTIVE):
            return MoveProgress.RUNNING if self._pending else MoveProgress.FAILED
        rests = self._grip.rests and self._pending is None
        return MoveProgress.DONE if rests else MoveProgress.RUNNING

    @property
    @override
    def has_arrived(self) -> bool:
        return self._pending is None and self._grip.rests

    @override
    def stop(self) -> None:
        status, pending = self._status, self._pending
        if status is None or (self._closing and self._config.on_close == "nothing"):
            return
        if self._activating:
            halt = Command(activate=False)
        elif self._grip.rests and not (pending and pending.go):
            return  # a grip is kept
        elif pending and not pending.go:
            halt = pending
        else:
            halt = Command(position=status.requested)
        self._pending = halt
        if threading.get_ident() != self._io:
            self._link.shout(halt)

    @property
    @override
    def has_stopped(self) -> bool:
        return self._pending is None and self._grip.rests

    # --------------------------------------------------------------------------------------- its state

    @property
    @override
    def found(self) -> str:
        status = self._status
        if status is None or status.activation is not Activation.DONE or not status.goes:
            return ""
        return f"it is activated, and {self._grip.doing}"

    @property
    def _fault(self) -> Fault | None:
        return None if self._status is None else fault_of(self._status)

    @property
    @override
    def condition(self) -> Condition:
        status, fault = self._status, self._fault
        if status is None:
            return Condition()
        if fault is not None and fault.weight in (Weight.STOPS, Weight.RESET):
            return Condition(OperatingState.FAULT, with_remedy(fault.text, fault.remedy))
        if status.activation is not Activation.DONE:
            return Condition(OperatingState.DISABLED, "it is not activated")
        if self._grip.taken_over:
            return Condition(OperatingState.PAUSED, "another program sent it elsewhere")
        return Condition()

    @override
    def enable(self) -> Steps:
        status, fault, policy = self._status, self._fault, self._config.activate
        assert status is not None
        if fault is not None and fault.weight is Weight.STOPS:
            raise DeviceFault(fault.text, where=self._link.where, remedy=fault.remedy)
        needed = status.activation is not Activation.DONE or (
            fault is not None and fault.weight is Weight.RESET
        )
        if needed and policy != "always":
            self._may_activate(fault)
        if needed or policy == "always":
            yield from self._activate()
        if not self._grip.rests:  # it goes where somebody else has sent it
            self.stop()
            yield from self._shown(lambda: self._grip.rests, TURN, "stop")
        self._grip.adopt()
        self._was_enabled = True

    def _may_activate(self, fault: Fault | None) -> None:
        what = "it is not activated" if fault is None else fault.text
        if self._config.activate == "never":
            raise TransitionFailed(
                what,
                where=self._link.where,
                remedy="Activate it at the robot's pendant, or by the service activate.",
            )
        if self._grip.may_hold:
            raise TransitionFailed(
                f"{what}, and may still hold something, which to activate it would drop",
                where=self._link.where,
                remedy="Take that out; then the service activate opens and closes it.",
            )

    def _activate(self) -> Steps:
        """Reset it if it must be, and activate it: the fingers open and close fully."""
        self._activating = True
        try:
            if not self._is(Activation.RUNNING) or self._fault is not None:
                self._pending = Command(activate=False)
                yield from self._shown(lambda: self._is(Activation.RESET), TURN, "be reset")
                self._pending = Command()
            yield from self._shown(lambda: self._is(Activation.DONE), SWEEP, "finish activation")
        finally:
            self._activating = False
        self._grip.may_hold = False

    def _shown(self, test: Callable[[], bool], timeout: float, what: str) -> Steps:
        done = yield from until(lambda: self._pending is None and test(), timeout)
        if not done:
            fault = self._fault
            raise TransitionFailed(
                f"it did not {what} in {timeout:g} s{f': {fault.text}' if fault else ''}",
                where=self._link.where,
                remedy=fault.remedy if fault else "Is it free to open and close?",
            )

    def _is(self, activation: Activation) -> bool:
        return self._status is not None and self._status.activation is activation

    # ------------------------------------------------------------------------------------ beyond CRTK

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        text = "reset it and activate it, which opens and closes it fully and drops what it holds"
        return {"activate": Service(text, self._activated)}

    def _activated(self) -> Told:
        yield from self._activate()
        return "activated"

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        text = "force of the next motions: 0 (the least) to 1 (the greatest)"
        return {"force": Input(text, Payload.NUMBER, self._take_force)}

    def _take_force(self, share: Number) -> None:
        if not (math.isfinite(share.value) and 0.0 <= share.value <= 1.0):
            raise CommandRefused(
                "force",
                Reason.OUT_OF_RANGE,
                f"a force of {share.value:g}",
                where=self._link.where,
                remedy="It is a share, from 0 to 1; newtons are in the table of the documentation.",
            )
        self._force = share.value

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        return {
            "holds": Reading("whether it holds something", Payload.FLAG, self._tell_holds),
            "grip": Reading("what the fingers do", Payload.TEXT, self._tell_grip),
            "current": Reading("of the motor, in A", Payload.NUMBER, self._tell_current),
            "fault": Reading("what it reports; empty: nothing", Payload.TEXT, self._tell_fault),
        }

    def _tell_holds(self) -> Value | None:
        return None if self._grip.doing is Doing.UNKNOWN else Flag(self._grip.holds)

    def _tell_grip(self) -> Value | None:
        return Text(self._grip.doing)

    def _tell_current(self) -> Value | None:
        current = self._status.current if self._status else None
        return None if current is None else Number(current)

    def _tell_fault(self) -> Value | None:
        if self._status is None:
            return None
        fault = self._fault
        return Text("" if fault is None else with_remedy(fault.text, fault.remedy))

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        found: list[tuple[str, str]] = []
        if self._grip.doing is Doing.LOST:
            found.append(("object", "what it held is gone"))
        fault = self._fault
        if fault is not None and fault.weight is Weight.PASSES:
            found.append(("fault", fault.text))
        return tuple(Note(Severity.WARNING, key, text) for key, text in found)

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return self._link.counters
