"""The stage as a device of crtk-drivers."""

from __future__ import annotations

from collections.abc import Mapping

from typing_extensions import override

from crtk_driver_one_axis.config import OneAxisConfig
from crtk_driver_one_axis.protocol import (
    KEEP_ALIVE,
    POWER_OFF,
    POWER_ON,
    STOP,
    Report,
    decoder,
    position_line,
    velocity_line,
)
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Device,
    Following,
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

JOINTS = ("slide",)
RATE = 100.0
REMEDY = "Is the stage on, and is this its address?"
SILENCE = 0.2
"""Seconds after which the stage stops by itself when it hears nothing."""
UNHEARD = 0.05
"""Seconds without a report after which no setpoint is sent: it might be carried out much later."""
FOLLOWING = Following(error=(0.02,), arrival=(1e-3,), lag=0.05)
"""The stage makes up for an error of position within 0.04 s (1/e), and a command takes a report's time."""


class OneAxisDevice(Linked[Report], Device):
    """One stage."""

    def __init__(self, config: OneAxisConfig) -> None:
        self._config = config
        transport = TcpTransport(config.host, config.port, "one_axis", REMEDY)
        self._link = MessageLink(transport, decoder, REMEDY)
        self._report: Report | None = None
        self._reports = 0
        limit = JointLimits(
            lower=0.0,
            upper=config.travel,
            velocity=config.max_speed,
            acceleration=1.0,
            jerk=20.0,
            effort=0.0,
        )
        self._capabilities = Capabilities(
            joints=JOINTS,
            limits=(limit,),
            modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}),
            measured=("measured_js",),
            rate=RATE,
            paced_by_stream=True,
            following=FOLLOWING,
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

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"reports": float(self._reports), **super().counters}

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
        self._reports += len(reports)
        position, velocity = vector([self._report.position]), vector([self._report.velocity])
        return Sample(Stamp.now(), {"measured_js": JointState(position, velocity, name=JOINTS)})

    @override
    def write(self, setpoint: Setpoint) -> None:
        if self._link.unheard > UNHEARD:
            self.stop()  # a velocity that is on its way must not be the last that comes
            return
        value = float(setpoint.values[0])
        if setpoint.mode is Mode.JOINT_POSITION:
            self._link.write(position_line(value))
        else:
            self._link.write(velocity_line(value))

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
