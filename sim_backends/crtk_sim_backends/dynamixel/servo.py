"""One servo: its memory with the rules of access, and what every servo does with instructions.

What registers mean is the matter of the subclasses: `crtk_sim_backends.dynamixel.modern` (X, MX(2.0) and
P series) and `crtk_sim_backends.dynamixel.legacy` (AX and MX of protocol 1.0). Times are those of the
plant, in s.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar, Final

from crtk_sim_backends.defects import Sense
from crtk_sim_backends.dynamixel.defects import ServoDefects
from crtk_sim_backends.dynamixel.drive import Drive
from crtk_sim_backends.dynamixel.models import Model
from crtk_sim_backends.dynamixel.packets import Code, Error
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.registers import Access, Register

BOOT: Final = 0.25  # s for which a servo is silent after a reboot
AMBIENT: Final = 28.0  # °C

_SOON: Final = 0.0005  # s for which goals need not wait for the mechanics
_LOOKS: Final = 0.01  # s between looks at voltage and temperature
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
        self.claims: dict[int, int] = {}  # bytes that read otherwise than they are, by address
        self.defects: ServoDefects | None = None
        self._sense: Sense | None = None
        self.stuffing: Iterator[tuple[int, int, int]] | None = None  # what it claims to measure
        self.silent_until = -math.inf
        self.reboots = 0
        self._registered: Run | None = None
        self._backup: bytes | None = None
        self._heated_at = joint.time
        self._turns = 0  # counts that full turns add to the position
        self._values: dict[str, int] = {}
        self._looked_at = -math.inf
        for register in self.table:
            self._put(register, register.default)
        self.derive()

    def have(self, defects: ServoDefects | None) -> None:
        """Have defects, or none."""
        self.defects = defects
        self._sense = None if defects is None else Sense(defects, self.number)

    def sensed(self, time: float) -> tuple[float, float, float]:
        """Angle (rad) and velocity (rad/s) of the horn, and torque (N·m), as the servo measures them."""
        drive = self.drive
        if self._sense is None:
            return drive.angle, drive.velocity, drive.applied
        return self._sense.tell(drive.angle, drive.velocity, drive.applied, time)

    # Memory

    def __getitem__(self, name: str) -> int:
        value = self._values.get(name)
        if value is not None:
            return value
        register = self.table.by_name[name]
        return register.decode(self.memory[register.address : register.end])

    def __setitem__(self, name: str, value: int) -> None:
        register = self.table.by_name[name]
        self._put(register, value)
        if register.shapes:
            self.derive()

    def _put(self, register: Register, value: int) -> None:
        self.memory[register.address : register.end] = register.encode(value)
        if register.name not in self.measured:
            self._values[register.name] = value

    def get(self, name: str, default: int = 0) -> int:
        """Value of a register, `default` if this model has none of that name."""
        return self[name] if name in self.table else default

    def read(self, address: int, length: int, time: float) -> Answer:
        """Read memory: error and data."""
        if length == 0:
            return Error.LENGTH, b""
        if address + length > self.table.size:
            return Error.ACCESS, b""
        end = address + length
        self.refresh(time, address, end)
        data = self.memory[address:end]
        if self.claims:
            for n in range(length):
                data[n] = self._told(self._resolve(address + n))
            return Error.NONE, bytes(data)
        if not self._reaches_indirect(address, end):
            return Error.NONE, bytes(data)
        for block in self.table.blocks:
            if address < block.data + block.count and address + length > block.data:
                for n in range(
                    max(address, block.data), min(address + length, block.data + block.count)
                ):
                    data[n - address] = self.memory[self._resolve(n)]
        return Error.NONE, bytes(data)

    def _told(self, address: int) -> int:
        return self.claims.get(address, self.memory[address])

    def _reaches_indirect(self, start: int, end: int) -> bool:
        return end > self.table.indirect_from and any(
            start < block.data + block.count and end > block.data for block in self.table.blocks
        )

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
        if not self._reaches_indirect(address, address + len(data)):
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
        if time > self.joint.time + _SOON:
            self.advance(time)
        runs = self._runs(address, data)
        error, registers = self._check(runs)
        if error:
            return error
        self._store(runs, registers, time)
        return Error.NONE

    def poke(self, address: int, data: bytes) -> None:
        """Put whole registers into memory, whatever its rules say.

        Raises:
            ValueError: they are not whole ones, or not within their bounds.
        """
        at, found = address, []
        while at < address + len(data):
            register = self.table.at[at] if 0 <= at < self.table.size else None
            if register is None or register.address != at or register.end > address + len(data):
                raise ValueError(f"no register is from {at} on within these {len(data)} bytes")
            value = register.decode(data[at - address : register.end - address])
            if not register.low <= value <= register.high:
                raise ValueError(f"{register.name} takes {register.low} to {register.high}")
            found.append(register)
            at = register.end
        self._store([(address, data)], found, self.joint.time)

    def _store(self, runs: Run, registers: list[Register], time: float) -> None:
        for at, piece in runs:
            self.memory[at : at + len(piece)] = piece
        shapes = False
        for register in registers:
            data = self.memory[register.address : register.end]
            self._values[register.name] = register.decode(data)
            shapes |= register.shapes
        if shapes:
            self.derive()
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
                if register is None or register.fixed:
                    return Error.ACCESS, []
                if register.address != at or register.end > end:
                    return Error.LENGTH, []
                if register.locked and self.torque_enabled:
                    return Error.ACCESS, []
                value = register.decode(data[at - address : register.end - address])
                if not register.low <= value <= register.high:
                    return Error.RANGE, []
                error = self.refused(register.name, value)
                if error:
                    return error, []
                registers.append(register)
                at = register.end
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
        self.advance(time)
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
        self.advance(time)
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
            self._put(register, values.get(register.name, register.default))
        self._backup = None
        self.reboot(time)
        return Error.NONE

    def reboot(self, time: float) -> None:
        """Begin anew: torque off, RAM as after power-on, full turns forgotten; silent for a while."""
        self.joint.advance(time)
        self.reboots += 1
        self.silent_until = time + BOOT
        self._registered = None
        self.drive.set_alarm(math.inf)
        self.drive.alarms = self.drive.overloads = 0
        self.drive.switch(None, time)
        for register in self.table:
            if register.access in (Access.RAM, Access.LOCKED):
                self._put(register, register.default)
        self.derive()
        self._looked_at = -math.inf
        self.started(time)

    measured: ClassVar[frozenset[str]] = frozenset()
    """Registers that `refresh` packs into memory."""

    # What a servo is at present

    number: int
    protocol: int  # 1 or 2; 0: it speaks something else
    baud: int  # bits a second
    return_delay: float  # s from the end of an instruction to the beginning of the status
    status_level: int  # 0: answers pings, 1: reads too, 2: everything
    secondary: int | None = None  # another id, whose instructions it obeys without an answer

    def derive(self) -> None:
        """Take over what registers that `Register.shapes` say."""
        self.number = self["id"]
        self.return_delay = 2e-6 * self["return_delay_time"]
        self.status_level = self["status_return_level"]

    @property
    @abstractmethod
    def error_bits(self) -> int:
        """What every status reports besides the outcome: ALERT (2.0), or bits of present errors (1.0)."""

    @property
    def legacy_bits(self) -> int:
        """Bits of present errors in a status of protocol 1.0."""
        return self.error_bits

    @property
    @abstractmethod
    def limits(self) -> tuple[float, float] | None:
        """Angles of the horn between which goals lie, rad; None in a mode without."""

    @property
    def torque_enabled(self) -> bool:
        """Whether its motor is on."""
        return bool(self["torque_enable"])

    def listens(self, time: float) -> bool:
        """Whether it has power and is not starting."""
        return self.powered and time >= self.silent_until

    # What registers mean

    @abstractmethod
    def refresh(self, time: float, start: int = 0, end: int = 65536) -> None:
        """Advance to `time` and put what is measured into memory, at least from `start` to `end`."""

    def advance(self, time: float) -> None:
        """Let the mechanics go on to `time`, and errors happen."""
        self.joint.advance(time)
        drive = self.drive
        if drive.alarms or drive.overloads:
            self.acted(drive.alarms > 0, drive.overloads > 0)
            drive.alarms = drive.overloads = 0
        if time > self._looked_at + _LOOKS or time < self._looked_at:
            self._looked_at = time
            self.warm(time)
            self.watch_limits()

    @abstractmethod
    def acted(self, watchdog: bool, overload: bool) -> None:
        """The drive has stopped for want of instructions, or strained itself for too long."""

    @abstractmethod
    def watch_limits(self) -> None:
        """Look at voltage and temperature."""

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
            "bus_watchdog": self.get("bus_watchdog"),
            "temperature": self.temperature,
            "voltage": self.volts,
            "reboots": self.reboots,
        }
