"""Emergency messages (CiA 301, 7.2.7): what a node says has gone wrong, in words."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

from typing_extensions import override

from crtk_driver_canopen.drive_profile import PLAIN, DriveProfile

REGISTER_BITS: Final[Mapping[int, str]] = MappingProxyType(
    {
        0: "generic",
        1: "current",
        2: "voltage",
        3: "temperature",
        4: "communication",
        5: "device profile",
        7: "manufacturer",
    }
)
"""Of the error register (1001)."""

ERROR_CODES: Final[Mapping[int, str]] = MappingProxyType(
    {
        # CiA 301, table 26: classes.
        0x0000: "no error",
        0x1000: "generic error",
        0x2000: "current",
        0x2100: "current at the input",
        0x2200: "current inside the device",
        0x2300: "current at the output",
        0x3000: "voltage",
        0x3100: "mains voltage",
        0x3200: "voltage inside the device",
        0x3300: "output voltage",
        0x4000: "temperature",
        0x4100: "ambient temperature",
        0x4200: "device temperature",
        0x5000: "device hardware",
        0x6000: "device software",
        0x6100: "internal software",
        0x6200: "user software",
        0x6300: "data set",
        0x7000: "additional modules",
        0x8000: "monitoring",
        0x8100: "communication",
        0x8110: "CAN overrun: objects were lost",
        0x8120: "CAN error passive",
        0x8130: "heartbeat or life guarding of another node lost",
        0x8140: "recovered from bus-off",
        0x8150: "CAN-ID collision",
        0x8200: "protocol",
        0x8210: "PDO not processed: too short",
        0x8220: "PDO too long",
        0x8230: "DAM MPDO not processed: destination not available",
        0x8240: "unexpected SYNC length",
        0x8250: "RPDO time-out",
        0x9000: "external error",
        0xF000: "additional functions",
        0xFF00: "of the manufacturer",
        # CiA 402-2, error codes.
        0x2110: "short circuit or earth leakage at the input",
        0x2120: "earth leakage at the input",
        0x2130: "short circuit at the input",
        0x2211: "current inside the device, number 1",
        0x2212: "current inside the device, number 2",
        0x2213: "over-current in ramp function",
        0x2214: "over-current in the sequence",
        0x2220: "continuous over-current inside the device",
        0x2230: "short circuit or earth leakage inside the device",
        0x2240: "earth leakage inside the device",
        0x2250: "short circuit inside the device",
        0x2310: "continuous over-current at the output",
        0x2320: "short circuit or earth leakage at the motor",
        0x2330: "earth leakage at the motor",
        0x2340: "short circuit at the motor",
        0x2350: "load level: I²t, thermal state",
        0x2351: "load level warning: I²t, thermal state",
        0x3110: "mains over-voltage",
        0x3120: "mains under-voltage",
        0x3130: "mains phase failure",
        0x3140: "mains frequency",
        0x3210: "DC link over-voltage",
        0x3220: "DC link under-voltage",
        0x3230: "load error",
        0x3310: "output over-voltage",
        0x3320: "armature circuit",
        0x3330: "field circuit",
        0x4110: "excess ambient temperature",
        0x4120: "too low ambient temperature",
        0x4130: "temperature of supply air",
        0x4140: "temperature of air outlet",
        0x4210: "excess temperature of the device",
        0x4220: "too low temperature of the device",
        0x4300: "temperature of the drive",
        0x4310: "excess temperature of the drive",
        0x4320: "too low temperature of the drive",
        0x4400: "temperature of the supply",
        0x4410: "excess temperature of the supply",
        0x4420: "too low temperature of the supply",
        0x5100: "supply of the electronics",
        0x5110: "supply low voltage",
        0x5111: "supply of ±15 V",
        0x5112: "supply of +24 V",
        0x5113: "supply of +5 V",
        0x5120: "supply of the intermediate circuit",
        0x5200: "control",
        0x5210: "measurement circuit",
        0x5220: "computing circuit",
        0x5300: "operating unit",
        0x5400: "power section",
        0x5410: "output stages",
        0x5420: "chopper",
        0x5430: "input stages",
        0x5440: "contacts",
        0x5441: "contact 1: enable or safe torque off",
        0x5450: "fuses",
        0x5500: "data storage",
        0x5510: "working memory",
        0x5520: "program memory",
        0x5530: "non-volatile data memory",
        0x6010: "software reset: watchdog",
        0x6310: "loss of parameters",
        0x6320: "error in parameters",
        0x7100: "power",
        0x7110: "brake chopper",
        0x7111: "brake chopper failure",
        0x7112: "brake chopper over-current",
        0x7113: "protective circuit of the brake chopper",
        0x7120: "motor",
        0x7121: "motor blocked",
        0x7122: "motor error or commutation malfunction",
        0x7123: "motor tilted",
        0x7200: "measurement circuit",
        0x7300: "sensor",
        0x7301: "tacho fault",
        0x7302: "tacho: wrong polarity",
        0x7303: "resolver 1 fault",
        0x7304: "resolver 2 fault",
        0x7305: "incremental sensor 1 fault",
        0x7306: "incremental sensor 2 fault",
        0x7307: "incremental sensor 3 fault",
        0x7310: "speed",
        0x7320: "position",
        0x7400: "computation circuit",
        0x7500: "communication",
        0x7510: "serial interface 1",
        0x7520: "serial interface 2",
        0x7600: "data storage, external",
        0x8300: "torque control",
        0x8311: "excess torque",
        0x8312: "difficult start-up",
        0x8313: "standstill torque",
        0x8321: "insufficient torque",
        0x8331: "torque fault",
        0x8400: "speed control",
        0x8500: "position control",
        0x8600: "positioning controller",
        0x8611: "following error",
        0x8612: "reference limit: target beyond the position limits",
        0x8700: "synchronisation controller",
        0x8800: "winding controller",
        0x8900: "process data monitoring",
        0x8A00: "control monitoring",
        0xF001: "deceleration",
        0xF002: "sub-synchronous run",
        0xF003: "stroke operation",
        0xF004: "control",
    }
)
"""By error code (603F, and the first two bytes of an emergency message)."""


def error_text(code: int) -> str:
    """Return what an error code means: its own text, or that of its class."""
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        text = ERROR_CODES.get(code & mask)
        if text is not None and (code & mask or not code):
            return text
    return "unknown error"


def register_text(register: int) -> str:
    """Return the bits of an error register in words; empty if none is set."""
    return ", ".join(text for bit, text in REGISTER_BITS.items() if register >> bit & 1)


class Emergency(NamedTuple):
    """One emergency message.

    Attributes:
        node: that sent it.
        code: 0 says that an error is gone.
        register: error register (1001).
        vendor: five bytes, whose meaning is the manufacturer's.
        text: what the code means to drives of this make; empty if nothing of its own.
        home_lost: the drive does not know its position any more.
    """

    node: int
    code: int
    register: int
    vendor: bytes
    text: str = ""
    home_lost: bool = False

    @property
    def is_reset(self) -> bool:
        """Whether it says that an error is gone."""
        return self.code & 0xFF00 == 0

    @override
    def __str__(self) -> str:
        text = f"node {self.node}: {self.text or error_text(self.code)} (0x{self.code:04x})"
        if self.register:
            text += f", error register: {register_text(self.register) or hex(self.register)}"
        return text + (f", vendor bytes {self.vendor.hex(' ')}" if any(self.vendor) else "")


def decode(node: int, data: bytes, profile: DriveProfile = PLAIN) -> Emergency:
    """Return the emergency message of a frame; one that is too short counts as filled with zeros.

    Args:
        node: from its COB-ID.
        data: up to 8 bytes: code, error register, five of the manufacturer.
        profile: of the drive.
    """
    whole = data[:8].ljust(8, b"\0")
    code = int.from_bytes(whole[:2], "little")
    row = profile.error(code)
    return Emergency(
        node,
        code,
        whole[2],
        whole[3:],
        "" if row is None else row.text,
        row is not None and row.home_lost,
    )
