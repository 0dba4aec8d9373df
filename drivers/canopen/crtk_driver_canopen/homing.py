"""Homing (CiA 402-2): what the methods are, and a machine that starts one and tells how it ended.

The bits that report homing (13, 12 and 10 of the statusword) mean other things in other modes, and many
drives keep the result of the last homing until the next one has begun. So nothing counts before the drive
shows homing mode, and a result that was there before the start counts only after it has changed; but for
the methods that take the position as it is, which can be done before anyone has seen them run.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum, StrEnum
from types import MappingProxyType
from typing import Final

from crtk_driver_canopen.modes import ModeBits, OpMode, mode_text
from crtk_driver_canopen.statemachine import Control, State, decode


def _numbered(first: int, texts: tuple[str, ...]) -> dict[int, str]:
    return dict(enumerate(texts, start=first))


_HOME_SIDES: Final = (
    "home switch from the negative side, falling edge",
    "home switch from the negative side, rising edge",
    "home switch from the positive side, rising edge",
    "home switch from the positive side, falling edge",
)

METHODS: Final[Mapping[int, str]] = MappingProxyType(
    _numbered(1, ("negative limit switch and index", "positive limit switch and index"))
    | _numbered(
        3,
        (
            "positive home switch and index, from below",
            "positive home switch and index, from above",
        ),
    )
    | _numbered(
        5,
        (
            "negative home switch and index, from above",
            "negative home switch and index, from below",
        ),
    )
    | {n: f"{text}, and index, first upwards" for n, text in enumerate(_HOME_SIDES, start=7)}
    | {n: f"{text}, and index, first downwards" for n, text in enumerate(_HOME_SIDES, start=11)}
    | _numbered(17, ("negative limit switch", "positive limit switch"))
    | _numbered(19, ("positive home switch, from below", "positive home switch, from above"))
    | _numbered(21, ("negative home switch, from above", "negative home switch, from below"))
    | {n: f"{text}, first upwards" for n, text in enumerate(_HOME_SIDES, start=23)}
    | {n: f"{text}, first downwards" for n, text in enumerate(_HOME_SIDES, start=27)}
    | _numbered(33, ("index, downwards", "index, upwards"))
    | {35: "current position (old number)", 37: "current position"}
)
"""By number (6098); CiA 402-2, homing methods. Negative numbers are the manufacturer's."""

IMMEDIATE: Final = frozenset({35, 37})
"""Methods that do not move."""


def method_text(number: int) -> str:
    """Return what a homing method does."""
    if number in METHODS:
        return METHODS[number]
    if number == 0:
        return "no homing"
    return "of the manufacturer" if number < 0 else "reserved"


class HomingCode(Enum):
    """Bits 13, 12 and 10 of the statusword in homing mode."""

    RUNNING = 0b000
    NOT_RUNNING = 0b001
    ATTAINED_MOVING = 0b010
    DONE = 0b011
    ERROR_MOVING = 0b100
    ERROR = 0b101
    RESERVED_6 = 0b110
    RESERVED_7 = 0b111


def homing_code(statusword: int) -> HomingCode:
    """Return what a statusword in homing mode says of it."""
    return HomingCode(
        statusword >> 11 & 0b100 | statusword >> 11 & 0b010 | statusword >> 10 & 0b001
    )


class HomingPhase(StrEnum):
    """Where a homing is."""

    IDLE = "idle"
    PREPARE = "prepare"
    START = "start"
    RUNNING = "running"
    CANCEL = "cancel"
    DONE = "done"
    FAILED = "failed"
    CANCELLED = "cancelled"


_ENDS: Final[Mapping[HomingPhase, Mapping[HomingCode, tuple[HomingPhase, str]]]] = MappingProxyType(
    {
        HomingPhase.START: {
            HomingCode.RUNNING: (HomingPhase.RUNNING, ""),
            HomingCode.ATTAINED_MOVING: (HomingPhase.RUNNING, ""),
            HomingCode.ERROR_MOVING: (HomingPhase.RUNNING, ""),
            HomingCode.DONE: (HomingPhase.DONE, ""),
            HomingCode.ERROR: (HomingPhase.FAILED, "the drive reports a homing error"),
        },
        HomingPhase.RUNNING: {
            HomingCode.NOT_RUNNING: (HomingPhase.FAILED, "the drive has interrupted it"),
            HomingCode.DONE: (HomingPhase.DONE, ""),
            HomingCode.ERROR: (HomingPhase.FAILED, "the drive reports a homing error"),
        },
        HomingPhase.CANCEL: {
            HomingCode.NOT_RUNNING: (HomingPhase.CANCELLED, ""),
            HomingCode.DONE: (HomingPhase.CANCELLED, ""),
            HomingCode.ERROR: (HomingPhase.CANCELLED, ""),
        },
    }
)
"""What follows from a code in each phase; the others change nothing."""

