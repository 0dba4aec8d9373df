"""The serial line of a sensor that may stream: it then answers nothing, until it is told to listen again."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.kit.modbus_line import Distortion, RtuLine
from crtk_sim_backends.robotiq.ft300.sensor import Sensor

END: Final = 50
"""Bytes FF that end the stream."""


class StreamLine(RtuLine):
    """A line with one sensor; see `RtuLine`."""

    def __init__(self, device: Sensor, distortion: Distortion, *others: Any, **named: Any) -> None:
        super().__init__(device, distortion, *others, **named)
        self._sensor = device
        self._ones = 0
        device.listeners.append(self._stream)

    @override
    def take(self, data: bytes) -> None:
        """Take bytes from any of the programs."""
        if not self._sensor.streams:
            super().take(data)
            return
        for byte in data:
            self._ones = self._ones + 1 if byte == 0xFF else 0
            if self._ones == END:
                self._ones = 0
                self._sensor.end_stream()
                return

    def _stream(self, frame: bytes) -> None:
        sent = self._distortion.on_the_line(frame)
        self._after(len(sent) * self._byte_time, partial(self.deal, sent))
