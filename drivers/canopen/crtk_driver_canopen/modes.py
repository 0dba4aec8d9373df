"""Modes of operation (CiA 402-2): numbers and bits, changing between them, and the set-point handshake."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum, IntFlag, StrEnum
from types import MappingProxyType
from typing import Final, NamedTuple

from crtk_driver_canopen.statemachine import State, decode


class OpMode(IntEnum):
    """Modes of operation (6060, 6061)."""

    NONE = 0
    PP = 1
    VL = 2
    PV = 3
    TQ = 4
    HM = 6
    IP = 7
    CSP = 8
    CSV = 9
    CST = 10


class Way(StrEnum):
    """What an axis can be told to follow; the earlier ones are better to hold still in."""

    POSITIONS = "positions in each cycle"
    MOVES = "moves of its own"
    VELOCITIES = "velocities in each cycle"
    EFFORTS = "efforts in each cycle"


WAYS: Final[Mapping[Way, tuple[OpMode, ...]]] = MappingProxyType(
    {
        Way.POSITIONS: (OpMode.CSP, OpMode.IP),
        Way.MOVES: (OpMode.PP,),
        Way.VELOCITIES: (OpMode.CSV, OpMode.PV),
        Way.EFFORTS: (OpMode.CST, OpMode.TQ),
    }
)
"""Modes of operation for each way, the better one first."""

TARGETS: Final[Mapping[OpMode, str]] = MappingProxyType(
    {
        OpMode.CSP: "target_position",
        OpMode.PP: "target_position",
        OpMode.IP: "interpolation_position",
        OpMode.CSV: "target_velocity",
        OpMode.PV: "target_velocity",
        OpMode.CST: "target_torque",
        OpMode.TQ: "target_torque",
    }
)
"""The object that takes the setpoint of each mode."""


class ModeBits(IntFlag):
    """Bits of the controlword whose meaning depends on the mode."""

    NEW_SETPOINT = 0x0010
    HOMING_START = 0x0010
    IP_ENABLE = 0x0010
    IMMEDIATELY = 0x0020
    RELATIVE = 0x0040
    CHANGE_ON_SETPOINT = 0x0200


class ModeRow(NamedTuple):
    """What a mode is, and what it makes of the statusword.

    Attributes:
        bit: of supported drive modes (6502).
        status: meaning of bits 10, 12 and 13 of the statusword, for those it uses.
    """

    name: str
    bit: int
    status: Mapping[int, str]


_REACHED: Final = {10: "target reached"}
_FOLLOWS: Final = {12: "follows the command", 13: "following error"}

MODES: Final[Mapping[OpMode, ModeRow]] = MappingProxyType(
    {
        OpMode.PP: ModeRow(
            "profile position",
            0,
            _REACHED | {12: "set-point acknowledged", 13: "following error"},
        ),
        OpMode.VL: ModeRow("velocity (inverter)", 1, {}),
        OpMode.PV: ModeRow("profile velocity", 2, _REACHED | {12: "speed is 0", 13: "slippage"}),
        OpMode.TQ: ModeRow("torque profile", 3, _REACHED),
        OpMode.HM: ModeRow("homing", 5, _REACHED | {12: "homing attained", 13: "homing error"}),
        OpMode.IP: ModeRow("interpolated position", 6, _REACHED | {12: "interpolation active"}),
        OpMode.CSP: ModeRow("cyclic synchronous position", 7, _FOLLOWS),
        OpMode.CSV: ModeRow("cyclic synchronous velocity", 8, _FOLLOWS),
        OpMode.CST: ModeRow("cyclic synchronous torque", 9, _FOLLOWS),
    }
)
"""CiA 402-2: supported drive modes, and the mode-specific bits of the statusword."""

_COMMON_BITS: Final = {
    7: "warning",
    9: "remote",
    11: "internal limit",
}


def mode_text(number: int) -> str:
    """Return the name of a mode; negative numbers are the manufacturer's."""
    if number in MODES:
        return MODES[OpMode(number)].name
    return "no mode" if number == 0 else f"mode {number}"


def supported(word: int) -> frozenset[OpMode]:
    """Return the modes that supported drive modes (6502) names."""
    return frozenset(mode for mode, row in MODES.items() if word >> row.bit & 1)


def status_text(statusword: int, mode: int) -> str:
    """Return what a statusword says: the state, and the bits that are set, in words."""
    state = decode(statusword)
    meanings = dict(_COMMON_BITS)
    if mode in MODES:
        meanings |= MODES[OpMode(mode)].status
    words = [meanings[bit] for bit in sorted(meanings) if statusword >> bit & 1]
    if not statusword >> 4 & 1 and state is not State.NOT_READY:
        words.append("no voltage")
    return ", ".join([str(state or "no state"), *words])


