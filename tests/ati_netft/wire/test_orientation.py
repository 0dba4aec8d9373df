"""The weight of the tool with the orientation from an input or an arm, known, stale, invalid, or gone."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from crtk_driver_ati_netft import PLUGIN
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Severity
from crtk_drivers.errors import CommandRefused, ConfigError, DataTimeout, DeviceFault
from crtk_drivers.front import LocalDevice
from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_rotvec
from crtk_drivers.samples import Pose, vector
from crtk_drivers.session import Session
from rigs.netft_peer import Peer
from rigs.waiting import LONG, eventually

MASS = 2.0
UPRIGHT = [0, 0, 0, 0, 0, 0, 1]
SETTINGS = {
    "http": False,
    "profile": "netbox",
    "transport": "udp",
    "scale": {"counts_per_force": 1e6, "counts_per_torque": 1e6},
    "tool": {"mass": MASS},
    "sample_timeout": 2.0,
    "orientation_timeout": 1.0,
}


class Rig:
    """A sensor with a tool on it, and its driver."""

    def __init__(self, peer: Peer, **config: Any) -> None:
        self.peer = peer
        values = {**SETTINGS, "host": peer.host, "rdt_port": peer.port, **config}
        self.session = Session(PLUGIN, load(NetFtConfig, from_values(values)))
        self.front: Any = LocalDevice(self.session)
        self.device: Any = self.session.engine.device

    def hang(self, quaternion: Any) -> None:
        """Let the tool hang as it does with the sensor turned like that."""
        pull = matrix_from_quaternion(vector(quaternion)).T @ [0, 0, -9.80665 * MASS]
        self.peer.counts = (*(round(value * 1e6) for value in pull), 0, 0, 0)

    def until_weightless(self) -> None:
        def weightless() -> bool:
            found = self.session.engine.feedback("measured_cf")
            return bool(found and found[1].wall_ns and np.allclose(found[0].vector, 0.0, atol=1e-5))

        eventually(weightless, "the weight is taken off")

    def until_unavailable(self, why: str) -> None:
        """Wait until the load is marked as not known, while the measurements go on."""
        engine = self.session.engine

        def told() -> bool:
            notes = {note.key: note for note in self.front.health().notes}
            note = notes.get("compensation")
            return note is not None and note.severity is Severity.ERROR and why in note.text

        eventually(lambda: engine.feedback("measured_cf") is None, "measured_cf is not valid")
        eventually(told, f"why: {why}, not {self.front.health().notes}")
        eventually(lambda: np.isnan(self.device.newest(1)["wrench"]).all(), "full rate, too")
        assert self.front.raw.measured_cf(age=0.5, wait=LONG).force.any()
        assert self.front.health().device["compensated"] == 0.0


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as peer:
        peer.rate = 1000.0
        yield peer


@pytest.fixture
def make(peer) -> Iterator[Callable[..., Rig]]:
    rigs: list[Rig] = []

    def build(**config: Any) -> Rig:
        rigs.append(Rig(peer, **config))
        rigs[-1].hang((0, 0, 0, 1))
        rigs[-1].session.start()
        eventually(lambda: rigs[-1].session.engine.has_sample, "connected")
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.front.close()


class Carrier:
    """An arm of somebody else, with what CRTK asks of its pose."""

    def __init__(self) -> None:
        self.quaternion: Any = (0, 0, 0, 1)
        self.valid = True
        self.stands = False
        self.error: Exception | None = None
        self._stamp = 1.0

    def measured_cp(self, age: float, wait: float, extra: bool) -> tuple[Pose, float]:
        assert (age, wait, extra) == (0.0, 0.0, True)
        if self.error is not None:
            raise self.error
        if not self.stands:
            self._stamp += 0.002
        pose = Pose(vector([0, 0, 0]), vector(self.quaternion))
        return pose, self._stamp if self.valid else 0.0


# ------------------------------------------------------------------------------------------------ the input


def test_without_an_orientation_no_load_is_known(make) -> None:
    rig = make()
    rig.until_unavailable("no new pose came")
    with pytest.raises(CommandRefused, match=r"bias.*orientation of the sensor is not known"):
        rig.front.bias()
    assert not rig.device.bias.any()


def test_an_orientation_that_is_not_renewed_counts_no_more(make) -> None:
    rig = make()
    rig.front.orientation(UPRIGHT)
    rig.until_weightless()
    rig.until_unavailable("no new pose came for 1 s")
    rig.front.orientation(UPRIGHT)
    rig.until_weightless()


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (0, 0, 0, 1.1), (0, 0, 0, np.nan)])
def test_what_is_no_rotation_is_refused_and_changes_nothing(make, quaternion) -> None:
    rig = make(orientation_timeout=LONG)
    rig.front.orientation(UPRIGHT)
    rig.until_weightless()
    with pytest.raises(CommandRefused, match="orientation"):
        rig.front.orientation([0, 0, 0, *quaternion])
    assert np.isfinite(rig.device.newest(1)["wrench"]).all()


def test_no_tool_and_a_tool_without_mass_need_no_orientation(make) -> None:
    for tool in (None, {"mass": 0.0}):
        rig = make(tool=tool)
        assert rig.front.measured_cf(wait=LONG).force == pytest.approx([0, 0, -9.80665 * MASS])
        assert rig.front.health().device["compensated"] == 1.0
        rig.front.close()


# -------------------------------------------------------------------------------------------------- the arm


def test_an_arm_in_this_process_gives_the_orientation(make) -> None:
    rig = make(mounting=[0, 0, np.pi / 2])
    with crtk_drivers.connect("virtual", rate=100.0) as arm:
        flange = quaternion_from_rotvec(vector([0, 0, np.pi / 2]))
        pose = arm.measured_cp()
        turned = matrix_from_quaternion(pose.orientation) @ matrix_from_quaternion(flange)
        pull = turned.T @ [0, 0, -9.80665 * MASS]
        rig.peer.counts = (*(round(value * 1e6) for value in pull), 0, 0, 0)
        rig.device.follow(arm)
        rig.until_weightless()
    rig.until_unavailable("not valid")
    rig.device.follow(None)
    rig.until_unavailable("no new pose came")


def test_the_weight_turns_with_the_arm(make) -> None:
    rig, arm = make(), Carrier()
    rig.device.follow(arm)
    rig.until_weightless()
    half = np.sqrt(0.5)
    for quaternion in [(half, 0, 0, half), (0, half, 0, half), (1, 0, 0, 0)]:
        arm.quaternion = quaternion
        rig.hang(quaternion)
        rig.until_weightless()


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"valid": False}, "the arm says that its pose is not valid"),
        ({"stands": True}, "no new pose came for 1 s"),
        ({"error": DataTimeout("no value yet")}, "no value yet"),
        ({"error": DeviceFault("it is broken")}, "it is broken"),
        ({"error": KeyError("a bug")}, "a bug"),
        ({"quaternion": (0, 0, 0, 0)}, "a quaternion of length 0"),
    ],
)
def test_an_arm_without_a_good_pose_makes_the_load_unknown_until_it_has_one(
    make, change, why
) -> None:
    rig, arm = make(), Carrier()
    rig.device.follow(arm)
    rig.until_weightless()
    before = {name: getattr(arm, name) for name in change}
    vars(arm).update(change)
    rig.until_unavailable(why)
    with pytest.raises(CommandRefused, match="calibration_add.*" + why):
        rig.front.calibration_add()
    vars(arm).update(before)
    rig.until_weightless()


def test_an_arm_is_followed_again_after_the_sensor_was_away(make) -> None:
    rig, arm = make(sample_timeout=0.3), Carrier()
    rig.device.follow(arm)
    rig.until_weightless()
    rig.peer.rate = 0.0
    eventually(lambda: not rig.session.engine.connected, "disconnected")
    rig.peer.rate = 1000.0
    eventually(lambda: rig.session.engine.connected, "connected")
    rig.until_weightless()


@pytest.mark.sweep(3)
@pytest.mark.parametrize("folder", ["", "drawn", "missing"])
def test_a_calibration_with_an_arm_needs_no_other_orientation(make, tmp_path, folder) -> None:
    (tmp_path / "drawn").mkdir()
    recordings = str(tmp_path / folder) if folder else ""
    rig, arm = make(tool=None, recordings=recordings), Carrier()
    rig.device.follow(arm)
    for rotvec in [(0, 0, 0), (1.5, 0, 0), (0, 1.5, 0), (3, 0, 0)]:
        arm.quaternion = quaternion_from_rotvec(vector(rotvec))
        rig.hang(arm.quaternion)
        raw = np.array(rig.peer.counts) * 1e-6
        measured = rig.front.raw.measured_cf
        eventually(lambda: np.allclose(measured().vector, raw), "the load")  # noqa: B023
        turned = matrix_from_quaternion(arm.quaternion)

        def followed() -> bool:
            known = rig.device.pipeline.rotation
            return known is not None and np.allclose(known, turned)  # noqa: B023

        eventually(followed, "the orientation")
        rig.front.calibration_add()
    told = rig.front.calibration_finish()
    assert "mass 2.0000 kg" in told
    assert re.search(r"in each pose \S+, \S+, \S+, \S+ N", told)
    rig.until_weightless()
    pictures = list((tmp_path / "drawn").glob("netft-*.svg"))
    assert len(pictures) == (folder == "drawn")
    if folder == "drawn":
        assert str(pictures[0]) in told
        drawn = ElementTree.fromstring(pictures[0].read_text())
        assert len(drawn.findall(".//{*}rect")) == 1 + 4 * 6
    assert ("No picture" in told) == (folder == "missing")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"arm": "ur5"}, "does not begin with '/'"),
        ({"arm": "/ur5", "orientation": [0, 0, 0]}, "fixed orientation"),
    ],
)
def test_an_arm_that_cannot_be_is_refused(values, message) -> None:
    with pytest.raises(ConfigError, match=message):
        load(NetFtConfig, from_values({"host": "127.0.0.1", **values}))
