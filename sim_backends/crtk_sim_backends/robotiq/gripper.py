"""The simulated gripper: fingers, what lies between them, and the six bytes of its status."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.jaw import JAW_KINDS, Jaw, Met
from crtk_sim_backends.kit.modbus import ALL, window
from crtk_sim_backends.page import Gauge, Gauges
from crtk_sim_backends.robotiq.defects import GripperDefects
from crtk_sim_backends.robotiq.models import MODELS

COMMAND: Final = 1000
STATUS: Final = 2000
REGISTERS: Final = 3
"""First registers of both blocks, and how many each has."""

ACT: Final = 0x01
GTO: Final = 0x08
ATR: Final = 0x10

RESET, ACTIVATING, ACTIVE = 0, 1, 3
MOVING, OPENED_ONTO, CLOSED_ONTO, THERE = 0, 1, 2, 3

MAJOR: Final = 0xA
"""Faults from here up need a reset."""
NOT_YET, NOT_ACTIVE, SILENCE = 0x5, 0x7, 0x9

QUIET: Final = 1.0
"""Seconds without a request after which fault 9 is set; the next request clears it."""
PRESSING: Final = 0.1
"""Seconds for which the motor goes on to press after it has stalled; the screw holds without it."""
HOLDS_FIRST: Final = 1.0
"""Seconds after which fingers that give way do."""
GIVES_WAY_AT: Final = 0.02
"""m/s."""
RUNNING_CURRENT: Final = 0.1
NEWTONS_PER_AMPERE: Final = 250.0

SOUND: Final = GripperDefects()

_CODE = Parameter(int, minimum=0, maximum=15)
KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        *JAW_KINDS.values(),
        FaultKind(
            "gripper_fault",
            "the gripper reports a fault (gFLT); one from 10 up outlasts it, until a reset",
            {"code": _CODE},
            lasting=True,
        ),
        FaultKind(
            "controller_fault",
            "the controller reports a fault (kFLT)",
            {"code": _CODE},
            lasting=True,
        ),
        FaultKind("unpowered", "no supply: it is silent, and reset when it is back", lasting=True),
        FaultKind("deactivated", "another master resets it"),
        FaultKind(
            "deactivated_meanwhile", "another master resets it just before the next command comes"
        ),
        FaultKind("activated", "another master activates it"),
        FaultKind(
            "other_master",
            "another master sends it elsewhere",
            {
                "position": Parameter(int, minimum=0, maximum=255),
                "speed": Parameter(int, 255, minimum=0, maximum=255),
            },
        ),
        FaultKind(
            "other_model",
            "it is replaced by another gripper, which is not activated",
            {"model": Parameter(str, choices=tuple(MODELS))},
        ),
    )
}


class Gripper:
    """One gripper.

    Args:
        model: one of `MODELS`.
        jaw: its fingers.
        band: counts at which the fingers are open and closed as far as they go.
        activated: whether somebody has activated it already.
        lag: seconds by which gOBJ is told late; the echo of a request is not.
        sweep_speed: of its fingers in an activation, in m/s; 0: the greatest of the model.
        defects: what is wrong with it.
    """

    kinds = KINDS
    functions = ALL

    def __init__(
        self,
        model: str,
        jaw: Jaw,
        band: tuple[float, float],
        *,
        activated: bool,
        lag: float,
        sweep_speed: float = 0.0,
        defects: GripperDefects = SOUND,
    ) -> None:
        self._defects = defects
        self._lag = lag
        self._sweep_speed = sweep_speed
        self.model = MODELS[model]
        self.band = band
        self.jaw = jaw
        self.written = bytearray(6)
        self.powered = True
        self.writes = 0
        self._state = RESET
        self._object = MOVING
        self._told = MOVING
        self._now = 0.0
        self._to_tell: deque[tuple[float, int]] = deque()  # gOBJ, and from when on it is told
        self._fault = self._controller_fault = 0
        self._sweep: list[float] = []
        self.current = 0.0
        self._quiet = 0.0
        self._resets_next = False
        if activated:
            self.written[0], self._state = ACT, ACTIVE

    # ------------------------------------------------------------------------------- its registers

    def heard(self) -> None:
        """A request was understood, whatever it was."""
        self._quiet = 0.0
        if self._fault == SILENCE:
            self._fault = 0

    def read(self, address: int, count: int) -> bytes:
        """Return the bytes of registers; those of the command can be read, and read as zeros."""
        if COMMAND <= address < COMMAND + REGISTERS:
            window(COMMAND, REGISTERS, address, count)
            return bytes(2 * count)
        return self.report[window(STATUS, REGISTERS, address, count)]

    def write(self, address: int, data: bytes) -> None:
        """Take the bytes of registers."""
        self.meanwhile()
        self.command(window(COMMAND, REGISTERS, address, len(data) // 2).start, data)

    def meanwhile(self) -> None:
        """Let happen what another master does just before a command comes."""
        if self._resets_next:
            self._resets_next = False
            self.command(0, bytes(6))

    def command(self, at: int, data: bytes) -> None:
        """Take bytes of the command, from byte `at`."""
        before = bytes(self.written)
        self.written[at : at + len(data)] = data
        self.writes += 1
        action = self.written[0]
        if not action & ACT:
            self._state, self._sweep, self.current = RESET, [], 0.0
            self._object = self._told = MOVING  # a reset gripper reports no grip of before
            self._to_tell.clear()
            self._fault = NOT_ACTIVE if action & GTO else 0
        elif not before[0] & ACT:
            self._state, self._sweep = ACTIVATING, [self.model.stroke, 0.0, self.model.stroke]
            self._fault = 0
        elif action & GTO and self._state == ACTIVATING:
            self._fault = NOT_YET
        elif self._fault in (NOT_YET, NOT_ACTIVE):
            self._fault = 0
        if self.written != before and action & GTO:
            self._object = MOVING

    @property
    def report(self) -> bytes:
        """The registers from 2000 on."""
        action = self.written[0]
        status = action & (ACT | GTO) | self._state << 4 | self._told << 6
        fault = self._controller_fault << 4 | self._fault
        current = min(255, round(100.0 * self.current))
        return bytes((status, 0, fault, self.written[3], round(self.position), current))

    # ------------------------------------------------------------------------------ its mechanics

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self._quiet += seconds
        if self.powered and self._quiet > QUIET and not self._fault:
            self._fault = SILENCE
        self._now += seconds
        self._to_tell.append((self._now + self._lag, self._object))
        while self._to_tell and self._to_tell[0][0] <= self._now:
            _, self._told = self._to_tell.popleft()
        self.current = 0.0
        if not self.powered or self._fault >= MAJOR:
            return
        if self._state == ACTIVATING:
            pace = self._sweep_speed or self.model.speeds[1]
            press = self.model.forces[0]
            if self.jaw.follow(self._sweep[0], pace, press, seconds) is not Met.NOTHING:
                del self._sweep[0]
            if not self._sweep:
                self._state = ACTIVE
            self.current = RUNNING_CURRENT
        elif self._state == ACTIVE and self.written[0] & (ACT | GTO) == ACT | GTO:
            self._follow(seconds)

    def _follow(self, seconds: float) -> None:
        """Go to the position that was asked for."""
        jaw, held = self.jaw, self.jaw.thing if self._object == CLOSED_ONTO else None
        if held is not None:
            jaw.slip(seconds)
        if self._defects.gives_way and held is not None and jaw.stalled > HOLDS_FIRST:
            opened = jaw.opening + GIVES_WAY_AT * seconds
            jaw.opening = min(held.width + self._defects.gives_way, opened)
            jaw.stalled += seconds
            return
        _, _, _, asked, speed, force = self.written
        slow, fast = self.model.speeds
        weak, strong = self.model.forces
        short = self._defects.short
        goal = min(max(self._opening_at(asked), short), self.model.stroke)
        closes = goal < jaw.opening
        pace, press = slow + speed / 255 * (fast - slow), weak + force / 255 * (strong - weak)
        met = jaw.follow(goal, pace, self._defects.force_scale * press, seconds)
        if met is Met.NOTHING:
            self._object, self.current = MOVING, RUNNING_CURRENT
            return
        imagines = bool(self._defects.imagines) and goal == short
        blocked = (met is Met.OBJECT or imagines) and not self._defects.blind
        if self._object == MOVING or not blocked:
            onto = CLOSED_ONTO if closes or imagines else OPENED_ONTO
            self._object = onto if blocked else THERE
        if blocked and jaw.stalled < PRESSING:
            self.current = RUNNING_CURRENT + press / NEWTONS_PER_AMPERE

    def _opening_at(self, count: float) -> float:
        """Return the opening in m at a count."""
        open_at, closed_at = self.band
        return self.model.stroke * (closed_at - count) / (closed_at - open_at)

    @property
    def position(self) -> float:
        """Count of gPO: 0 open to 255 closed."""
        open_at, closed_at = self.band
        return closed_at - self.jaw.opening / self.model.stroke * (closed_at - open_at)

    # --------------------------------------------------------------------------------- its faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        given = fault.parameters
        if self.jaw.begin(fault):
            return
        acts: Mapping[str, Callable[[], object]] = {
            "gripper_fault": lambda: setattr(self, "_fault", given["code"]),
            "controller_fault": lambda: setattr(self, "_controller_fault", given["code"]),
            "unpowered": lambda: setattr(self, "powered", False),
            "deactivated": lambda: self.command(0, bytes(6)),
            "deactivated_meanwhile": lambda: setattr(self, "_resets_next", True),
            "activated": lambda: self.command(0, bytes((ACT, 0, 0, 0, 0, 0))),
            "other_master": lambda: self.command(
                0, bytes((ACT | GTO, 0, 0, given["position"], given["speed"], 0))
            ),
            "other_model": lambda: self._become(given["model"]),
        }
        acts[fault.kind]()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if self.jaw.end(fault):
            return
        if fault.kind == "controller_fault":
            self._controller_fault = 0
        elif fault.kind == "gripper_fault" and self._fault < MAJOR:
            self._fault = 0
        elif fault.kind == "unpowered":
            self.powered = True
            self.command(0, bytes(6))

    def _become(self, model: str) -> None:
        self.model = MODELS[model]
        self.command(0, bytes(6))

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        names = {RESET: "reset", ACTIVATING: "activating", ACTIVE: "active"}
        return {
            **self.jaw.status,
            "position": self.position,
            "state": names[self._state] if self.powered else "no power",
            "moves": bool(self.current) and self._object == MOVING,
            "object": self._object,
            "current": self.current,
            "fault": self._fault,
            "written": bytes(self.written).hex(" "),
            "writes": self.writes,
        }

    def gauges(self) -> list[Gauges]:
        """What the page shows."""
        current: Gauge = {"name": "current", "low": 0.0, "high": 2.55, "value": self.current}
        return [
            self.jaw.gauges(0.0, self.model.stroke),
            {"title": "Motor", "unit": "A", "rate": "", "digits": 2, "gauges": [current]},
        ]
