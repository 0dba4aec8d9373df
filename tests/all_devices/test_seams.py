"""Where the counter of an axis ends: joints beside it stay in their range, one that went beyond is refused.

Positions of these drives are numbers of 32 bits that begin anew at the other end. Each range here ends beside
that place. Judged by where the simulated motors really are, turns included.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import yaml
from typing_extensions import override

from bench.reliability.rig import PATIENCE, Rig
from bench.reliability.rig_canopen import VALUES as CANOPEN
from bench.reliability.rig_canopen import CanopenRig
from bench.reliability.rig_copley import CopleyRig
from bench.reliability.rig_galil import GalilRig
from bench.reliability.table import REST
from crtk_driver_copley.plugin import TYPICAL as COPLEY
from crtk_driver_galil.plugin import TYPICAL as GALIL

ROOM = 0.5
"""Turns of a joint from where it is at 0 to the end of its counter."""
BEYOND = 0.55
"""Turns from where it is at 0 to where it is beyond that."""
ENDS = {"upper": 1, "lower": -1}


class _SeamRig(Rig):
    """A rig whose range ends beside that end (1, -1); its joints begin so many turns nearer to it than 0."""

    turn: ClassVar[float] = 100_000.0
    """Counts for a turn of a joint."""

    def __init__(self, folder: Path, end: int, nearer: float = 0.0) -> None:
        super().__init__()
        self.folder = folder
        self.middle = end * (2**31 - ROOM * self.turn)
        offset = -2.0 * math.pi * self.middle / self.turn
        joints = {name: {**joint, "offset": offset} for name, joint in self.typical.items()}
        self.values = {**self.values, "joints": joints}  # type: ignore[misc]
        self.sim_options = self.options(self.middle + end * nearer * self.turn)  # type: ignore[misc]
        self.activities = (REST,)  # type: ignore[misc]
        self._unwatched = bool(nearer)

    @property
    def typical(self) -> dict[str, Any]:
        """Its joints."""
        return TYPICAL[type(self)]

    def options(self, start: float) -> dict[str, Any]:
        """Return those of a simulator whose motors begin at so many counts."""
        return {"start": int(start), "travel": 2**32}

    def counted(self) -> list[float]:
        """Return where the motors really are, in counts, turns included."""
        assert self.sim is not None
        return list(self.sim.control.status()["position"][:3])

    @override
    def joints(self) -> np.ndarray:
        return (np.array(self.counted()) - self.middle) * 2.0 * math.pi / self.turn


class _GalilSeam(_SeamRig, GalilRig):
    pass


class _CopleySeam(_SeamRig, CopleyRig):
    pass


class _CanopenSeam(_SeamRig, CanopenRig):
    """Encoders behind a gear, which count to the end of 32 bits in four turns of the joint."""

    turn = 1e9

    @override
    def options(self, start: float) -> dict[str, Any]:
        turns = start / self.turn
        motor = {"start": turns, "stops": [turns - 10.0, turns + 10.0]}
        motor |= {"negative_limit": turns - 9.0, "positive_limit": turns + 9.0}
        drives = self.folder / "drives.yaml"
        drives.write_text(yaml.safe_dump({node: {"motors": [motor]} for node in (1, 2, 3)}))
        return {**CanopenRig.sim_options, "drives": str(drives), "from_eds": str(self._eds())}

    def _eds(self) -> Path:
        """Return the EDS of a drive with so many units."""
        path = self.folder / "drive.eds"
        with CanopenRig.simulator.spawn(nodes=1, eds=str(path)):
            text = path.read_text()
        wanted = {"608Fsub1": self.turn, "6092sub1": self.turn}
        wanted |= dict.fromkeys(("6065", "607F"), 2**32 - 1)
        for key, value in wanted.items():
            default = re.compile(rf"(\[{key}\][^\[]*?DefaultValue=)\w+")
            text = default.sub(rf"\g<1>{value:.0f}", text)
        path.write_text(text)
        return path

    @override
    def counted(self) -> list[float]:
        return [turns * self.turn for turns in self._told("revolutions")]


TYPICAL: dict[type[_SeamRig], dict[str, Any]] = {
    _GalilSeam: GALIL["joints"],
    _CopleySeam: COPLEY["joints"],
    _CanopenSeam: {
        name: {key: value for key, value in joint.items() if key != "homing"} | {"gear": 1.0}
        for name, joint in CANOPEN["joints"].items()
    },
}


@pytest.fixture(params=ENDS)
def end(request: pytest.FixtureRequest) -> int:
    return ENDS[request.param]


@pytest.fixture(params=TYPICAL, ids=lambda rig: rig.name)
def rig(request: pytest.FixtureRequest) -> type[_SeamRig]:
    return request.param


def _stays(rig: Rig, place: float) -> None:
    rig.run(0.2)
    assert np.abs(rig.until_still() - place).max() < rig.tolerance


def test_beside_the_seam_a_joint_stays_in_range(
    rig: type[_SeamRig], end: int, tmp_path: Path
) -> None:
    with rig(tmp_path, end) as opened:
        opened.enable()
        _stays(opened, 0.0)
        limit = opened.engine.capabilities.limits[0]
        last = limit.upper if end > 0 else limit.lower
        move = opened.arm.move_jp(np.full(3, 0.99 * last))
        opened.until(lambda: not move.is_busy(), PATIENCE, "the move ends")
        move.wait(0.0)
        _stays(opened, 0.99 * last)
        for command in ("pause", "resume", "disable", "enable"):
            opened.engine.state_command(command)
            opened.until(lambda: opened.engine.transition_ended, PATIENCE, f"{command} ends")
            _stays(opened, 0.99 * last)
        for _ in range(50):  # which goes as far as the range allows, and no count further
            opened.arm.servo_jv(np.full(3, float(end)))
            opened.step()
        assert np.abs(opened.until_still()).max() <= abs(last) + opened.tolerance
        opened.arm.hold()


def test_a_joint_beyond_the_seam_is_not_enabled(
    rig: type[_SeamRig], end: int, tmp_path: Path
) -> None:
    with rig(tmp_path, end, BEYOND) as opened:
        opened.engine.state_command("enable")
        opened.until(lambda: opened.engine.transition_ended, PATIENCE, "enable ends")
        told = [opened.status.detail, *map(str, opened.log.refused)]
        assert opened.status.state != "ENABLED"
        assert any(
            "joint_" in text and "no joint of its range can stand" in text for text in told
        ), told
        _stays(opened, 2.0 * math.pi * BEYOND * end)
