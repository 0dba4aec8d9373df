"""Fingers, what lies between them, and how they take commands: not at all while they are busy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.jaw import JAW_KINDS, Jaw, Met
from crtk_sim_backends.kit.modbus import ILLEGAL_ADDRESS, Refused
from crtk_sim_backends.onrobot import tool
from crtk_sim_backends.onrobot.config import SimConfig
from crtk_sim_backends.onrobot.models import MODELS, Registers
from crtk_sim_backends.onrobot.tool import Tool
from crtk_sim_backends.page import Gauge, Gauges

PUSHED: Final = {1: 0x04, 2: 0x10}
AT_POWER_ON: Final = 0x40
_LENGTH = Parameter(float, minimum=0.0, maximum=0.2)

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        *JAW_KINDS.values(),
        FaultKind(
            "safety_switch",
            "a safety switch is pushed (RG): it trips until power has been away",
            {"number": Parameter(int, 1, minimum=1, maximum=2)},
            lasting=True,
        ),
        FaultKind(
            "flags",
            "bits of the status that are set, and those that are not",
            {
                "set": Parameter(int, 0, minimum=0, maximum=0xFFFF),
                "clear": Parameter(int, 0, minimum=0, maximum=0xFFFF),
            },
            lasting=True,
        ),
        FaultKind(
            "fingertips",
            "somebody sets another thickness of the fingertips, in m (RG)",
            {"offset": Parameter(float, minimum=-0.1, maximum=0.1)},
            lasting=True,
        ),
        FaultKind("deaf", "commands are acknowledged, and ignored", lasting=True),
        FaultKind("stuck_busy", "it stays busy, and does not move", lasting=True),
        FaultKind(
            "other_master",
            "another master sends it elsewhere, however it is",
            {"opening": _LENGTH},
        ),
    )
}


class FingerTool(Tool):
    """One gripper with fingers. Openings are in m between the fingertips."""

    kinds: Mapping[str, FaultKind] = {**tool.KINDS, **KINDS}

    def __init__(self, config: SimConfig) -> None:
        super().__init__(config)
        model = MODELS[config.model]
        assert isinstance(model.family, Registers)
        self._at = model.family
        self._model = model
        self._offset = config.offset
        self._lag = config.start_lag
        lower = model.range[0] if config.lower < 0.0 else config.lower
        upper = model.range[1] - 2.0 * config.offset if config.upper < 0.0 else config.upper
        self._range = lower, upper
        opening = upper - config.closed * (upper - lower)
        self.jaw = Jaw(opening, config.object_width, config.object_stiffness)
        self._faults: dict[str, Mapping[str, Any]] = {}
        self._latched = 0
        self._written = [0] * self._at.writes
        self.restart()

    @override
    def restart(self) -> None:
        self._goal: float | None = None
        self._starts_in = 0.0
        self._force = self._press = 0.0
        self.busy = self.grips = False
        pushed = self._pushed
        self._latched = (AT_POWER_ON if pushed else 0) | pushed << 1

    @property
    def _pushed(self) -> int:
        switch = self._faults.get("safety_switch")
        return PUSHED[switch["number"]] if switch else 0

    # ------------------------------------------------------------------------------- its registers

    @property
    @override
    def words(self) -> Mapping[int, int]:
        at, flags = self._at, self._faults.get("flags", {"set": 0, "clear": 0})
        bits = self.busy | self.grips << 1 | self._pushed | self._latched | at.calibrated
        bits |= 0x04 if at.calibrated and self.grips else 0
        opening = round(1e4 * self.jaw.opening)
        inner = round(1e4 * (self.jaw.opening + 2.0 * self._offset))
        lower, upper = (round(1e4 * value) for value in self._range)
        words = {at.flags: (bits | flags["set"]) & ~flags["clear"]}
        words |= dict.fromkeys(at.widths, opening) | dict.fromkeys(at.inner, inner)
        words |= dict(zip(at.ranges, (lower, upper, lower, upper), strict=False))
        if at.offset:
            offset = self._faults.get("fingertips", {"offset": self._offset})["offset"]
            words[at.offset] = round(1e4 * offset) & 0xFFFF
        if at.told_force:
            words[at.told_force] = round(self._force)
        return words

    @override
    def take(self, address: int, words: tuple[int, ...]) -> None:
        if address + len(words) > self._at.writes:
            raise Refused(ILLEGAL_ADDRESS)
        order_at = self._at.writes - 1
        self._written[address : address + len(words)] = words
        if not address <= order_at < address + len(words) or "deaf" in self._faults:
            return
        order = words[order_at - address]
        if order == self._at.stop:
            self._goal, self.busy = None, "stuck_busy" in self._faults
        elif order in self._at.starts and not self.busy and not self._latched:
            self._go(1e-4 * self._written[self._at.width])

    def _go(self, opening: float) -> None:
        self._goal = min(max(opening, self._range[0]), self._range[1])
        self._starts_in = self._lag
        self._press = min(
            self._written[self._at.force] * self._at.force_unit or self._model.force,
            self._model.force,
        )

    # ------------------------------------------------------------------------------ its mechanics

    @override
    def advance(self, seconds: float) -> None:
        if self._pushed and self.powered:
            self._latched |= self._pushed << 1
            self._goal, self.busy = None, False
        if "stuck_busy" in self._faults:
            self.busy = True
            return
        if not self.powered:
            return
        if self._goal is None:
            self.busy = False
        else:
            self._follow(self._goal, seconds)

    def _follow(self, goal: float, seconds: float) -> None:
        self._starts_in -= seconds
        if self._starts_in > 0.0:
            return
        if self.grips:
            self.jaw.slip(seconds)
        share = self._written[self._at.speed] / 100 if self._at.speed >= 0 else 1.0
        closes = -1.0 if goal < self.jaw.opening else 1.0
        met = self.jaw.follow(goal, self._model.speed * min(share, 1.0), self._press, seconds)
        self.grips, self.busy = met is Met.OBJECT, met is Met.NOTHING
        self._force = closes * self._press if self.grips else 0.0

    # --------------------------------------------------------------------------------- its faults

    @override
    def begin(self, fault: Fault) -> None:
        given = fault.parameters
        if self.jaw.begin(fault):
            return
        if fault.kind == "other_master":
            self._go(given["opening"])
        elif fault.kind in tool.KINDS:
            super().begin(fault)
        else:
            self._faults[fault.kind] = given

    @override
    def end(self, fault: Fault) -> None:
        if self.jaw.end(fault):
            return
        if fault.kind in tool.KINDS:
            super().end(fault)
        else:
            self._faults.pop(fault.kind, None)

    @override
    def status(self) -> dict[str, Any]:
        return {
            **super().status(),
            **self.jaw.status,
            "busy": self.busy,
            "moves": self.busy,
            "grips": self.grips,
            "latched": self._latched,
            "written": " ".join(map(str, self._written)),
        }

    @override
    def gauges(self) -> list[Gauges]:
        lower, upper = self._range
        force: Gauge = {
            "name": "force",
            "low": -self._model.force,
            "high": self._model.force,
            "value": self._force,
        }
        return [
            self.jaw.gauges(lower, upper),
            {"title": "Grip", "unit": "N", "rate": "", "digits": 0, "gauges": [force]},
        ]