_BITS: Final[Mapping[HomingPhase, int]] = MappingProxyType(
    {
        HomingPhase.START: int(ModeBits.HOMING_START),
        HomingPhase.RUNNING: int(ModeBits.HOMING_START),
        HomingPhase.CANCEL: int(Control.HALT),
    }
)

_SETTLE: Final = 0.05
"""Seconds in homing mode before its bits are those of homing, and after the start before they count."""

_TIMES: Final[Mapping[HomingPhase, tuple[float, str]]] = MappingProxyType(
    {
        HomingPhase.PREPARE: (1.0, "the drive does not show homing mode"),
        HomingPhase.START: (2.0, "the drive does not begin"),
        HomingPhase.CANCEL: (5.0, "the drive does not stop"),
    }
)
"""Longest time in a phase, in s, and what it means when it is over."""


class Homing:
    """One axis. `step` is called once for each SYNC, from the time homing mode (6060 = 6) is asked for.

    Args:
        method: its number (6098), which the drive has been given.
        timeout: seconds that it may run.

    Attributes:
        phase: where it is.
        failure: why it was not done, in words; empty if it was.
    """

    def __init__(self, method: int, timeout: float = 60.0) -> None:
        self.method = method
        self.phase = HomingPhase.IDLE
        self.failure = ""
        self._timeout = timeout
        self._since: float | None = None
        self._shown_since: float | None = None
        self._before: HomingCode | None = None

    @property
    def over(self) -> bool:
        """Whether it has ended, however."""
        return self.phase in (HomingPhase.DONE, HomingPhase.FAILED, HomingPhase.CANCELLED)

    def start(self) -> None:
        """Begin, at the next step."""
        self._enter(HomingPhase.PREPARE)
        self._shown_since = None

    def cancel(self) -> None:
        """Stop the axis, and end as cancelled."""
        if self.phase is HomingPhase.PREPARE:
            self._cancelled()
        elif self.phase in (HomingPhase.START, HomingPhase.RUNNING):
            self._enter(HomingPhase.CANCEL)

    def step(self, statusword: int, mode: int, now: float) -> int:
        """Return the bits of the controlword to send.

        Args:
            statusword: of the last TPDO.
            mode: that the drive shows (6061).
            now: monotonic seconds.
        """
        if self.over or self.phase is HomingPhase.IDLE:
            return 0
        if self._since is None:
            self._since = now
        passed = now - self._since
        state = decode(statusword)
        if state is not State.ENABLED:
            self._fail(f"the drive is {state or 'in no state'}")
        elif self.phase is HomingPhase.PREPARE:
            self._prepare(homing_code(statusword), mode, now)
        elif mode != OpMode.HM:
            self._fail(f"the drive shows {mode_text(mode)}")
        else:
            self._follow(homing_code(statusword), passed)
        if not self.over and self._since is not None:
            self._watch(passed)
        return _BITS.get(self.phase, 0)

    def _prepare(self, code: HomingCode, mode: int, now: float) -> None:
        if mode != OpMode.HM:
            self._shown_since = None
        elif self._shown_since is None:
            self._shown_since = now
        elif now - self._shown_since >= _SETTLE:
            self._before = code
            self._enter(HomingPhase.START)

    def _follow(self, code: HomingCode, passed: float) -> None:
        if self.phase is HomingPhase.START and code is self._before:
            # Unchanged: only a drive that runs, or one with nothing to do, can be believed.
            fresh = code is HomingCode.RUNNING or (
                code is HomingCode.DONE and self.method in IMMEDIATE
            )
            if not fresh or passed < _SETTLE:
                return
        self._before = None
        phase, failure = _ENDS[self.phase].get(code, (self.phase, ""))
        if phase is HomingPhase.FAILED:
            self._fail(failure)
        elif phase is HomingPhase.CANCELLED:
            self._cancelled()
        elif phase is not self.phase:
            self._enter(phase)

    def _watch(self, passed: float) -> None:
        limit, text = _TIMES.get(
            self.phase, (self._timeout, "it is not done; check switches, direction and speeds")
        )
        if passed > limit:
            self._fail(f"{text} after {limit:g} s")

    def _fail(self, text: str) -> None:
        self._end(HomingPhase.FAILED, text)

    def _cancelled(self) -> None:
        self._end(HomingPhase.CANCELLED, "it was stopped")

    def _end(self, phase: HomingPhase, text: str) -> None:
        self._enter(phase)
        self.failure = f"homing by method {self.method} ({method_text(self.method)}): {text}"

    def _enter(self, phase: HomingPhase) -> None:
        self.phase, self.failure, self._since = phase, "", None
