"""A pump with two channels: each builds up vacuum when a thing closes its cups, and leaks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.kit import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.cups import Cups
from crtk_sim_backends.kit.modbus import ILLEGAL_ADDRESS, Refused
from crtk_sim_backends.onrobot import tool
from crtk_sim_backends.onrobot.config import SimConfig
from crtk_sim_backends.onrobot.models import MODELS, Channels
from crtk_sim_backends.onrobot.tool import Tool
from crtk_sim_backends.page import Gauge, Gauges

RISE: Final = 0.25
"""Seconds in which the vacuum comes near its goal."""
FALL: Final = 0.05
PER_MILLE: Final = 101.325
"""Pa below the ambient pressure that a thousandth means."""
OPEN: Final = 30.0 * PER_MILLE
"""What a pump reaches with nothing at its cups, in Pa."""
NEAR: Final = 5.0 * PER_MILLE
"""By how much it may be more than what is asked for, in Pa."""
RELEASE, GRIP, IDLE = 0, 1, 2
_CHANNEL = Parameter(str, "all", choices=("a", "b", "all"))

KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        FaultKind("no_object", "nothing is at the cups", {"channel": _CHANNEL}, lasting=True),
        FaultKind(
            "leak",
            "a share of the vacuum is lost in a second",
            {"channel": _CHANNEL, "rate": Parameter(float, 2.0, minimum=0.0, maximum=100.0)},
            lasting=True,
        ),
        FaultKind(
            "other_master",
            "another master writes a channel's word",
            {
                "channel": Parameter(str, "a", choices=("a", "b")),
                "word": Parameter(int, 0, minimum=0),
            },
        ),
    )
}


class VacuumTool(Tool):
    """One vacuum gripper."""

    kinds: Mapping[str, FaultKind] = {**tool.KINDS, **KINDS}

    def __init__(self, config: SimConfig) -> None:
        super().__init__(config)
        family = MODELS[config.model].family
        assert isinstance(family, Channels)
        self._at = family
        self._leak = config.leak
        self._faults: dict[str, Mapping[str, Any]] = {}
        self.restart()

    @override
    def restart(self) -> None:
        self._written = [0, 0, 500]
        self._cups = {name: Cups(self._leak) for name in "ab"}

    @property
    @override
    def words(self) -> Mapping[int, int]:
        counts = (round(cups.vacuum / PER_MILLE) for cups in self._cups.values())
        told = dict(zip(self._at.vacuum, counts, strict=True))
        return {**dict(enumerate(self._written)), **told}

    @override
    def take(self, address: int, words: tuple[int, ...]) -> None:
        if address + len(words) > len(self._written):
            raise Refused(ILLEGAL_ADDRESS)
        self._written[address : address + len(words)] = words

    @override
    def advance(self, seconds: float) -> None:
        for index, (name, cups) in enumerate(self._cups.items()):
            mode, percent = divmod(self._written[index], 256)
            goal = 10.0 * PER_MILLE * min(percent, 80) if mode == GRIP and self.powered else 0.0
            if self._concerns("no_object", name):
                goal = min(goal, OPEN)
            added = self._faults["leak"]["rate"] if self._concerns("leak", name) else 0.0
            cups.leak = self._leak + added
            pumps = goal > cups.vacuum
            keeps = mode == IDLE and self.powered
            vents = not keeps and cups.vacuum > goal + NEAR
            vent, pump = (1.0 / FALL if vents else 0.0), (1.0 / RISE if pumps else 0.0)
            cups.flow(seconds, deepest=goal, pump=pump, vent=vent, is_open=1.0 / FALL)

    def _concerns(self, kind: str, name: str) -> bool:
        return kind in self._faults and self._faults[kind]["channel"] in (name, "all")

    @override
    def begin(self, fault: Fault) -> None:
        if fault.kind in tool.KINDS:
            super().begin(fault)
        elif fault.kind == "other_master":
            self._written["ab".index(fault.parameters["channel"])] = fault.parameters["word"]
        else:
            self._faults[fault.kind] = fault.parameters

    @override
    def end(self, fault: Fault) -> None:
        if fault.kind in tool.KINDS:
            super().end(fault)
        else:
            self._faults.pop(fault.kind, None)

    @override
    def status(self) -> dict[str, Any]:
        return {
            **super().status(),
            "vacuum": [cups.vacuum for cups in self._cups.values()],
            "written": self._written,
        }

    @override
    def gauges(self) -> list[Gauges]:
        gauges: list[Gauge] = [
            {
                "name": f"channel {name}",
                "low": 0.0,
                "high": 80.0,
                "value": 0.1 * cups.vacuum / PER_MILLE,
            }
            for name, cups in self._cups.items()
        ]
        return [{"title": "Vacuum", "unit": "%", "rate": "", "digits": 1, "gauges": gauges}]
