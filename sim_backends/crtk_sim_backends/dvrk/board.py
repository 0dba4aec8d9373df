"""One board: registers, watchdog, power, four motors. No sockets, no clock.

Source: BoardRegs.v, BoardRegs-QLA.v and MotorChannelQLA.v of mechatronics-firmware.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

from crtk_sim_backends.dvrk.axis import CLOCK, MIDDLE, NO_CURRENT, WEIGHTLESS, Axis, Load
from crtk_sim_backends.dvrk.prom import COMMAND, DATA, QLA_COMMAND, QLA_RESULT, RESULT, Prom

AXES: Final = 4

STATUS, PHY, WATCHDOG, HARDWARE, TEMPERATURE, OUTPUTS, FIRMWARE = 0, 1, 3, 4, 5, 6, 7
INPUTS, IP_ADDRESS, ETHERNET = 10, 11, 12
"""Registers of a board, beside those of its memory."""

CONVERTER, DAC, PRELOAD, POSITION, PERIOD = 0, 1, 4, 5, 6
"""Those of an axis."""

_CHANNELS: Final = 0x100
"""First address that is no register of a board or an axis."""

_READY: Final = 0.04
"""Seconds after the motor voltage until amplifiers are let on."""
_RELAY: Final = 0.01
"""Seconds that a relay takes."""
_EVENTS: Final = 64
_WATCHDOG_STEP: Final = 256.0 / CLOCK


class Board:
    """One board.

    Args:
        number: its rotary switch.
        hardware, firmware, fpga: what it tells of itself.
        now: monotonic s.
        load: what motors move.
        power_delay: s from power to the voltage of motors.
        patience: by how much longer than it was told the watchdog waits.
    """

    def __init__(
        self,
        number: int,
        hardware: str,
        firmware: int,
        fpga: int,
        now: float,
        *,
        load: Load = WEIGHTLESS,
        power_delay: float = 0.0,
        patience: float = 1.0,
    ) -> None:
        self.number = number
        self.hardware = int.from_bytes(hardware.encode())
        self.firmware = firmware
        self.ethernet = 1 << 31 if fpga == 2 else 1 << 30
        self.axes = [Axis(load) for _ in range(AXES)]
        self.supply = True  # there is voltage for motors
        self.supply_fault = self.encoder_supply_fault = self.relay_sticks = False
        self.power_sticks = False
        self.celsius = 31.0
        self.inputs = 0
        self.written: dict[str, int] = {}  # register, and the last value
        self.events: deque[str] = deque(maxlen=_EVENTS)  # what was switched, in order
        self._power_delay = power_delay
        self._patience = patience
        self._prom = Prom(number)
        self._now = self._read_at = now
        self.restart()

    def restart(self) -> None:
        """Be as after power on; motors stay where they are."""
        self.power = self.relay = self.timed_out = False
        self._powered_since = self._good_since = self._relay_since = math.inf
        self._watchdog = 0
        self._fed = self._now
        self._outputs = 0
        for axis in self.axes:
            axis.asked = axis.tripped = False
            axis.command = NO_CURRENT
            axis.set_encoder(MIDDLE)

    # Time

    def advance(self, now: float) -> None:
        """Let time pass until `now`."""
        seconds, self._now = now - self._now, now
        limit = self._watchdog * _WATCHDOG_STEP * self._patience
        if limit and now - self._fed > limit and not self.timed_out:
            self.expire()
        self._good_since = min(self._good_since, now) if self.voltage_good else math.inf
        powered = now - self._good_since >= _READY
        for axis in self.axes:
            if not self.power or self.timed_out or axis.tripped:
                axis.asked = False
            axis.advance(now, seconds, powered=powered)

    def expire(self) -> None:
        """Let the watchdog expire."""
        self.timed_out = True
        self.events.append("watchdog expired")

    @property
    def voltage_good(self) -> bool:
        """Whether motors have their voltage."""
        return self.power and self.supply and self._now - self._powered_since >= self._power_delay

    @property
    def relay_closed(self) -> bool:
        """Whether the safety relay is closed."""
        return self.relay and not self.relay_sticks and self._now - self._relay_since >= _RELAY

    # Registers

    def read(self, address: int) -> int:
        """Return a register."""
        if address >= _CHANNELS:
            return self._prom.qla_result if address == QLA_RESULT else 0
        channel, register = address >> 4, address & 0x0F
        if channel:
            return self._axis(channel, register)
        told = {
            STATUS: self._status,
            WATCHDOG: self._watchdog,
            HARDWARE: self.hardware,
            TEMPERATURE: self._temperature,
            OUTPUTS: self._outputs,
            FIRMWARE: self.firmware,
            RESULT: self._prom.result,
            INPUTS: self._digital,
            IP_ADDRESS: self.written.get(str(IP_ADDRESS), 0),
            ETHERNET: self.ethernet,
        }
        return told.get(register, 0)

    def write(self, address: int, value: int) -> None:
        """Write a register; each write feeds the watchdog."""
        self._fed = self._now
        self.written[str(address)] = value
        if address >= _CHANNELS:
            if address == QLA_COMMAND:
                self._prom.obey_qla(value)
            return
        channel, register = address >> 4, address & 0x0F
        if 0 < channel <= AXES:
            axis = self.axes[channel - 1]
            if register == DAC:
                self._drive(axis, value)
            elif register == PRELOAD:
                axis.set_encoder(value)
        elif register == STATUS:
            self._control(value)
            for at, axis in enumerate(self.axes):
                if value >> (8 + at) & 1:
                    self._enable(axis, on=bool(value >> at & 1))
        elif register == WATCHDOG:
            self._watchdog = value & 0xFFFF
            self.events.append(f"watchdog {self._watchdog}")
        elif register == OUTPUTS:
            mask = value >> 8 & 0x0F
            self._outputs = self._outputs & ~mask | value & mask
        elif register == COMMAND:
            self._prom.obey(value)

    def read_block(self, address: int, size: int) -> list[int]:
        """Return quadlets: the state, which begins to count the time anew, or what was read of the memory."""
        found = self.block() if address == 0 else []
        if address == DATA:
            found = self._prom.page
        return (found + [0] * size)[:size]

    def block(self) -> list[int]:
        """Return the state, and begin to count the time anew."""
        ticks = max(0, round((self._now - self._read_at) * CLOCK) - 1)
        self._read_at = self._now
        return [
            ticks & 0xFFFFFFFF,
            self._status,
            self._digital,
            self._temperature,
            *(axis.analog for axis in self.axes),
            *(axis.encoder for axis in self.axes),
            *(axis.period for axis in self.axes),
            *([0] * 3 * AXES),  # quarters of a cycle, and the time since the last edge
            *(axis.status for axis in self.axes),
        ]

    def write_block(self, quadlets: Sequence[int]) -> None:
        """Take commands: header, four motors, control."""
        if len(quadlets) != AXES + 2 or quadlets[0] != (self.number << 8 | AXES + 2):
            return
        self._fed = self._now
        for axis, value in zip(self.axes, quadlets[1:], strict=False):
            self._drive(axis, value)
        self._control(quadlets[-1])

    def _control(self, value: int) -> None:
        if value & 0x00080000:
            power = bool(value & 0x00040000) or self.power_sticks
            self._note("power", before=self.power, after=power)
            self.power = power
            self._powered_since = min(self._powered_since, self._now) if power else math.inf
        if value & 0x00020000:
            relay = bool(value & 0x00010000)
            self._note("relay", before=self.relay, after=relay)
            self.relay = relay
            self._relay_since = min(self._relay_since, self._now) if relay else math.inf
        if value & 0x000C0000 == 0x000C0000:
            self.timed_out = False
            for axis in self.axes:
                axis.tripped = False

    def _note(self, what: str, *, before: bool, after: bool) -> None:
        if before != after:
            self.events.append(f"{what} {'on' if after else 'off'}")

    def _drive(self, axis: Axis, value: int) -> None:
        if value & 0x80000000:
            axis.command = value & 0xFFFF
        if value & 0x20000000:
            self._enable(axis, on=bool(value & 0x10000000))

    def _enable(self, axis: Axis, *, on: bool) -> None:
        if on:
            axis.tripped = False
        asked = (on and self.power and not self.timed_out) or axis.sticks
        self._note(f"amplifier {self.axes.index(axis)}", before=axis.asked, after=asked)
        axis.asked = asked

    def _axis(self, channel: int, register: int) -> int:
        if channel > AXES:
            return 0
        axis = self.axes[channel - 1]
        told = {
            CONVERTER: axis.analog,
            DAC: axis.command,
            PRELOAD: axis.preload,
            POSITION: axis.encoder,
            PERIOD: axis.period,
        }
        return told.get(register, 0)

    @property
    def _status(self) -> int:
        flags = (
            (23, self.timed_out),
            (19, self.voltage_good),
            (18, self.power),
            (17, self.relay_closed),
            (16, self.relay),
            (15, self.supply_fault),
        )
        found = AXES << 28 | self.number << 24 | sum(1 << bit for bit, is_so in flags if is_so)
        for at, axis in enumerate(self.axes):
            found |= axis.is_on << (8 + at) | axis.tripped << (4 + at) | axis.asked << at
        return found

    @property
    def _digital(self) -> int:
        outputs = (self._outputs & 0x0F) << 12
        return self.encoder_supply_fault << 31 | self.power << 28 | outputs | (self.inputs & 0xFFF)

    @property
    def _temperature(self) -> int:
        return min(round(2.0 * self.celsius), 0xFF) << 8 | 2 * 33

    def describe(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        return {
            "board": self.number,
            "position": [axis.position for axis in self.axes],
            "velocity": [axis.velocity for axis in self.axes],
            "command": [axis.command for axis in self.axes],
            "on": [axis.is_on for axis in self.axes],
            "power": self.power,
            "relay": self.relay,
            "timed_out": self.timed_out,
            "watchdog": self._watchdog,
            "written": dict(self.written),
            "events": list(self.events),
        }
