"""The arm as a device of crtk-drivers."""

from __future__ import annotations

from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    JointLimits,
    Mode,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import CrtkError, DeviceFault, raise_first
from crtk_drivers.kit import Linked, MessageLink, TcpTransport
from crtk_drivers.samples import JointState, Sample, Stamp, vector
from crtk_drivers.state import OperatingState
from typing_extensions import override

from crtk_driver_my_arm.config import MyArmConfig
from crtk_driver_my_arm.protocol import (
    JOINTS,
    KEEP_ALIVE,
    POWER_OFF,
    POWER_ON,
    STOP,
    Report,
    decoder,
    position_line,
    velocity_line,
)

REMEDY = "Is the arm on, and is this its address?"
RATE = 100.0
"""Reports a second."""
RANGE = 2.0
"""rad, to both sides."""
SILENCE = 0.2
"""Seconds after which the arm stops by itself when it hears nothing."""
UNHEARD = 0.05
"""Seconds without a report after which no setpoint is sent: it might be carried out much later."""


class MyArmDevice(Linked[Report], Device):
    """One arm."""

    def __init__(self, config: MyArmConfig) -> None:
        self._config = config
        transport = TcpTransport(config.host, config.port, "my_arm", REMEDY)
        self._link = MessageLink(transport, decoder, REMEDY)
        self._report: Report | None = None
        limit = JointLimits(
            lower=-RANGE,
            upper=RANGE,
            velocity=config.max_speed,
            acceleration=4.0,
            jerk=80.0,
            effort=0.0,
        )
        self._capabilities = Capabilities(
            joints=JOINTS,
            limits=(limit,) * len(JOINTS),
            modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}),
            rate=RATE,
            paced_by_stream=True,
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
        return f"{self._config.host}:{self._config.port}"

    @property
    @override
    def condition(self) -> Condition:
        if self._report is not None and self._report.fault:
            return Condition(OperatingState.FAULT, self._report.fault)
        return Condition()

    @property
    @override
    def obstacles(self) -> tuple[CrtkError, ...]:
        if self._report is None or not self._report.fault:
            return ()
        remedy = "Remove the cause, then enable again."
        return (DeviceFault(self._report.fault, where=self.address, remedy=remedy),)

    @override
    def open(self, deadline: float) -> None:
        self._link.open(deadline)
        self._report = self._link.await_message(deadline, ask=KEEP_ALIVE)

    @override
    def close(self) -> None:
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        self._link.write(KEEP_ALIVE)
        reports = self._link.read(deadline)
        if not reports:
            return None
        self._report = reports[-1]
        position, velocity = vector(self._report.position), vector(self._report.velocity)
        return Sample(Stamp.now(), {"measured_js": JointState(position, velocity, name=JOINTS)})

    @override
    def write(self, setpoint: Setpoint) -> None:
        if self._link.unheard > UNHEARD:
            self.stop()  # a velocity that is on its way must not be the last that comes
            return
        in_position = setpoint.mode is Mode.JOINT_POSITION
        line = position_line if in_position else velocity_line
        self._link.write(line(setpoint.values.tolist()))

    @override
    def stop(self) -> None:
        self._link.write(STOP)

    @override
    def enable(self) -> Steps:
        raise_first(self.obstacles)
        self._link.write(POWER_ON)
        yield from self._until_powered(True)

    @override
    def disable(self) -> Steps:
        self._link.write(POWER_OFF)
        yield from self._until_powered(False)

    def _until_powered(self, powered: bool) -> Steps:
        while self._report is None or self._report.powered is not powered:
            if powered:
                raise_first(self.obstacles)
            yield
