"""The stage as a device of crtk-drivers."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Mapping

from typing_extensions import override

from crtk_driver_one_axis.config import OneAxisConfig
from crtk_driver_one_axis.protocol import (
    KEEP_ALIVE,
    POWER_OFF,
    POWER_ON,
    STOP,
    BadLine,
    Decoder,
    Report,
    position_line,
    velocity_line,
)
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
from crtk_drivers.errors import ConnectionFailed, ConnectionLost, DeviceFault, ProtocolError
from crtk_drivers.samples import JointState, Sample, Stamp, vector
from crtk_drivers.state import OperatingState

JOINTS = ("slide",)
RATE = 100.0
SILENCE = 0.2
"""Seconds after which the stage stops by itself when it hears nothing."""


class OneAxisDevice(Device):
    """One stage."""

    def __init__(self, config: OneAxisConfig) -> None:
        self._config = config
        self._socket: socket.socket | None = None
        self._decoder = Decoder()
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
        return f"{self._config.host or '(no host)'}:{self._config.port}"

    @property
    @override
    def condition(self) -> Condition:
        if self._report is not None and self._report.fault:
            return Condition(OperatingState.FAULT, self._report.fault)
        return Condition()

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        return {"reports": float(self._reports)}

    @override
    def open(self, deadline: float) -> None:
        try:
            self._socket = socket.create_connection(
                (self._config.host, self._config.port), max(deadline - time.monotonic(), 0.001)
            )
            self._socket.setblocking(False)
            self._decoder = Decoder()
            if self.read(deadline) is None:
                raise ConnectionFailed("it accepts the connection and says nothing")
        except (OSError, ConnectionFailed, ConnectionLost, ProtocolError) as error:
            self.close()
            raise ConnectionFailed(
                f"cannot connect: {error}",
                where=f"one_axis {self.address}",
                remedy="Is the stage on, and is this its address?",
            ) from error

    @override
    def close(self) -> None:
        connection, self._socket = self._socket, None
        if connection is not None:
            connection.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        self._send(KEEP_ALIVE)
        reports: list[Report] = []
        while not reports:
            connection = self._connection()
            wait = max(0.0, deadline - time.monotonic())
            if not select.select([connection], [], [], wait)[0]:
                return None
            reports = self._receive(connection)
        self._report = reports[-1]
        self._reports += len(reports)
        position, velocity = vector([self._report.position]), vector([self._report.velocity])
        return Sample(Stamp.now(), {"measured_js": JointState(position, velocity, name=JOINTS)})

    @override
    def write(self, setpoint: Setpoint) -> None:
        value = float(setpoint.values[0])
        if setpoint.mode is Mode.JOINT_POSITION:
            self._send(position_line(value))
        else:
            self._send(velocity_line(value))

    @override
    def stop(self) -> None:
        self._send(STOP)

    @override
    def enable(self) -> Steps:
        self._send(POWER_ON)
        yield from self._until_powered(True)

    @override
    def disable(self) -> Steps:
        self._send(POWER_OFF)
        yield from self._until_powered(False)

    def _until_powered(self, powered: bool) -> Steps:
        while self._report is None or self._report.powered is not powered:
            if powered and self._report is not None and self._report.fault:
                raise DeviceFault(self._report.fault, remedy="Remove the cause, then enable again.")
            yield

    def _connection(self) -> socket.socket:
        if self._socket is None:
            raise ConnectionLost("it is not connected", where=f"one_axis {self.address}")
        return self._socket

    def _send(self, line: bytes) -> None:
        try:
            self._connection().send(line)
        except OSError as error:
            raise ConnectionLost(
                f"sending failed: {error}", where=f"one_axis {self.address}"
            ) from error

    def _receive(self, connection: socket.socket) -> list[Report]:
        try:
            data = connection.recv(65536)
            if not data:
                raise ConnectionLost("it closed the connection", where=f"one_axis {self.address}")
            return self._decoder.feed(data)
        except BadLine as error:
            raise ProtocolError(
                f"it sent {error}",
                where=f"one_axis {self.address}",
                remedy="Is this the port of a stage?",
            ) from error
        except OSError as error:
            if isinstance(error, ConnectionLost):
                raise
            raise ConnectionLost(str(error), where=f"one_axis {self.address}") from error
