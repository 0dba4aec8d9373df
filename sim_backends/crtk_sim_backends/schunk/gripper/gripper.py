"""The simulated gripper: fingers, what lies between them, and the 16 bytes of its control and its status."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.jaw import JAW_KINDS, Jaw, Met
from crtk_sim_backends.schunk.gripper.config import SimConfig
from crtk_sim_backends.schunk.gripper.parameters import order_of

STATUS, CONTROL = 0x0040, 0x0048

RUN, STOP, ACKNOWLEDGE, SHUTDOWN, RESET, MANUAL, REPEAT, OUTWARD = (1 << bit for bit in range(8))
RELEASE, GRIP, MOVE, MOVE_BY, GRIP_AT, TEST = (1 << bit for bit in (11, 12, 13, 14, 16, 30))

READY, NOT_FEASIBLE, SUCCESS, TOGGLE = 1 << 0, 1 << 3, 1 << 4, 1 << 5
IS_WARNING, IS_ERROR, IS_MANUAL = 1 << 6, 1 << 7, 1 << 8
IS_SHUT = 1 << 2
NO_PART, GRIPPED, REACHED, PRE_GRIP, LOST, WRONG = (1 << bit for bit in (11, 12, 13, 14, 16, 17))
KEEP = 1 << 31
ENDS: Final = NOT_FEASIBLE | SUCCESS | NO_PART | GRIPPED | REACHED | PRE_GRIP | LOST | WRONG

NO_FIELDBUS, FAST_STOPPED, BLOCKED, NO_BRAKE = 0xEF, 0xD9, 0xF4, 0x28
INFEASIBLE: Final = 0x94
PRESSING: Final = 0.1
"""Seconds from contact to a grip, or to a move that counts as blocked."""
RELEASED: Final = 0.005
"""Metres by which it opens to let go."""

_CODE = Parameter(int, minimum=1, maximum=255)
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        *JAW_KINDS.values(),
        FaultKind("error", "it reports an error, and stops", {"code": _CODE}, lasting=True),
        FaultKind("warning", "it reports a warning", {"code": _CODE}, lasting=True),
        FaultKind(
            "unpowered", "no supply: it is silent, and starts anew when it is back", lasting=True
        ),
        FaultKind("manual", "its web page lets the fingers be moved by hand", lasting=True),
        FaultKind("shutdown", "somebody has prepared it for shutdown"),
        FaultKind("deaf", "it takes no commands", lasting=True),
        FaultKind(
            "other_master",
            "another master sends it elsewhere",
            {
                "position": Parameter(float, minimum=-1.0, maximum=1.0),
                "speed": Parameter(float, 0.1, minimum=1e-3, maximum=10.0),
            },
        ),
        FaultKind("wrong_part", "what it grips is of another size than expected", lasting=True),
    )
}


class Gripper:
    """One gripper."""

    kinds = KINDS

    def __init__(self, config: SimConfig) -> None:
        self._config = config
        self._order = order_of(config.fieldbus)
        self._has_brake = config.model.endswith("-m")
        opening = min(max(config.opening, config.lower), config.upper)
        self.jaw = Jaw(opening, config.object_width, config.object_stiffness)
        self.powered = True
        self.writes = self.taken = 0
        self._active: dict[str, Mapping[str, Any]] = {}
        self._start()
        if config.acknowledged:
            self._error, self._bits = 0, READY

    def _start(self) -> None:
        """Be as it is powered on."""
        self.written = bytearray(16)
        self._bits, self._error, self._warning = 0, NO_FIELDBUS, 0
        self._goal: float | None = None
        self._pace = self._force = 0.0

    # ------------------------------------------------------------------------------------ its images

    @property
    def report(self) -> bytes:
        """Its status."""
        error, warning = self._error, self._warning
        if "warning" in self._active:
            warning = self._active["warning"]["code"]
        bits = self._bits | IS_ERROR * bool(error) | IS_WARNING * bool(warning)
        if error or {"manual", "error"} & self._active.keys():
            bits &= ~READY
        bits |= IS_MANUAL * ("manual" in self._active)
        codes = error | warning << 16
        position = round(1e6 * self.jaw.opening)
        return struct.pack(f"{self._order}IiII", bits, position, 0, codes)

    def write(self, at: int, data: bytes) -> None:
        """Take bytes of its control, from byte `at`; a command is taken when its double word changes."""
        before = self._word
        self.written[at : at + len(data)] = data
        self.writes += 1
        word = self._word
        asks = word & (
            STOP | ACKNOWLEDGE | SHUTDOWN | RESET | RELEASE | GRIP | MOVE | MOVE_BY | TEST
        )
        fast_stop = before & RUN and not word & RUN
        if "deaf" in self._active or word == before or not (asks or fast_stop):
            return
        self.taken += 1
        self._bits ^= TOGGLE
        if fast_stop:
            self._fail(FAST_STOPPED)
        else:
            self._obey(word)

    @property
    def _word(self) -> int:
        (word,) = struct.unpack_from(f"{self._order}I", self.written)
        return int(word)

    def _obey(self, word: int) -> None:
        _, position, speed, force = struct.unpack(f"{self._order}Iiii", self.written)
        if word & RESET:
            self._start()
            return
        if word & ACKNOWLEDGE:
            self._error = self._active.get("error", {}).get("code", 0)
            self._bits = self._bits & TOGGLE | READY
            self._warning = 0
            return
        is_motion = not word & (STOP | SHUTDOWN)
        goal = 1e-6 * position
        if word & MOVE_BY:
            goal += self.jaw.opening
        is_out = word & (MOVE | MOVE_BY) and not self._config.lower <= goal <= self._config.upper
        no_force = word & GRIP and not 1 <= force <= 100
        self._bits &= ~(ENDS | IS_SHUT)
        self._warning = 0
        if self._error or (is_motion and (not self._bits & READY or is_out or no_force)):
            self._bits |= NOT_FEASIBLE
            self._warning = INFEASIBLE
            return
        self.jaw.stalled, self._force, self._goal = 0.0, 0.0, None
        self._bits = self._bits & ~KEEP | (KEEP * bool(word & KEEP and self._has_brake))
        if word & STOP:
            self._bits |= REACHED | SUCCESS
        elif word & SHUTDOWN:
            self._bits |= IS_SHUT | SUCCESS
        elif word & TEST:
            self._bits |= SUCCESS
            if not self._has_brake:
                self._fail(NO_BRAKE)
        elif word & GRIP:
            self._force = 0.01 * force * self._config.max_force
            self._goal = self._config.upper if word & OUTWARD else self._config.lower
            self._pace = 0.01 * force * self._config.grip_speed
        elif word & RELEASE:
            self._pace, self._goal = self._config.speed, self.jaw.opening + self._away()
        else:
            self._pace, self._goal = min(max(1e-6 * speed, 1e-3), self._config.speed), goal

    def _away(self) -> float:
        thing = self.jaw.thing
        return -RELEASED if thing is not None and thing.around else RELEASED

    def _fail(self, code: int) -> None:
        self._error, self._goal, self._force = code, None, 0.0
        self._bits &= TOGGLE

    # ------------------------------------------------------------------------------ its mechanics

    @property
    def moves(self) -> bool:
        """Whether its fingers go anywhere."""
        return self._goal is not None and not self._bits & ENDS

    @property
    def pressed(self) -> float:
        """With how much force its fingers press, in N."""
        return self._force if self.jaw.stalled else 0.0

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        if self._bits & GRIPPED:
            self.jaw.slip(seconds)
        if self.powered and self._goal is not None:
            self._follow(self._goal, seconds)

    def _follow(self, goal: float, seconds: float) -> None:
        goal = min(max(goal, self._config.lower), self._config.upper)
        met = self.jaw.follow(goal, self._pace, self._force, seconds)
        if met is Met.NOTHING:
            if self._bits & GRIPPED and not self.jaw.stalled:
                self._bits = self._bits & ~ENDS | LOST
        elif met is Met.OBJECT:
            self._touch()
        elif self._force:
            if not self._bits & LOST:
                self._bits = self._bits & ~ENDS | NO_PART
        else:
            self._bits |= REACHED | SUCCESS
            self._goal = None

    def _touch(self) -> None:
        if not self._force:
            if self.jaw.stalled > PRESSING:
                self._fail(BLOCKED)
        elif self.jaw.stalled > PRESSING:
            wrong = WRONG if "wrong_part" in self._active else 0
            self._bits = self._bits & ~ENDS | GRIPPED | SUCCESS | wrong
        else:
            self._bits |= PRE_GRIP

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if self.jaw.begin(fault):
            return
        self._active[fault.kind] = given
        acts: Mapping[str, Callable[[], object]] = {
            "error": lambda: self._fail(given["code"]),
            "unpowered": lambda: self._power(False),
            "shutdown": lambda: self._command(RUN | SHUTDOWN),
            "other_master": lambda: self._command(RUN | MOVE, given["position"], given["speed"]),
        }
        if fault.kind in acts:
            acts[fault.kind]()
        if not KINDS[fault.kind].lasting:
            del self._active[fault.kind]

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._active.pop(fault.kind, None)
        if not self.jaw.end(fault) and fault.kind == "unpowered":
            self._power(True)

    def _power(self, on: bool) -> None:
        self.powered = on
        self._start()

    def _command(self, word: int, position: float = 0.0, speed: float = 0.0) -> None:
        """Be commanded by another master."""
        self.write(0, struct.pack(f"{self._order}I", RUN) + bytes(12))
        micro = round(1e6 * position), round(1e6 * speed)
        self.write(0, struct.pack(f"{self._order}Iiii", word, *micro, 0))

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        report = struct.unpack(f"{self._order}IiII", self.report)
        return {
            **self.jaw.status,
            "bits": f"{report[0]:08x}",
            "error": f"{report[3] & 0xFF:02X}",
            "powered": self.powered,
            "moves": self.moves,
            "grips": bool(self._bits & GRIPPED),
            "force": self.pressed,
            "writes": self.writes,
            "taken": self.taken,
            "written": self.written.hex(" ", 4),
        }
