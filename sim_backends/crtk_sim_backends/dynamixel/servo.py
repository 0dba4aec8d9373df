"""One servo: its memory with the rules of access, and what every servo does with instructions.

What registers mean is the matter of the subclasses: `crtk_sim_backends.dynamixel.modern` (X, MX(2.0) and
P series) and `crtk_sim_backends.dynamixel.legacy` (AX and MX of protocol 1.0). Times are those of the
plant, in s.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Final

from crtk_sim_backends.dynamixel.drive import Drive
from crtk_sim_backends.dynamixel.models import Model
from crtk_sim_backends.dynamixel.packets import Code, Error
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.registers import Access, Register

BOOT: Final = 0.25  # s for which a servo is silent after a reboot
AMBIENT: Final = 28.0  # °C

_HEATING: Final = 120.0  # K at stall current, in the end
_HEAT_TIME: Final = 150.0  # s, time constant

Answer = tuple[Error, bytes]
Run = list[tuple[int, bytes]]


class Servo(ABC):
    """A servo at a joint.

    Args:
        model: what it is.
        firmware: version.
        joint: what it turns; several servos may share one.
        mount: -1 if it looks at the joint from the other side.
    """

    def __init__(self, model: Model, firmware: int, joint: Joint, mount: int = 1) -> None:
        self.model = model
        self.firmware = firmware
        self.joint = joint
        self.drive = Drive(model, joint, mount)
        self.table = model.table(firmware)
        self.memory = bytearray(self.table.size)
        self.powered = True
        self.supply = model.supply
        self.temperature = AMBIENT
        self.heat_source: float | None = None  # °C that something outside forces on it
        self.stuffing: Iterator[tuple[int, int, int]] | None = None  # what it claims to measure
        self.silent_until = -math.inf
        self.reboots = 0
        self._registered: Run | None = None
        self._backup: bytes | None = None
        self._heated_at = joint.time
        self._turns = 0  # counts that full turns add to the position
        for register in self.table:
            self[register.name] = register.default

    # Memory

    def __getitem__(self, name: str) -> int:
        register = self.table.by_name[name]
        address = register.address
        return register.decode(self.memory[address : address + register.size])

    def __setitem__(self, name: str, value: int) -> None:
        register = self.table.by_name[name]
        self.memory[register.address : register.address + register.size] = register.encode(value)

    def get(self, name: str, default: int = 0) -> int:
        """Value of a register, `default` if this model has none of that name."""
        return self[name] if name in self.table else default

    def read(self, address: int, length: int, time: float) -> Answer:
        """Read memory: error and data."""
        if length == 0:
            return Error.LENGTH, b""
        if address + length > self.table.size:
            return Error.ACCESS, b""
        self.refresh(time)
        data = self.memory[address : address + length]
        for block in self.table.blocks:
            if address < block.data + block.count and address + length > block.data:
                for n in range(
                    max(address, block.data), min(address + length, block.data + block.count)
                ):
                    data[n - address] = self.memory[self._resolve(n)]
        return Error.NONE, bytes(data)

    def _resolve(self, address: int) -> int:
        """Where a byte really lies: indirect data is somewhere else."""
        for block in self.table.blocks:
            n = address - block.data
            if 0 <= n < block.count:
                at = block.address + 2 * n
                return int.from_bytes(self.memory[at : at + 2], "little")
        return address

    def _runs(self, address: int, data: bytes) -> Run:
        """Cut data for an address into runs for consecutive addresses, after indirection."""
        blocks = self.table.blocks
        if not any(address < b.data + b.count and address + len(data) > b.data for b in blocks):
            return [(address, data)]
        runs: list[tuple[int, bytearray]] = []
        for n, byte in enumerate(data):
            at = self._resolve(address + n)
            if runs and runs[-1][0] + len(runs[-1][1]) == at:
                runs[-1][1].append(byte)
            else:
                runs.append((at, bytearray((byte,))))
        return [(at, bytes(piece)) for at, piece in runs]

    def write(self, address: int, data: bytes, time: float) -> Error:
        """Write memory: everything or, with an error, nothing."""
        self.refresh(time)
        runs = self._runs(address, data)
        error, registers = self._check(runs)
        if error:
            return error
        self._store(runs, registers, time)
        return Error.NONE

    def _store(self, runs: Run, registers: list[Register], time: float) -> None:
        for at, piece in runs:
            self.memory[at : at + len(piece)] = piece
        for register in registers:
            self.written(register.name, time)
        self.joint.wake()

    def _check(self, runs: Run) -> tuple[Error, list[Register]]:
        """Whether runs of data may be written, and which registers they are."""
        registers: list[Register] = []
        for address, data in runs:
            end = address + len(data)
            if not data:
                return Error.LENGTH, []
            if end > self.table.size:
                return Error.ACCESS, []
            at = address
            while at < end:
                register = self.table.at[at]
                if register is None or register.access is Access.READ:
                    return Error.ACCESS, []
                if register.address != at or at + register.size > end:
                    return Error.LENGTH, []
                if register.access is not Access.RAM and self.torque_enabled:
                    return Error.ACCESS, []
                value = register.decode(data[at - address : at - address + register.size])
                if not register.low <= value <= register.high:
                    return Error.RANGE, []
                error = self.refused(register.name, value)
                if error:
                    return error, []
                registers.append(register)
                at += register.size
        return Error.NONE, registers

    # Instructions

    def execute(self, code: int, parameters: bytes, time: float, *, broadcast: bool) -> Answer:
        """Carry out an instruction to this servo alone, or to all: error and data of the answer."""
        legacy = self.protocol == 1
        wide = 1 if legacy else 2
        if code == Code.PING:
            return Error.NONE, b"" if legacy else self.identity
        if code in (Code.READ, Code.WRITE, Code.REG_WRITE) and len(parameters) < wide + 1:
            return Error.LENGTH, b""
        address, rest = int.from_bytes(parameters[:wide], "little"), parameters[wide:]
        if code == Code.READ:
            return self.read(address, int.from_bytes(rest[:wide], "little"), time)
        if code == Code.WRITE:
            return self.write(address, rest, time), b""
        if code == Code.REG_WRITE:
            return self._register(address, rest, time), b""
        if code == Code.ACTION:
            return self._act(time), b""
        if code == Code.FACTORY_RESET:
            return self._factory_reset(parameters, time, broadcast), b""
        if code == Code.REBOOT:
            self.reboot(time)
            return Error.NONE, b""
        if code == Code.CLEAR:
            return self.clear(parameters, time), b""
        if code == Code.BACKUP:
            return self.back_up(parameters, time), b""
        return Error.INSTRUCTION, b""

    @property
    def identity(self) -> bytes:
        """What the status of a ping holds (2.0): model number and firmware."""
        return bytes((*self.memory[0:2], self.firmware))

    def _register(self, address: int, data: bytes, time: float) -> Error:
        self.refresh(time)
        runs = self._runs(address, data)
        error, _ = self._check(runs)
        if not error:
            self._registered = runs
            self._set_registered(True)
        return error

    def _act(self, time: float) -> Error:
        if self._registered is None:
            return Error.INSTRUCTION
        runs, self._registered = self._registered, None
        self._set_registered(False)
        self.refresh(time)
        error, registers = self._check(runs)
        if not error:
            self._store(runs, registers, time)
        return error

    def _set_registered(self, waits: bool) -> None:
        name = "registered" if "registered" in self.table else "registered_instruction"
        self[name] = waits

    def _factory_reset(self, parameters: bytes, time: float, broadcast: bool) -> Error:
        kept = {b"\xff": (), b"\x01": ("id",), b"\x02": ("id", "baud_rate")}
        key = parameters if self.protocol == 2 else b"\xff"
        if key not in kept or (broadcast and key == b"\xff"):
            return Error.RANGE
        values = {name: self[name] for name in kept[key]}
        for register in self.table:
            self[register.name] = values.get(register.name, register.default)
        self._backup = None
        self.reboot(time)
        return Error.NONE

    def reboot(self, time: float) -> None:
        """Begin anew: torque off, RAM as after power-on, full turns forgotten; silent for a while."""
        self.joint.advance(time)
        self.reboots += 1
        self.silent_until = time + BOOT
        self._registered = None
        self.drive.alarm = math.inf
        self.drive.alarms = self.drive.overloads = 0
        self.drive.switch(None, time)
        for register in self.table:
            if register.access in (Access.RAM, Access.LOCKED) or register.name in self._volatile:
                self[register.name] = register.default
        self.started(time)

    _volatile: frozenset[str] = frozenset()

    # What a servo is at present

    @property
    @abstractmethod
    def protocol(self) -> int:
        """That it speaks now."""

    @property
    @abstractmethod
    def baud(self) -> int:
        """Bits a second."""

    @property
    @abstractmethod
    def error_bits(self) -> int:
        """What every status reports besides the outcome: ALERT (2.0), or the bits of present errors (1.0)."""

    @property
    def legacy_bits(self) -> int:
        """Bits of present errors in a status of protocol 1.0."""
        return self.error_bits

    @property
    def number(self) -> int:
        """Its id."""
        return self["id"]

    @property
    def secondary(self) -> int | None:
        """Another id to whose instructions it obeys without an answer; None if it has none."""
        return None

    @property
    def return_delay(self) -> float:
        """From the end of an instruction to the beginning of the status, s."""
        return 2e-6 * self["return_delay_time"]

    @property
    def status_level(self) -> int:
        """0: answers pings, 1: reads too, 2: everything."""
        return self["status_return_level"]

    @property
    def torque_enabled(self) -> bool:
        """Whether its motor is on."""
        return bool(self["torque_enable"])

    def listens(self, time: float) -> bool:
        """Whether it has power and is not starting."""
        return self.powered and time >= self.silent_until

    # What registers mean

    @abstractmethod
    def refresh(self, time: float) -> None:
        """Advance to `time` and put what is measured into memory."""

    @abstractmethod
    def refused(self, name: str, value: int) -> Error:
        """Why a value that lies within the bounds of its register is refused all the same."""

    @abstractmethod
    def written(self, name: str, time: float) -> None:
        """Let a register that has been written take effect."""

    @abstractmethod
    def started(self, time: float) -> None:
        """After power-on and reboot: registers whose values depend on others."""

    @abstractmethod
    def heard(self, time: float) -> None:
        """An instruction packet has been on the bus."""

    def clear(self, parameters: bytes, time: float) -> Error:
        """Carry out the instruction Clear."""
        return Error.INSTRUCTION

    def back_up(self, parameters: bytes, time: float) -> Error:
        """Carry out the instruction Control Table Backup."""
        return Error.INSTRUCTION

    @abstractmethod
    def force_error(self, bit: int) -> None:
        """A hardware error happens; the bits are those of Hardware Error Status (70)."""

    def warm(self, time: float) -> None:
        """Let the motor heat up or cool down until `time`."""
        share = self.drive.applied / self.model.torque
        target = (
            AMBIENT + _HEATING * share * share if self.heat_source is None else self.heat_source
        )
        passed = time - self._heated_at
        self._heated_at = time
        if self.heat_source is not None:
            self.temperature = target
        else:
            self.temperature += (target - self.temperature) * -math.expm1(-passed / _HEAT_TIME)

    @property
    def volts(self) -> float:
        """At its terminals, V: a little less under load."""
        return self.supply - 0.3 * min(1.0, abs(self.drive.applied) / self.model.torque)

    def describe(self) -> dict[str, object]:
        """What a person wants to know, ready for JSON."""
        return {
            "model": self.model.name,
            "firmware": self.firmware,
            "protocol": self.protocol,
            "id": self.number,
            "baud": self.baud,
            "powered": self.powered,
            "torque": self.torque_enabled,
            "angle": self.drive.angle,
            "velocity": self.drive.velocity,
            "torque_applied": self.drive.applied,
            "temperature": self.temperature,
            "voltage": self.volts,
            "reboots": self.reboots,
        }
