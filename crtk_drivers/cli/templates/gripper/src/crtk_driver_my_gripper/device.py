"""The gripper by its protocol: what it is told, and what it tells."""

from __future__ import annotations

from collections.abc import Callable

from crtk_drivers.device import (
    Capabilities,
    Condition,
    JointLimits,
    Mode,
    Steps,
    StopPolicy,
)
from crtk_drivers.kit import Linked, MessageLink
from crtk_drivers.kit.gripping import Doing, GripperDevice, Hand, Measured
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState
from typing_extensions import override

from crtk_driver_my_gripper.config import MyGripperConfig
from crtk_driver_my_gripper.protocol import ASK, POWER_ON, STOP, Report, decoder, opening_line

REMEDY = "Is the gripper on, and is this its port and its baud rate?"
RATE = 50.0
"""Questions a second."""
WIDEST = 0.08
"""m between the fingers."""
SILENCE = 0.2
"""Seconds after which the gripper stops by itself when it hears nothing."""
STILL = 5e-4
"""m/s below which the fingers stand."""


def create(config: MyGripperConfig) -> GripperDevice:
    """Return the device; nothing is opened."""
    return GripperDevice(MyGripperHand(config), config.port, config.on_close)


class MyGripperHand(Linked[Report], Hand):
    """One gripper; its joint is the opening between the fingers, in m."""

    fault = None  # it reports none

    def __init__(self, config: MyGripperConfig) -> None:
        self._link = MessageLink(SerialPort(config.port, config.baud), decoder, REMEDY)
        self._report: Report | None = None
        self._doing = Doing.UNKNOWN
        self._is_told = True
        limit = JointLimits(0.0, WIDEST, config.max_speed, acceleration=0.5, jerk=10.0, effort=0.0)
        self.capabilities = Capabilities(
            joints=("opening",),
            limits=(limit,),
            modes=frozenset({Mode.JOINT_POSITION}),
            rate=RATE,
            transition_timeout=5.0,
            stop=StopPolicy(SILENCE, f"stops by itself {SILENCE} s after the last command"),
        )

    @property
    @override
    def where(self) -> str:
        return self._link.where

    @property
    @override
    def is_open(self) -> bool:
        return self._report is not None

    @override
    def open(self, deadline: float, given_up: Callable[[], bool]) -> None:
        self._report, self._doing, self._is_told = None, Doing.UNKNOWN, True
        self._link.open(deadline)
        self._report = self._link.await_message(deadline, ask=ASK)
        self._doing = self._does(self._report)

    @override
    def close(self, *, moves: bool) -> None:
        self._report = None
        self._link.close()

    @override
    def exchange(self, deadline: float) -> Measured | None:
        self._link.came()  # late answers, to older questions
        self._link.write(ASK)
        reports = self._link.read(deadline)
        if not reports:
            return None
        self._report, self._is_told = reports[-1], True
        self._doing = self._does(self._report)
        return Measured(Stamp.now(), self._report.opening, self._report.velocity)

    def _does(self, report: Report) -> Doing:
        if not report.powered:
            return Doing.INACTIVE
        if report.holds:
            return Doing.HOLDS
        if self._doing in (Doing.HOLDS, Doing.LOST):  # and nothing was asked for since
            return Doing.LOST
        return Doing.MOVING if abs(report.velocity) > STILL else Doing.THERE

    @override
    def order(self, mode: Mode, value: float, ratio: float) -> float:
        return value

    @override
    def go(self, order: float, *, at_once: bool) -> None:
        self._doing, self._is_told = Doing.MOVING, False
        self._link.write(opening_line(order))

    @override
    def halt(self, *, aside: bool) -> None:
        self._link.write(STOP)

    @override
    def let_go(self) -> None:
        self.go(WIDEST, at_once=True)

    @property
    @override
    def is_told(self) -> bool:
        return self._is_told

    @property
    @override
    def doing(self) -> Doing:
        return self._doing

    @override
    def unfit(self, *, enabled: bool) -> Condition | None:
        is_powered = self._report is None or self._report.powered
        return None if is_powered else Condition(OperatingState.DISABLED, "it has no power")

    @override
    def make_ready(self, *, may_hold: bool) -> Steps:
        self._link.write(POWER_ON)
        while self._report is None or not self._report.powered:
            yield
