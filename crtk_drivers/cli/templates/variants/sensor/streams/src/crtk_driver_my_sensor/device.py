"""The sensor as a device of crtk-drivers: it sends measurements by itself."""

from __future__ import annotations

from collections.abc import Mapping

from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer, Capabilities, Reading, Sensor, Service, StopPolicy
from crtk_drivers.errors import TransitionFailed
from crtk_drivers.kit import Linked, MessageLink, until
from crtk_drivers.samples import Flag, Sample, Stamp, Wrench, vector
from typing_extensions import override

from crtk_driver_my_sensor.config import MySensorConfig
from crtk_driver_my_sensor.connection import REMEDY, address, transport
from crtk_driver_my_sensor.protocol import START, TARE, TARED, Force, decoder

TARE_TIMEOUT = 2.0
"""Seconds in which the sensor confirms that it tares."""


class MySensorDevice(Linked[Force | str], Sensor):
    """One sensor."""

    def __init__(self, config: MySensorConfig) -> None:
        self._config = config
        self._link = MessageLink(transport(config), decoder, REMEDY)
        self._newest = Force(0.0, False)
        self._tared = False
        self._capabilities = Capabilities(
            measured=("measured_cf",),
            rate=config.rate,
            paced_by_stream=True,
            tool_frame=config.frame_id,
            stop=StopPolicy(0.0, "has nothing that moves"),
        )

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return address(self._config)

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return {"tare": Service("make the present load zero", self._tare)}

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        summary = "whether the load is beyond its range"
        return {"overload": Reading(summary, Payload.FLAG, self._overload)}

    @override
    def open(self, deadline: float) -> None:
        self._link.open(deadline)
        self._link.await_message(deadline, lambda found: isinstance(found, Force), ask=START)

    @override
    def close(self) -> None:
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        messages = self._link.read(deadline)
        self._tared = self._tared or TARED in messages
        measured = [message for message in messages if isinstance(message, Force)]
        if not measured:
            return None
        self._newest = measured[-1]
        force = vector([0.0, 0.0, self._newest.force])
        wrench = Wrench(force, vector([0.0, 0.0, 0.0]), self._config.frame_id)
        return Sample(Stamp.now(), {"measured_cf": wrench})

    def _overload(self) -> Flag:
        return Flag(self._newest.overload)

    def _tare(self) -> Answer:
        self._tared = False
        self._link.write(TARE)
        if not (yield from until(lambda: self._tared, TARE_TIMEOUT)):
            raise TransitionFailed("it does not tare", where=self._link.where, remedy=REMEDY)
        return "the present load is zero"
