"""The instructions on a bus and the answers of its servos, without any clock or wire of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Final, NamedTuple

from crtk_sim_backends.defects import defects_of
from crtk_sim_backends.dynamixel.config import ServoSpec
from crtk_sim_backends.dynamixel.defects import ServoDefects
from crtk_sim_backends.dynamixel.legacy import LegacyServo
from crtk_sim_backends.dynamixel.modern import REVERSE, ModernServo
from crtk_sim_backends.dynamixel.packets import (
    BROADCAST,
    LEGACY_ERROR,
    Code,
    Error,
    Instruction,
    fast_status,
    legacy_status,
    status,
)
from crtk_sim_backends.dynamixel.plant import Joint
from crtk_sim_backends.dynamixel.registers import OLDER
from crtk_sim_backends.dynamixel.servo import Servo

_READS: Final = frozenset({Code.PING, Code.READ})
_RATE_TOLERANCE: Final = 0.03  # by which baud rates may differ


class Reply(NamedTuple):
    """The status packet of one servo, and when it begins.

    Attributes:
        number: id in the packet.
        delay: s after the end of the instruction or of the reply before.
        packet: its bytes; None for one that misses, whose turn passes without a byte.
    """

    number: int
    delay: float
    packet: bytes | None


Item = tuple[int, int, int]
"""Id, address and length that a group read asks for."""


def make_servos(
    specs: Sequence[ServoSpec],
    baud: int,
    return_delay: int,
    defects: Sequence[ServoDefects] = (),
) -> list[Servo]:
    """Build the servos of one bus, set to a baud rate and Return Delay Time, with their defects."""
    servos: dict[int, Servo] = {}
    for spec in specs:
        make = LegacyServo if spec.model.series in OLDER else ModernServo
        if spec.partner is None:
            joint, mount = Joint(spec.model.torque, spec.gravity), 1
        else:
            partner = servos[spec.partner]
            joint, mount = partner.joint, -partner.drive.mount
            joint.add_motor(spec.model.torque)
        servo = make(spec.model, spec.firmware, joint, mount)
        servo["id"] = spec.number
        servo.have(defects_of(defects, spec.number))
        servo["return_delay_time"] = return_delay
        set_baud(servo, baud)
        if spec.partner is not None:
            servo["secondary_id"] = spec.partner
            servo["drive_mode"] ^= REVERSE
            servo.started(0.0)
        servos[spec.number] = servo
    return list(servos.values())


def set_baud(servo: Servo, baud: int) -> None:
    """Set the baud rate register to the value that comes nearest."""
    register = servo.table["baud_rate"]

    def error(value: int) -> float:
        servo["baud_rate"] = value
        return abs(servo.baud - baud)

    servo["baud_rate"] = min(range(register.low, register.high + 1), key=error)


class Bus:
    """The servos of one bus.

    Args:
        servos: all of them.

    Attributes:
        deaf: ids of servos that a fault has taken off the bus.
    """

    def __init__(self, servos: Sequence[Servo]) -> None:
        self.servos = list(servos)
        self.deaf: frozenset[int] = frozenset()
        self._groups: dict[int, Callable[[Instruction, float, list[Servo]], list[Reply]]] = {
            Code.SYNC_READ: self._group_read,
            Code.BULK_READ: self._group_read,
            Code.FAST_SYNC_READ: self._fast_read,
            Code.FAST_BULK_READ: self._fast_read,
            Code.SYNC_WRITE: self._group_write,
            Code.BULK_WRITE: self._group_write,
        }

    def answer(self, instruction: Instruction, baud: int, time: float) -> list[Reply]:
        """Let all servos hear an instruction that came at a baud rate; their replies in order."""
        heard = [
            servo
            for servo in self.servos
            if servo.protocol == instruction.protocol
            and servo.listens(time)
            and servo.number not in self.deaf
            and abs(servo.baud - baud) <= _RATE_TOLERANCE * baud
        ]
        if not instruction.intact:
            return self._garbled(instruction, heard)
        for servo in heard:
            servo.heard(time)
        group = self._groups.get(instruction.code)
        if group is not None:
            return group(instruction, time, heard) if instruction.id == BROADCAST else []
        if instruction.id == BROADCAST:
            return self._broadcast(instruction, time, heard)
        return self._unicast(instruction, time, heard)

    def _garbled(self, instruction: Instruction, heard: list[Servo]) -> list[Reply]:
        level = 1 if instruction.code in _READS else 2
        return [
            _reply(instruction.protocol, servo, Error.CRC, b"")
            for servo in heard
            if servo.number == instruction.id and servo.status_level >= level
        ]

    def _broadcast(self, instruction: Instruction, time: float, heard: list[Servo]) -> list[Reply]:
        code = instruction.code
        if code == Code.PING:
            ordered = sorted(heard, key=lambda servo: servo.number)
            return [
                _reply(instruction.protocol, servo, Error.NONE, _identity(servo))
                for servo in ordered
            ]
        if code != Code.READ:
            for servo in heard:
                servo.execute(code, instruction.parameters, time, broadcast=True)
        return []

    def _unicast(self, instruction: Instruction, time: float, heard: list[Servo]) -> list[Reply]:
        replies = []
        code, number = instruction.code, instruction.id
        for servo in heard:
            if servo.number != number:
                if servo.secondary == number and code not in _READS:
                    servo.execute(code, instruction.parameters, time, broadcast=False)
                continue
            level, delay = servo.status_level, servo.return_delay
            error, data = servo.execute(code, instruction.parameters, time, broadcast=False)
            needed = 0 if code == Code.PING else 1 if code == Code.READ else 2
            if level >= needed:
                replies.append(_reply(instruction.protocol, servo, error, data, number, delay))
        return replies

    # Groups

    def _group_read(self, instruction: Instruction, time: float, heard: list[Servo]) -> list[Reply]:
        by_number = {servo.number: servo for servo in heard}
        replies = []
        for number, address, length in read_items(instruction):
            servo = by_number.get(number)
            if servo is None or servo.status_level < 1:
                replies.append(Reply(number, 0.0, None))
                continue
            error, data = servo.read(address, length, time)
            replies.append(_reply(instruction.protocol, servo, error, data))
        return replies

    def _fast_read(self, instruction: Instruction, time: float, heard: list[Servo]) -> list[Reply]:
        by_number = {servo.number: servo for servo in heard}
        answers = []
        delay = 0.0
        for number, address, length in read_items(instruction):
            servo = by_number.get(number)
            if not isinstance(servo, ModernServo) or not servo.has_fast_read:
                return []
            error, data = servo.read(address, length, time)
            answers.append((error | servo.error_bits, number, data or bytes(length)))
            delay = delay or servo.return_delay
        return [Reply(BROADCAST, delay, fast_status(answers))] if answers else []

    def _group_write(
        self, instruction: Instruction, time: float, heard: list[Servo]
    ) -> list[Reply]:
        by_number: dict[int | None, list[Servo]] = {}
        for servo in heard:
            by_number.setdefault(servo.number, []).append(servo)
            by_number.setdefault(servo.secondary, []).append(servo)
        for number, address, data in write_items(instruction):
            for servo in by_number.get(number, ()):
                servo.write(address, data, time)
        return []


def _identity(servo: Servo) -> bytes:
    return b"" if servo.protocol == 1 else servo.identity


def _reply(
    protocol: int,
    servo: Servo,
    error: Error,
    data: bytes,
    number: int | None = None,
    delay: float | None = None,
) -> Reply:
    """Status packet of a servo; what is given besides is as it was before the instruction."""
    number = servo.number if number is None else number
    delay = servo.return_delay if delay is None else delay
    if protocol == 1:
        bits = servo.legacy_bits | (LEGACY_ERROR[error] if error else 0)
        return Reply(number, delay, legacy_status(number, bits, data))
    return Reply(number, delay, status(number, error | servo.error_bits, data))


def read_items(instruction: Instruction) -> Iterator[Item]:
    """What a group read asks for; nothing if its parameters make no sense."""
    p = instruction.parameters
    if instruction.code in (Code.SYNC_READ, Code.FAST_SYNC_READ):
        if instruction.protocol == 2 and len(p) > 4:
            address, length = _word(p, 0), _word(p, 2)
            yield from ((number, address, length) for number in p[4:])
    elif instruction.protocol == 2:
        if len(p) % 5 == 0:
            yield from ((p[k], _word(p, k + 1), _word(p, k + 3)) for k in range(0, len(p), 5))
    elif len(p) % 3 == 1 and p[0] == 0:
        yield from ((p[k + 1], p[k + 2], p[k]) for k in range(1, len(p), 3))


def write_items(instruction: Instruction) -> Iterator[tuple[int, int, bytes]]:
    """Id, address and data of a group write; what does not fit at the end is left out."""
    p = instruction.parameters
    if instruction.code == Code.BULK_WRITE:
        at = 0
        while instruction.protocol == 2 and len(p) >= at + 5:
            length = _word(p, at + 3)
            if len(p) < at + 5 + length:
                return
            yield p[at], _word(p, at + 1), p[at + 5 : at + 5 + length]
            at += 5 + length
        return
    wide = instruction.protocol  # bytes of an address
    if len(p) <= 2 * wide:
        return
    address = int.from_bytes(p[:wide], "little")
    length = int.from_bytes(p[wide : 2 * wide], "little")
    for at in range(2 * wide, len(p) - length, length + 1):
        yield p[at], address, p[at + 1 : at + 1 + length]


def _word(data: bytes, at: int) -> int:
    return data[at] | data[at + 1] << 8