class ModeChange:
    """Waits until a drive shows (6061) the mode that was written (6060), without waiting itself.

    Args:
        timeout: seconds.

    Attributes:
        wanted: the mode; None before the first `request`, when any is right.
        done: whether it is shown.
        failure: why it is not, in words; empty while there is time.
    """

    def __init__(self, timeout: float = 1.0) -> None:
        self.wanted: int | None = None
        self.done = True
        self.failure = ""
        self._timeout = timeout
        self._since: float | None = None

    def request(self, mode: int) -> None:
        """Want a mode."""
        self.wanted, self.done, self.failure, self._since = mode, False, "", None

    def step(self, shown: int, now: float) -> bool:
        """Return whether the drive shows the mode.

        Args:
            shown: mode of operation display (6061).
            now: monotonic seconds.
        """
        wanted = shown if self.wanted is None else self.wanted
        self.done = shown == wanted
        if self.done:
            self.failure, self._since = "", None
            return True
        if self._since is None:
            self._since = now
        if now - self._since > self._timeout:
            self.failure = (
                f"it still shows {mode_text(shown)} {self._timeout:g} s after {mode_text(wanted)} "
                "was asked for"
            )
        return False


class HandshakePhase(IntEnum):
    """Where a set-point of profile position mode is."""

    IDLE = 0
    CLEAR = 1
    TARGET = 2
    ASSERT = 3
    RELEASE = 4
    MOVING = 5
    REACHED = 6
    FAILED = 7


class _Row(NamedTuple):
    """One phase: bits to send, and what ends it: the statusword under `mask` is `value`."""

    bits: int
    mask: int
    value: int
    next: HandshakePhase
    timeout: float
    late: str


_ACK: Final = 0x1000
_TARGET_REACHED: Final = 0x0400
_P = HandshakePhase

HANDSHAKE: Final[Mapping[HandshakePhase, _Row]] = MappingProxyType(
    {
        _P.CLEAR: _Row(0, _ACK, 0, _P.TARGET, 1.0, "still acknowledges the last set-point"),
        _P.TARGET: _Row(0, 0, 0, _P.ASSERT, 1.0, ""),
        _P.ASSERT: _Row(0x10, _ACK, _ACK, _P.RELEASE, 1.0, "does not acknowledge the set-point"),
        _P.RELEASE: _Row(0, _ACK, 0, _P.MOVING, 1.0, "does not withdraw its acknowledgement"),
        _P.MOVING: _Row(
            0, _TARGET_REACHED, _TARGET_REACHED, _P.REACHED, float("inf"), "does not get there"
        ),
    }
)
"""Profile position, single set-point: the target (607A) is sent from TARGET on, before bit 4 rises in ASSERT.

Target reached counts only in MOVING, when it cannot be that of the last set-point any more.
"""


class SetpointHandshake:
    """Hands one target position to a drive in profile position mode, and waits until it is there.

    Args:
        immediately: the drive leaves a running set-point for this one (bit 5).
        relative: the target counts from where the drive is or was going (bit 6).

    Attributes:
        phase: where the set-point is.
        failure: why it was not taken, in words; empty if it was.
    """

    def __init__(self, *, immediately: bool = True, relative: bool = False) -> None:
        self.phase = HandshakePhase.IDLE
        self.failure = ""
        self._always = immediately * int(ModeBits.IMMEDIATELY) | relative * int(ModeBits.RELATIVE)
        self._since: float | None = None

    @property
    def sends_target(self) -> bool:
        """Whether the target position (607A) must be the new one in this cycle."""
        return HandshakePhase.TARGET <= self.phase <= HandshakePhase.MOVING

    @property
    def handed_over(self) -> bool:
        """Whether the drive is told of the set-point, or has taken it: it goes nowhere else."""
        return HandshakePhase.ASSERT <= self.phase <= HandshakePhase.REACHED

    def start(self) -> None:
        """Hand over a set-point; another one may still be on its way."""
        self.phase, self.failure, self._since = HandshakePhase.CLEAR, "", None

    def cancel(self) -> None:
        """Forget the set-point: the drive is halted, or goes to another mode."""
        self._enter(HandshakePhase.IDLE)

    def step(self, statusword: int, now: float) -> int:
        """Return the bits of the controlword to send (`crtk_driver_canopen.statemachine.Drive402.mode_bits`).

        Args:
            statusword: of the last TPDO.
            now: monotonic seconds.
        """
        row = HANDSHAKE.get(self.phase)
        if row is None:
            return 0
        state = decode(statusword)
        if state is not State.ENABLED:
            self._enter(HandshakePhase.FAILED, f"the drive is {state or 'in no state'}")
            return 0
        if self._since is None:
            self._since = now
        elif statusword & row.mask == row.value:
            self._enter(row.next)
            self._since = now
        elif now - self._since > row.timeout:
            self._enter(HandshakePhase.FAILED, f"it {row.late} (bit 12) after {row.timeout:g} s")
        row = HANDSHAKE.get(self.phase)
        return 0 if row is None else row.bits | self._always

    def _enter(self, phase: HandshakePhase, failure: str = "") -> None:
        self.phase, self.failure, self._since = phase, failure, None
