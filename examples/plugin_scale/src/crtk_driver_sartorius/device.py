"""The scale as a device of crtk-drivers: it is asked for each weight."""

from collections.abc import Mapping

from typing_extensions import override

from crtk_driver_sartorius.config import SartoriusConfig
from crtk_driver_sartorius.protocol import ASK, KG, TARE, Weight, decoder
from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer, Capabilities, Reading, Sensor, Service, StopPolicy
from crtk_drivers.errors import ProtocolError, TransitionFailed
from crtk_drivers.kit import Linked, MessageLink, until
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import Flag, Sample, Stamp, Wrench, vector

GRAVITY = 9.80665
REMEDY = "Is it on, and does this port lead to it: 9600 bit/s, 7 bits, odd, SBI, 16 characters?"


class SartoriusDevice(Linked[Weight], Sensor):
    """One scale."""

    def __init__(self, config: SartoriusConfig) -> None:
        self._config = config
        line = SerialPort(config.port, 9600, parity="odd", data_bits=7)
        self._link = MessageLink(line, decoder, REMEDY)
        self._newest = Weight(0.0, "")
        self._came = 0
        self._force = 0.0
        self._frame, stop = config.frame_id, StopPolicy(0.0, "has nothing that moves")
        self._capabilities = Capabilities(
            measured=("measured_cf",), rate=config.rate, tool_frame=self._frame, stop=stop
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
    def services(self) -> Mapping[str, Service]:
        return {"tare": Service("make the present weight zero", self._tare)}

    @property
    @override
    def readings(self) -> Mapping[str, Reading]:
        at_rest = Reading("whether it is", Payload.FLAG, lambda: Flag(bool(self._newest.unit)))
        return {"at_rest": at_rest}

    @override
    def open(self, deadline: float) -> None:
        self._link.open(deadline)
        self._newest = self._link.await_message(deadline, ask=ASK)

    @override
    def close(self) -> None:
        self._link.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        self._came += len(self._link.came())  # late answers, to older questions
        self._link.write(ASK)
        weights = self._link.read(deadline)
        if not weights:
            return None
        self._newest, unit, stamp = weights[-1], self._config.unit, Stamp.now()
        self._came += len(weights)
        if self._newest.unit not in ("", unit):
            text = f"it weighs in {self._newest.unit}, not in {unit}"
            raise ProtocolError(text, where=self._link.where, remedy="Set the one or the other.")
        if self._newest.value is None:
            stamp = Stamp(0, stamp.monotonic)  # the last force, which is told as not valid
        else:
            self._force = -GRAVITY * KG[unit] * self._newest.value
        force = Wrench(vector([0.0, 0.0, self._force]), vector([0.0] * 3), self._frame)
        return Sample(stamp, {"measured_cf": force})

    def _tare(self) -> Answer:
        zero, before = Weight(0.0, self._config.unit), self._came
        self._link.write(TARE)
        # The first weight that comes may be the answer to what was asked before.
        if not (yield from until(lambda: self._came > before + 1 and self._newest == zero, 5.0)):
            raise TransitionFailed("it does not tare", where=self._link.where, remedy=REMEDY)
        return "the present weight is zero"
