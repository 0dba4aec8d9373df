"""The faults that simulated buses can have, as a table for fault files and injection.

The kinds of `REPLIES` change the status packets of a servo (or of all); others happen to the wire, to
the adapter, or to the servos themselves (`BEGIN` and `END`).
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from crtk_sim_backends.dynamixel.modern import OVERLOAD
from crtk_sim_backends.dynamixel.packets import HEADER, crc16
from crtk_sim_backends.dynamixel.servo import AMBIENT, Servo
from crtk_sim_backends.faults import FaultKind, Parameter

Parameters = Mapping[str, Any]

EVENTS: Final = ("instruction", "torque_on", "torque_off", "motion_started", "motion_stopped")
"""What an entry of a fault file can wait for with `when`; "instruction" is the first one on any bus."""

ALL: Final = -1
"""Id that stands for every servo."""

ANY: Final = -1
"""Instruction code or address that stands for all of them."""

_ID: Final = Parameter(int, ALL, minimum=-1, maximum=252)
_BUS: Final = Parameter(int, 1, minimum=1, maximum=16)
_EVERY: Final = Parameter(int, 1, minimum=1)


def _flip_crc(packet: bytes, parameters: Parameters, generator: random.Random) -> bytes:
    return packet[:-1] + bytes((packet[-1] ^ generator.randrange(1, 256),))


def _flip_any(packet: bytes, parameters: Parameters, generator: random.Random) -> bytes:
    at = generator.randrange(len(packet))
    return packet[:at] + bytes((packet[at] ^ generator.randrange(1, 256),)) + packet[at + 1 :]


def _truncate(packet: bytes, parameters: Parameters, generator: random.Random) -> bytes:
    return packet[: max(0, len(packet) - parameters["missing"])]


def _collide(packet: bytes, parameters: Parameters, generator: random.Random) -> bytes:
    """What two servos with one id put on the wire together; their data differ by one bit each."""
    if packet[:4] == HEADER:
        other = packet[:9] + bytes(byte ^ 1 << byte % 8 for byte in packet[9:-2])
        other += crc16(other).to_bytes(2, "little")
    else:
        other = packet[:5] + bytes(byte ^ 1 << byte % 8 for byte in packet[5:-1])
        other += bytes((~sum(other[2:]) & 0xFF,))
    return overlay(packet, other)


def _noise(packet: bytes, parameters: Parameters, generator: random.Random) -> bytes:
    return generator.randbytes(parameters["bytes"]) + packet


def overlay(one: bytes, other: bytes) -> bytes:
    """What is heard when two transmit at once: a zero wins."""
    return bytes(a & b for a, b in itertools.zip_longest(one, other, fillvalue=0xFF))


REPLIES: Final[Mapping[str, Callable[[bytes, Parameters, random.Random], bytes]]] = {
    "drop": lambda packet, parameters, generator: b"",
    "crc": _flip_crc,
    "corrupt": _flip_any,
    "truncate": _truncate,
    "duplicate_id": _collide,
    "noise": _noise,
}
"""Kinds that change status packets, in the order in which they do."""


def stuffing_values(seed: int) -> Iterator[tuple[int, int, int]]:
    """Current, velocity and position whose bytes need stuffing, or nearly so, for ever."""
    generator = random.Random(seed)
    tricky = (0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00)
    fixed = [(-1, -3, 2048), (-1, 253, 0x00FDFDFF), (0, -131073, -3), (-1, -3, -131073)]
    yield from fixed
    while True:
        data = bytes(generator.choice(tricky) for _ in range(10))
        yield (
            int.from_bytes(data[:2], "little", signed=True),
            int.from_bytes(data[2:6], "little", signed=True),
            int.from_bytes(data[6:], "little", signed=True),
        )


def _stuff(servo: Servo, parameters: Parameters) -> None:
    servo.stuffing = stuffing_values(parameters["seed"])


def _claim(servo: Servo, parameters: Parameters) -> None:
    data = bytes.fromhex(parameters["data"])
    servo.claims = {parameters["address"] + n: byte for n, byte in enumerate(data)}


def _set(name: str, value: Callable[[Parameters], object]) -> Callable[[Servo, Parameters], None]:
    return lambda servo, parameters: setattr(servo, name, value(parameters))


def _joint(name: str, value: Callable[[Parameters], object]) -> Callable[[Servo, Parameters], None]:
    def change(servo: Servo, parameters: Parameters) -> None:
        setattr(servo.joint, name, value(parameters))
        servo.joint.wake()

    return change


def _overload(servo: Servo, parameters: Parameters) -> None:
    servo.force_error(OVERLOAD)


def _hardware_error(servo: Servo, parameters: Parameters) -> None:
    servo.force_error(parameters["bit"])


def _power_off(servo: Servo, parameters: Parameters) -> None:
    servo.reboot(servo.joint.time)
    servo.powered = False


def _power_on(servo: Servo, parameters: Parameters) -> None:
    servo.powered = True
    servo.reboot(servo.joint.time)


def _cool_down(servo: Servo, parameters: Parameters) -> None:
    servo.heat_source, servo.temperature = None, AMBIENT


def _reset_voltage(servo: Servo, parameters: Parameters) -> None:
    servo.supply = servo.model.supply
    servo.drive.supply = 1.0


def _voltage(servo: Servo, parameters: Parameters) -> None:
    servo.supply = parameters["volts"]
    servo.drive.supply = parameters["volts"] / servo.model.supply
    servo.joint.wake()


BEGIN: Final[Mapping[str, Callable[[Servo, Parameters], None]]] = {
    "stuck": _joint("stuck", lambda p: True),
    "push": _joint("push", lambda p: p["torque"]),
    "overload": _overload,
    "hardware_error": _hardware_error,
    "overheat": _set("heat_source", lambda p: p["temperature"]),
    "voltage": _voltage,
    "power_off": _power_off,
    "stuffing": _stuff,
    "claim": _claim,
}
"""What the kinds that happen to servos do when they begin."""

END: Final[Mapping[str, Callable[[Servo, Parameters], None]]] = {
    "stuck": _joint("stuck", lambda p: False),
    "push": _joint("push", lambda p: 0.0),
    "overheat": _cool_down,
    "voltage": _reset_voltage,
    "power_off": _power_on,
    "stuffing": _set("stuffing", lambda p: None),
    "claim": _set("claims", lambda p: {}),
}
"""What they do when they are cleared; kinds that are not here cannot be."""


def _reply_kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    own = {"bus": _BUS, "id": _ID, "every": _EVERY, **parameters}
    return FaultKind(name, summary, own, lasting=True)


def _servo_kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, {"bus": _BUS, "id": _ID, **parameters}, lasting=name in END)


KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        _reply_kind("drop", "every n-th status packet is lost"),
        _reply_kind("lost", "every n-th instruction is heard by no servo"),
        FaultKind(
            "message",
            "the n-th instruction of a kind, and so many from it on, is lost, heard twice, or heard later",
            {
                "bus": _BUS,
                "code": Parameter(int, ANY, minimum=ANY, maximum=255),
                "address": Parameter(int, ANY, minimum=ANY, maximum=65535),
                "number": Parameter(int, 1, minimum=1),
                "times": Parameter(int, 1, minimum=1),
                "effect": Parameter(str, "lost", choices=("lost", "doubled", "late")),
                "seconds": Parameter(float, 0.03, minimum=0.0001, maximum=60.0),
            },
            lasting=True,
        ),
        _reply_kind("crc", "every n-th status packet has a wrong CRC"),
        _reply_kind("corrupt", "a byte of every n-th status packet is changed"),
        _reply_kind(
            "truncate",
            "the end of every n-th status packet is missing",
            missing=Parameter(int, 3, minimum=1, maximum=1000),
        ),
        _reply_kind("duplicate_id", "two servos have this id and answer at once"),
        _reply_kind(
            "noise",
            "random bytes before every n-th status packet",
            bytes=Parameter(int, 3, minimum=1, maximum=1000),
        ),
        _reply_kind(
            "late",
            "every n-th status packet arrives later by this time",
            seconds=Parameter(float, 0.05, minimum=0.0001, maximum=60.0),
        ),
        FaultKind(
            "silent",
            "a servo neither hears nor answers, and those behind it in a group read stall or go on",
            {
                "bus": _BUS,
                "id": _ID,
                "chain": Parameter(str, "stalls", choices=("stalls", "goes_on")),
            },
            lasting=True,
        ),
        FaultKind("echo", "the adapter hears what it sends", {"bus": _BUS}, lasting=True),
        FaultKind(
            "latency",
            "the adapter hands over what it received at multiples of this time only",
            {"bus": _BUS, "milliseconds": Parameter(float, 16.0, minimum=0.125, maximum=255.0)},
            lasting=True,
        ),
        FaultKind(
            "stall",
            "the adapter hands over nothing; cleared: all that it has received, in order",
            {"bus": _BUS},
            lasting=True,
        ),
        FaultKind(
            "unplug", "the adapter is unplugged; cleared: a new tty", {"bus": _BUS}, lasting=True
        ),
        _servo_kind("stuck", "the joint is blocked mechanically"),
        _servo_kind(
            "push",
            "somebody pushes at the joint (N.m)",
            torque=Parameter(float, minimum=-1000.0, maximum=1000.0),
        ),
        _servo_kind("overload", "the servo detects an overload"),
        _servo_kind(
            "hardware_error",
            "the servo detects a hardware error: a bit of Hardware Error Status",
            bit=Parameter(int, minimum=0, maximum=7),
        ),
        _servo_kind(
            "overheat",
            "the motor has this temperature (Celsius); cleared: it has cooled down",
            temperature=Parameter(float, 95.0, minimum=-20.0, maximum=200.0),
        ),
        _servo_kind(
            "voltage",
            "the supply has this voltage (V)",
            volts=Parameter(float, minimum=0.5, maximum=60.0),
        ),
        _servo_kind("power_off", "no supply; cleared: it starts again"),
        _servo_kind(
            "stuffing",
            "it claims to measure current, velocity and position that need byte stuffing",
            seed=Parameter(int, 0),
        ),
        _servo_kind(
            "claim",
            "its memory from an address on reads as these bytes (hexadecimal), whatever it holds",
            address=Parameter(int, minimum=0, maximum=65535),
            data=Parameter(str),
        ),
    )
}
"""Every kind of fault, by name."""
