"""The TCP channel of a box (port 49151): 20-byte requests, each with an answer. Bytes in, bytes out.

(ATI 9620-05-NET FT, chapter on the TCP interface.)
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from crtk_sim_backends.netft import units
from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.settings import CONDITIONS

_SIZE: Final = 20
_HEADER: Final = 0x1234
_BIAS, _CLEAR_LATCH = 1, 2
_OK, _REFUSED = 0, 1


class TcpSession:
    """One connection.

    Args:
        box: that is asked.
        sender: of the client, for the trace.
        clock: monotonic seconds.
    """

    ended = False

    def __init__(self, box: Box, sender: str, clock: Callable[[], float]) -> None:
        self._box = box
        self._sender = sender
        self._clock = clock
        self._received = bytearray()
        self._commands: dict[int, Callable[[bytes], bytes]] = {
            0: self._read,
            1: self._read_calibration,
            2: self._write_transform,
            3: self._write_condition,
        }

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers to the requests that they complete."""
        self._received += data
        answers = b""
        while len(self._received) >= _SIZE:
            request = bytes(self._received[:_SIZE])
            del self._received[:_SIZE]
            answers += self._answer(request)
        return answers

    def more(self, now: float) -> bytes:
        """Nothing comes by itself."""
        return b""

    def close(self) -> None:
        """Do nothing."""

    def _answer(self, request: bytes) -> bytes:
        box = self._box
        box.counters.tcp_requests += 1
        command = self._commands.get(request[0])
        if request[0] != 0 or any(request[16:]):
            box.note("tcp", self._sender, self._clock(), {"request": request.hex()})
        if command is None:
            return struct.pack(">HBB", _HEADER, request[0], _REFUSED)
        return command(request)

    def _read(self, request: bytes) -> bytes:
        box, now = self._box, self._clock()
        enabled, commands = struct.unpack_from(">HH", request, 16)
        if enabled:
            box.enable_conditions(enabled)
        if commands & _BIAS:
            box.set_bias(now)
        if commands & _CLEAR_LATCH:
            box.sensor.clear_latch(now)
        box.settle(now)
        newest = box.sensor.measurement(now)
        steps = box.settings.steps
        values = [
            max(-32768, min(32767, round(count / step)))
            for count, step in zip(newest.counts, steps, strict=True)
        ]
        return struct.pack(">HH6h", _HEADER, newest.status >> 16, *values)

    def _read_calibration(self, request: bytes) -> bytes:
        settings = self._box.settings
        active = settings.configuration
        return struct.pack(
            ">HBBII6H",
            _HEADER,
            active.force_unit,
            active.torque_unit,
            *settings.counts_per_unit(active),
            *settings.steps,
        )

    def _write_transform(self, request: bytes) -> bytes:
        distance, angle, *values = struct.unpack_from(">BB6h", request, 1)
        known = distance in units.DISTANCE and angle in units.ANGLE
        if known:
            active = self._box.settings.configuration
            active.distance_unit, active.angle_unit = distance, angle
            active.transform = [value / 100.0 for value in values]
            self._box.changed()
        return struct.pack(">HBB", _HEADER, request[0], _OK if known else _REFUSED)

    def _write_condition(self, request: bytes) -> bytes:
        index, axis, output, compare, value = struct.unpack_from(">BBBbh", request, 1)
        known = index < CONDITIONS and axis <= 5 and compare in (-1, 1)
        if known:
            settings = self._box.settings
            condition = settings.conditions[index]
            condition.axis, condition.output, condition.compare = axis, output, compare
            condition.value = value * settings.steps[axis]
            condition.enabled = 1
            self._box.changed()
        return struct.pack(">HBB", _HEADER, request[0], _OK if known else _REFUSED)
