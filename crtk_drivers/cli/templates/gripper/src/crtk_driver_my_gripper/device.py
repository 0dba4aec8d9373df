"""The gripper as a device of crtk-drivers."""

from __future__ import annotations

from collections.abc import Mapping

from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Device,
    JointLimits,
    Mode,
    Reading,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.kit import MessageLink
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import Flag, JointState, Sample, Stamp, vector
from typing_extensions import override

from crtk_driver_my_gripper.config import MyGripperConfig
from crtk_driver_my_gripper.protocol import (
    ASK,
    POWER_OFF,
    POWER_ON,
    STOP,
    Report,
    decoder,
    opening_line,
)

REMEDY = "Is the gripper on, and is this its port and its baud rate?"
JOINTS = ("opening",)
RATE = 50.0
"""Questions a second."""
WIDEST = 0.08
"""m between the fingers."""
SILENCE = 0.2
"""Seconds after which the gripper stops by itself when it hears nothing."""


class MyGripperDevice(Device):
    """One gripper; its joint is the opening between the fingers, in m."""

    def __init__(self, config: MyGripperConfig) -> None:
        self._config = config
        self._link = MessageLink(SerialPort(config.port, config.baud), decoder, REMEDY)
        self._report: Report | None = None
        limit = JointLimits(
            lower=0.0,
            upper=WIDEST,
            velocity=config.max_speed,
            acceleration=0.5,
            jerk=10.0,
            effort=0.0,
        )
        self._capabilities = Capabilities(
            joints=JOINTS,
            limits=(limit,),
            modes=frozenset({Mode.JOINT_POSITION}),
            rate=RATE,
            transition_timeout=5.0,
            stop=StopPolicy(SILENCE, f"stops by itself {SILENCE} s after the last command"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return self._config.port

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        return {"holds": Reading("whether something is held", Payload.FLAG, self._holds)}

    @override
    def open(self, deadline: float) -> None:
        self._link.open(deadline)
        if self.read(deadline) is None:
            raise ConnectionFailed("it does not answer", where=self._link.where, remedy=REMEDY)

    @override
    def close(self) -> None:
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        self._link.write(ASK)
        reports = self._link.read(deadline)
        if not reports:
            return None
        self._report = reports[-1]
        position, velocity = vector([self._report.opening]), vector([self._report.velocity])
        return Sample(Stamp.now(), {"measured_js": JointState(position, velocity, name=JOINTS)})

    @override
    def write(self, setpoint: Setpoint) -> None:
        self._link.write(opening_line(float(setpoint.values[0])))

    @override
    def stop(self) -> None:
        self._link.write(STOP)

    @override
    def enable(self) -> Steps:
        self._link.write(POWER_ON)
        yield from self._until_powered(True)

    @override
    def disable(self) -> Steps:
        self._link.write(POWER_OFF)
        yield from self._until_powered(False)

    def _until_powered(self, powered: bool) -> Steps:
        while self._report is None or self._report.powered is not powered:
            yield

    def _holds(self) -> Flag | None:
        return None if self._report is None else Flag(self._report.holds)
