"""Tools of the simulated tracker that something else moves: where they were when, as its frames tell them."""

from __future__ import annotations

import math
import struct

import pytest

from crtk_sim_backends.faults import check_fault
from crtk_sim_backends.ndi import wire
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.ndi.families import FAMILIES
from crtk_sim_backends.ndi.injection import KINDS
from crtk_sim_backends.ndi.motion import MOTIONS, Place
from crtk_sim_backends.ndi.plugs import sensors_of
from crtk_sim_backends.ndi.track import Play, Track
from crtk_sim_backends.ndi.tracker import Tracker

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
HALF = math.sqrt(0.5)
BEGIN = 100.0
IN_VIEW = -1.5


class Lab:
    """A tracker with one wired tool that is tracked, at a time that a test chooses."""

    def __init__(self, latency: float = 0.0) -> None:
        self.now = BEGIN
        self.tracker = Tracker(
            FAMILIES["vega"],
            sensors_of("A"),
            MOTIONS["circle"],
            0.0,
            0,
            TrackerDefects(),
            lambda: self.now,
            lambda: round(self.now * 1e9),
            latency=latency,
        )
        for text in ("INIT:", "PHSR:02", "PINIT:01", "PENA:01D", "TSTART:80"):
            self.ask(text)

    def ask(self, text: str) -> bytes:
        data = text.encode()
        return self.tracker.obey(data + b"%04X" % wire.check(data))

    def put(self, at: float, x: float) -> None:
        self.tracker.put("A", round(1e9 * at), (x, 0.0, IN_VIEW), UPRIGHT)

    def frame(self) -> tuple[float, float]:
        """Return when the newest frame was taken, and where the tool was along x, in m."""
        body = self.ask("BX2:")[6:]
        number, seconds, rest = struct.unpack_from("<III", body, 4 + 12 + 4)
        (x,) = struct.unpack_from("<f", body, 4 + 12 + 16 + 4 + 12 + 4 + 16)
        assert number >= 0
        return seconds + 1e-9 * rest, 1e-3 * x


def test_a_tool_that_is_moved_leaves_its_path() -> None:
    lab = Lab()
    assert b"MISSING" not in lab.ask("TX:0001")
    lab.tracker.put("A", round(1e9 * BEGIN), (0.01, -0.02, IN_VIEW), (0.0, 0.0, HALF, HALF))
    assert lab.ask("TX:0001").startswith(b"0101+07071+00000+00000+07071+001000-002000-150000")


def test_a_frame_that_is_told_late_tells_where_the_tool_was_when_it_was_taken() -> None:
    lab = Lab(latency=0.05)
    for step in range(200):
        lab.now = BEGIN + 0.01 * step
        lab.put(lab.now, 0.1 * 0.01 * step)
        if step > 20 and step % 7 == 0:
            taken, x = lab.frame()
            assert -1e-6 < lab.now - taken - 0.05 < 1.0 / 60.0 + 1e-6
            assert x == pytest.approx(0.1 * (taken - BEGIN), abs=1e-6)


def test_without_latency_it_is_where_it_was_seen_last() -> None:
    lab = Lab()
    lab.put(BEGIN, 0.01)
    lab.put(BEGIN + 0.04, 0.02)
    lab.now = BEGIN + 0.06
    assert lab.frame() == pytest.approx((BEGIN + 0.05, 0.02), abs=1e-6)


def test_what_comes_late_changes_nothing_and_what_is_no_pose_is_refused() -> None:
    lab = Lab()
    lab.put(BEGIN, 0.01)
    lab.put(BEGIN - 1.0, 0.02)
    assert lab.frame()[1] == pytest.approx(0.01)
    for pose in (
        ((0.0, 0.0), UPRIGHT),
        ((0.0, 0.0, math.nan), UPRIGHT),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 2.0)),
    ):
        with pytest.raises(ValueError, match=r"is no pose|is not 1"):
            lab.tracker.put("A", 0, *pose)


@pytest.mark.parametrize(("x", "seen"), [(0.0, True), (0.8, False)])
def test_it_is_hidden_and_out_of_the_volume_as_any_other(x: float, seen: bool) -> None:
    lab = Lab()
    lab.put(BEGIN, x)
    assert (b"MISSING" not in lab.ask("TX:0001")) is seen
    lab.tracker.begin(check_fault(KINDS, "hide", {"tool": 0, "how": "missing"}, "test"))
    assert b"MISSING" in lab.ask("TX:0001")


def test_one_of_which_nothing_was_told_yet_is_missing() -> None:
    lab = Lab()
    lab.put(BEGIN + 10.0, 0.0)
    assert b"MISSING" in lab.ask("TX:0001")


def test_between_two_poses_it_turns_the_shorter_way() -> None:
    track = Track()
    track.put(0, Place(0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.1))
    track.put(10, Place(2.0, 0.0, 0.0, -HALF, 0.0, 0.0, -HALF, 0.1))
    assert track.at(-1) is None
    middle = track.at(5)
    assert middle is not None
    assert middle[:3] == (1.0, 0.0, 0.0)
    assert middle[3:7] == pytest.approx((math.cos(math.pi / 8), 0.0, 0.0, math.sin(math.pi / 8)))
    assert track.at(99) == Place(2.0, 0.0, 0.0, -HALF, 0.0, 0.0, -HALF, 0.1)


def test_a_marker_with_play_sits_otherwise_after_each_motion() -> None:
    play = Play(1.0, "A")
    here = Place(0.0, 0.0, -1500.0, 1.0, 0.0, 0.0, 0.0, 0.1)
    there = here._replace(x=50.0)
    first = play.at(here)
    assert 0.1 < math.dist(first[:3], here[:3]) < 5.0
    assert math.hypot(*first[3:7]) == pytest.approx(1.0)
    assert play.at(here._replace(x=1.0)).x == pytest.approx(first.x + 1.0)
    play.at(there)
    assert math.dist(play.at(here)[:3], first[:3]) > 0.1
    assert Play(0.0, "A").at(there) is there
