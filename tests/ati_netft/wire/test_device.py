"""The sensor as a CRTK device, over real datagrams: states, bias, tool, and what goes wrong."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from crtk_driver_ati_netft import PLUGIN, services
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.services import SensorBias
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Severity
from crtk_drivers.engine import Observer
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.geometry.quaternions import matrix_from_quaternion, quaternion_from_rotvec
from crtk_drivers.samples import Wrench, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from rigs.netft_peer import Peer, record
from rigs.waiting import LONG, eventually

SCALE = {"counts_per_force": 1e6, "counts_per_torque": 1e6}


class Log(Observer):
    """Every status that the driver announced."""

    def __init__(self) -> None:
        self.statuses: list[Status] = []

    def status_changed(self, status, stamp) -> None:
        self.statuses.append(status)


class Rig:
    """A sensor and its driver."""

    def __init__(self, peer: Peer, **config: Any) -> None:
        self.peer = peer
        values = {**self.values(peer), **config}
        self.session = Session(PLUGIN, load(NetFtConfig, from_values(values)))
        self.front: Any = LocalDevice(self.session)
        self.log = Log()
        self.session.engine.add_observer(self.log)
        device = self.session.engine.device
        assert isinstance(device, NetFtDevice)
        self.device = device

    @staticmethod
    def values(peer: Peer) -> dict[str, Any]:
        return {
            "host": peer.host,
            "rdt_port": peer.port,
            "http": False,
            "transport": "udp",
            "profile": "netbox",
            "scale": SCALE,
            "rate": 100.0,
            "sample_timeout": 1.5,
            "orientation_timeout": LONG,
        }

    def start(self) -> None:
        self.session.start()
        self.connected()

    def connected(self) -> None:
        engine = self.session.engine
        eventually(lambda: engine.connected and engine.has_sample, "connected")

    def state(self, state: OperatingState, detail: str = "") -> None:
        def reached() -> bool:
            status = self.session.engine.status
            return status.state is state and detail in status.detail

        eventually(reached, f"{state} ({detail}), not {self.session.engine.status}")

    def was(self, state: OperatingState, detail: str = "") -> None:
        """Wait until a state has been announced, for however short a time."""

        def announced() -> bool:
            return any(s.state is state and detail in s.detail for s in list(self.log.statuses))

        eventually(announced, f"{state} ({detail})")

    def load(self) -> np.ndarray:
        return np.asarray(self.front.measured_cf(age=0.05, wait=LONG).vector)

    def until_load(self, wanted: list[float], tolerance: float = 1e-9) -> None:
        eventually(lambda: np.allclose(self.load(), wanted, atol=tolerance), f"{wanted}")

    def note(self, key: str) -> tuple[Severity, str] | None:
        for note in self.front.health().notes:
            if note.key == key:
                return note.severity, note.text
        return None

    def lose_stream(self, is_noticed: Callable[[], bool]) -> None:
        """Have another client take the stream until that is noticed.

        A stream that comes late when it is asked for again may have been away, and is not told.
        """

        def lost() -> bool:
            received = self.front.health().device["received"]
            self.peer.steal()
            eventually(lambda: self.front.health().device["received"] > received + 10, "it is back")
            return is_noticed()

        eventually(lost, "noticed")

    def put(self, *values: float) -> None:
        self.peer.counts = tuple(round(value * 1e6) for value in values)

    def set_load(self, *values: float) -> None:
        """Put a load on, and wait until it is measured."""
        self.put(*values)
        raw = np.array(self.peer.counts) * 1e-6

        def measured() -> bool:
            value, _ = self.session.engine.feedback("raw/measured_cf")
            return bool(np.allclose(value.vector, raw, atol=1e-9))

        eventually(measured, f"raw {raw}")


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
        rigs[-1].start()
        return rigs[-1]

    yield build
    for rig in rigs:
        rig.front.close()


@pytest.fixture
def rig(make) -> Rig:
    return make()


@pytest.fixture(autouse=True)
def _short_averages(monkeypatch) -> None:
    for name in ("AVERAGED", "CHECKED", "POSE"):
        monkeypatch.setattr(services, name, 0.05)


# --------------------------------------------------------------------------------------------- states


def test_it_offers_a_wrench_and_nothing_that_moves(rig) -> None:
    names = set(rig.front.crtk_commands)
    assert names == {"measured_cf", "raw/measured_cf", "operating_state", "state_command"}


def test_it_measures_without_being_enabled(rig) -> None:
    rig.set_load(1, -2, 3, 0.1, -0.2, 0.3)
    rig.until_load([1, -2, 3, 0.1, -0.2, 0.3])
    assert rig.session.engine.status.state is OperatingState.DISABLED
    value = rig.front.raw.measured_cf()
    assert value.frame_id == "ft_sensor"
    assert value.vector == pytest.approx([1, -2, 3, 0.1, -0.2, 0.3])


def test_it_goes_through_all_states_and_measures_in_each(rig) -> None:
    rig.set_load(1, 0, 0, 0, 0, 0)
    for command, state in [
        ("enable", OperatingState.ENABLED),
        ("home", OperatingState.ENABLED),
        ("pause", OperatingState.PAUSED),
        ("resume", OperatingState.ENABLED),
        ("disable", OperatingState.DISABLED),
    ]:
        rig.front.state_command(command)
        status = rig.front.operating_state()
        assert (status.state, status.is_homed, status.is_busy) == (state, True, False)
        rig.until_load([1, 0, 0, 0, 0, 0])


def test_closing_stops_the_stream(make, peer) -> None:
    make().front.close()
    peer.wait_for(0)


@pytest.mark.parametrize("status", [0xC0000000, 0x80000004])
def test_an_error_of_the_sensor_is_a_fault_and_its_data_invalid(rig, peer, status) -> None:
    rig.front.enable()
    peer.status = status
    rig.state(OperatingState.FAULT, "status 0x")
    eventually(lambda: rig.session.engine.feedback("measured_cf")[1].wall_ns == 0, "invalid")
    with pytest.raises(TransitionFailed, match="status 0x"):
        rig.front.enable()
    severity, text = rig.note("status")
    assert severity is Severity.ERROR
    assert f"0x{status:08x}" in text
    peer.status = 0
    eventually(lambda: rig.note("status") is None, "over")
    rig.front.enable()
    eventually(lambda: rig.session.engine.feedback("measured_cf")[1].wall_ns > 0, "valid")
    assert rig.front.health().reconnects == 0


def test_a_notice_stops_nothing(rig, peer) -> None:
    rig.front.enable()
    peer.status = 0x80010000
    eventually(lambda: rig.note("notice"), "told")
    rig.set_load(2, 0, 0, 0, 0, 0)
    rig.until_load([2, 0, 0, 0, 0, 0])
    assert rig.note("notice") == (Severity.INFO, "monitor condition latched")
    assert rig.front.is_enabled()


@pytest.mark.parametrize(
    ("choice", "valid", "state"),
    [
        ("flag", True, OperatingState.ENABLED),
        ("invalid", False, OperatingState.ENABLED),
        ("fault", False, OperatingState.FAULT),
    ],
)
def test_saturation_is_published_and_flagged(make, peer, choice, valid, state) -> None:
    rig = make(on_saturation=choice)
    rig.front.enable()
    peer.status = 0x80020000
    rig.set_load(500, 0, 0, 0, 0, 0)
    eventually(lambda: rig.note("saturation"), "told")
    rig.state(state)

    def published() -> bool:
        value, stamp = rig.session.engine.feedback("measured_cf")
        return bool(value.force[0] == 500.0 and (stamp.wall_ns != 0) == valid)

    eventually(published, "published")
    assert rig.note("saturation") == (Severity.ERROR, "transducer saturated, or A/D error")
    assert rig.front.health().device["saturated_records"] > 0
    assert rig.front.health().reconnects == 0


def test_a_value_is_invalid_whenever_in_its_window_the_sensor_was_saturated(peer) -> None:
    peer.rate = 0.0
    values = {**Rig.values(peer), "on_saturation": "invalid"}
    device = NetFtDevice(load(NetFtConfig, from_values(values)))
    sent = 0

    def send(status: int = 0) -> None:
        nonlocal sent
        sent += 1
        peer.send(record(sent, 1000 + 7 * sent, status))

    def begin(_: int) -> None:
        peer.on_start = None  # requests that repeat it change nothing
        send()

    peer.on_start = begin
    device.open(time.monotonic() + LONG)
    try:
        for _ in range(2):
            send()
        while device.read(time.monotonic() + 0.1):
            pass
        for _ in range(3):
            send(0x80020000)
        sample = device.read(time.monotonic() + 0.1)
        while sample is None:
            send()
            sample = device.read(time.monotonic() + 0.05)
        assert sample.stamp.wall_ns == 0
    finally:
        device.close()


def test_a_frozen_transducer_is_a_fault(rig, peer) -> None:
    rig.front.enable()
    peer.frozen = True
    rig.state(OperatingState.FAULT, "frozen")
    for _ in range(20):
        before = rig.front.health().samples
        eventually(lambda before=before: rig.front.health().samples > before, "samples go on")
        assert rig.session.engine.feedback("measured_cf")[1].wall_ns == 0
    assert rig.front.health().reconnects == 0
    peer.frozen = False
    eventually(lambda: not rig.device.source.frozen, "thawed")
    eventually(lambda: rig.session.engine.connected, "connected")
    rig.front.enable()


# ------------------------------------------------------------------------------------- lost and found


def test_a_sensor_that_is_silent_is_a_fault_and_comes_back(rig, peer) -> None:
    rig.front.enable()
    peer.rate = 0.0
    rig.was(OperatingState.FAULT, "s old")
    peer.rate = 1000.0
    rig.state(OperatingState.DISABLED)
    rig.connected()
    assert rig.device.sensor_bias is SensorBias.UNKNOWN
    assert rig.note("bias")[0] is Severity.WARNING
    assert rig.front.health().reconnects == 1
    rig.front.enable()


def test_a_sensor_that_was_restarted_is_read_anew_and_its_bias_unknown(rig, peer) -> None:
    eventually(lambda: rig.front.health().device["received"] > 300, "runs")
    rig.front.enable()
    peer.reboot()
    rig.was(OperatingState.FAULT, "restarted")
    rig.state(OperatingState.DISABLED)
    rig.connected()
    assert rig.device.sensor_bias is SensorBias.UNKNOWN
    assert rig.front.health().device["restarts"] == 1
    assert "unknown" in rig.note("bias")[1]
    rig.front.enable()
    rig.front.bias()
    assert rig.note("bias")[0] is Severity.INFO


def test_a_stream_that_another_client_took_is_taken_back(rig) -> None:
    rig.front.enable()
    rig.lose_stream(lambda: rig.front.health().device["takeovers"] == 1)
    assert rig.front.is_enabled()
    assert "another client" in rig.note("bias")[1]
    assert rig.front.health().reconnects == 0


def test_a_slow_stream_is_not_asked_for_again_between_its_records(make, peer) -> None:
    peer.rate, peer.tick_rate = 5.0, 1000.0
    rig = make(profile="onrobot", scale=None, rate=10.0, sensor={"rdt_rate": 5}, sample_timeout=5.0)

    def received() -> float:
        return rig.front.health().device["received"]

    peer.wait_for(0x82)
    begun = received()
    eventually(lambda: received() > begun + 1, "records")
    asked = len(peer.requests)
    eventually(lambda: received() > begun + 5, "more of them")
    assert len(peer.requests) == asked


def test_opening_can_be_ended(peer) -> None:
    peer.rate = 0.0
    rig = Rig(peer, open_timeout=60.0)
    rig.session.start()
    peer.wait_for(2)
    rig.front.close()


# ----------------------------------------------------------------------------------------------- bias


def test_the_bias_is_ours_to_set_read_and_remove(rig) -> None:
    rig.set_load(5, -1, 2, 0.3, 0, -0.1)
    rig.until_load([5, -1, 2, 0.3, 0, -0.1])
    assert "software bias [5, -1, 2] N, [0.3, 0, -0.1] N·m" in rig.front.bias()
    rig.until_load([0] * 6)
    assert rig.front.raw.measured_cf().vector == pytest.approx([5, -1, 2, 0.3, 0, -0.1])
    assert rig.device.bias == pytest.approx([5, -1, 2, 0.3, 0, -0.1])
    assert "[5, -1, 2] N" in rig.front.get_bias()
    assert rig.front.health().device["bias_fz"] == pytest.approx(2.0)
    rig.front.unbias()
    rig.until_load([5, -1, 2, 0.3, 0, -0.1])
    rig.front.set_bias([1, 0, 0, 0, 0, 0])
    rig.until_load([4, -1, 2, 0.3, 0, -0.1])


def test_the_bias_of_the_configuration_counts_from_the_start(make) -> None:
    rig = make(bias=[1, 2, 3, 4, 5, 6])
    rig.until_load([-1, -2, -3, -4, -5, -6])


def test_no_bias_is_set_by_itself(rig, peer) -> None:
    rig.set_load(5, 0, 0, 0, 0, 0)
    rig.front.enable()
    rig.until_load([5, 0, 0, 0, 0, 0])
    assert 0x42 not in [command for command, _ in peer.requests]


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ([np.nan, 0, 0, 0, 0, 0], "not_finite"),
        (Wrench(vector([0, 0, 0]), vector([0, 0, 0]), "elsewhere"), "wrong_frame"),
        ([1, 2, 3], "wrong_"),
    ],
)
def test_a_bias_that_is_none_is_refused(rig, value, reason) -> None:
    with pytest.raises(CommandRefused) as caught:
        rig.front.set_bias(value)
    assert reason in caught.value.reason
    assert rig.device.bias == pytest.approx([0] * 6)


def test_a_load_that_moves_is_no_bias(rig, peer, monkeypatch) -> None:
    for name in ("AVERAGED", "CHECKED"):
        monkeypatch.setattr(services, name, 0.5)
    rig.front.set_bias([7, 0, 0, 0, 0, 0])
    peer.drift = 50_000
    with pytest.raises(TransitionFailed, match="load changed"):
        rig.front.bias()
    assert rig.device.bias == pytest.approx([7, 0, 0, 0, 0, 0])


def test_a_load_that_cannot_be_measured_is_no_bias(rig, peer) -> None:
    peer.status = 0x80020000
    eventually(lambda: rig.note("saturation"), "saturated")
    with pytest.raises(TransitionFailed, match="saturated"):
        rig.front.bias()


def test_a_bias_whose_check_fails_is_what_it_was(rig, peer, monkeypatch) -> None:
    monkeypatch.setattr(services, "CHECKED", 20.0)
    rig.front.set_bias([7, 0, 0, 0, 0, 0])
    request = rig.session.engine.request("bias")
    eventually(lambda: rig.device.bias[0] != 7.0, "it is checked")
    peer.status = 0x80020000
    with pytest.raises(TransitionFailed, match="saturated"):
        request.wait(LONG)
    assert rig.device.bias == pytest.approx([7, 0, 0, 0, 0, 0])


def test_a_bias_that_is_set_while_another_is_checked_stays(rig, peer, monkeypatch) -> None:
    monkeypatch.setattr(services, "CHECKED", 20.0)
    rig.front.set_bias([7, 0, 0, 0, 0, 0])
    request = rig.session.engine.request("bias")
    eventually(lambda: rig.device.bias[0] != 7.0, "it is checked")
    rig.front.set_bias([3, 0, 0, 0, 0, 0])
    peer.status = 0x80020000
    with pytest.raises(TransitionFailed, match="saturated"):
        request.wait(LONG)
    assert rig.device.bias == pytest.approx([3, 0, 0, 0, 0, 0])


def test_the_sensor_can_be_biased_itself(rig, peer) -> None:
    rig.set_load(5, 0, 0, 0, 0, 0)
    rig.front.set_bias([1, 1, 1, 1, 1, 1])
    peer.on_start = lambda _: peer.was_asked(0x42) and rig.put(0, 0, 0, 0, 0, 0)
    peer.late = 0.2  # what it measures meanwhile tells nothing of it
    assert "bias set in the sensor" in rig.front.sensor_bias()
    assert [command for command, _ in peer.requests if command != 2] == [0x42]
    assert rig.device.sensor_bias is SensorBias.SET
    rig.until_load([0] * 6)
    assert rig.device.bias == pytest.approx([0] * 6)


def test_a_sensor_that_does_not_do_it_is_found_out(rig, peer) -> None:
    rig.set_load(5, 0, 0, 0, 0, 0)
    rig.until_load([5, 0, 0, 0, 0, 0])
    with pytest.raises(TransitionFailed, match="after its bias was set"):
        rig.front.sensor_bias()
    assert rig.device.sensor_bias is SensorBias.UNKNOWN


def test_after_one_that_is_broken_off_what_the_sensor_subtracts_is_not_known(rig, peer) -> None:
    rig.front.set_bias([1, 1, 1, 1, 1, 1])
    peer.status = 0x80020000
    with pytest.raises(TransitionFailed, match="saturated"):
        rig.front.sensor_bias()
    assert rig.device.sensor_bias is SensorBias.UNKNOWN
    assert "was not finished" in rig.note("bias")[1]
    assert rig.device.bias == pytest.approx([1] * 6)


def test_removing_it_takes_the_web_page(rig) -> None:
    with pytest.raises(CommandRefused, match="web page"):
        rig.front.sensor_unbias()


def test_an_onrobot_sensor_is_biased_and_unbiased_over_rdt(make, peer) -> None:
    rig = make(profile="onrobot", scale=None, sensor={"rdt_rate": 500, "filter_code": 3})
    peer.wait_for(0x81)
    peer.wait_for(0x82)
    assert {(0x81, 3), (0x82, 2)} <= set(peer.requests)
    rig.front.sensor_bias()
    rig.front.sensor_unbias()
    assert [count for command, count in peer.requests if command == 0x42] == [255, 0]
    rig.peer.counts = (10000, 0, 0, 100000, 0, 0)
    rig.until_load([1, 0, 0, 1, 0, 0])
    with pytest.raises(CommandRefused, match="no request"):
        rig.front.clear_latch()


def test_the_latch_is_cleared(rig, peer) -> None:
    peer.status = 0x80010000
    eventually(lambda: rig.note("notice"), "latched")
    peer.on_start = lambda _: peer.was_asked(0x41) and setattr(peer, "status", 0)
    peer.late = 0.2  # what it measures meanwhile tells nothing of it
    assert rig.front.clear_latch() == "cleared"
    assert peer.was_asked(0x41)


# ----------------------------------------------------------------------------------- tool and frames


def test_the_weight_of_a_tool_is_taken_off_when_the_orientation_is_known(make) -> None:
    rig = make(tool={"mass": 2.0, "center_of_mass": [0, 0, 0.1]})
    rig.set_load(0, 0, -19.6133, 0, 0, 0)
    rig.front.orientation([0, 0, 0, 0, 0, 0, 1])
    rig.until_load([0] * 6, 1e-5)
    half = np.sqrt(0.5)
    rig.front.orientation(
        [0, 0, 0, half, 0, 0, half]
    )  # turned about x: its z along -y of the world
    rig.until_load([0, 19.6133, -19.6133, -1.96133, 0, 0], 1e-5)


def test_the_orientation_may_be_that_of_what_it_is_mounted_on(make) -> None:
    rig = make(tool={"mass": 1.0}, mounting=[np.pi, 0, 0])
    rig.set_load(0, 0, 9.80665, 0, 0, 0)
    rig.front.orientation([0, 0, 0, 0, 0, 0, 1])
    rig.until_load([0] * 6, 1e-5)


def test_a_sensor_that_is_not_moved_needs_no_input(make) -> None:
    rig = make(tool={"mass": 1.0}, orientation=[np.pi, 0, 0])
    rig.set_load(0, 0, 9.80665, 0, 0, 0)
    rig.until_load([0] * 6, 1e-5)
    assert rig.note("compensation") is None
    assert not hasattr(rig.front, "orientation")


def test_a_bias_with_a_tool_leaves_the_weight_to_the_compensation(make) -> None:
    rig = make(tool={"mass": 1.0})
    rig.front.orientation([0, 0, 0, 0, 0, 0, 1])
    rig.set_load(3, 0, -9.80665, 0, 0, 0)
    rig.until_load([3, 0, 0, 0, 0, 0], 1e-5)
    rig.front.bias()
    assert rig.device.bias == pytest.approx([3, 0, 0, 0, 0, 0], abs=1e-5)


def test_the_moment_is_about_the_point_and_in_the_axes_that_are_configured(make) -> None:
    rig = make(measuring_frame_id="tip", point=[0, 0, 0.1], rotation=[0, 0, np.pi / 2])
    rig.set_load(5, 0, 0, 0, 0, 0)
    rig.until_load([0, -5, 0, -0.5, 0, 0], 1e-9)
    assert rig.front.measured_cf().frame_id == "tip"
    assert rig.front.raw.measured_cf().frame_id == "ft_sensor"
    assert rig.front.raw.measured_cf().vector == pytest.approx([5, 0, 0, 0, 0, 0])


def test_a_calibration_finds_tool_and_bias(rig) -> None:
    mass, center, bias = 0.8, np.array([0.01, -0.02, 0.06]), np.array([1, -2, 3, 0.1, 0.2, -0.3])
    for rotvec in [(0, 0, 0), (1.5, 0, 0), (0, 1.5, 0), (3, 0, 0), (-1.5, 0.4, 0), (0.3, -1.5, 1)]:
        quaternion = quaternion_from_rotvec(vector(rotvec))
        pull = matrix_from_quaternion(quaternion).T @ [0, 0, -9.80665 * mass]
        rig.set_load(*(np.concatenate((pull, np.cross(center, pull))) + bias))
        rig.front.orientation([0, 0, 0, *quaternion])
        assert rig.front.calibration_add().startswith("pose ")
    assert rig.note("calibration") == (Severity.INFO, "6 poses taken")
    text = rig.front.calibration_finish()
    assert "mass 0.8000 kg" in text
    assert rig.device.tool_fit.residuals.shape == (6, 6)
    assert rig.device.pipeline.tool.center == pytest.approx(center, abs=1e-5)
    assert rig.device.bias == pytest.approx(bias, abs=1e-5)
    rig.until_load([0] * 6, 1e-5)
    assert rig.note("calibration") is None


def test_poses_from_before_the_bias_was_lost_do_not_count(rig, caplog) -> None:
    rig.front.orientation([0, 0, 0, 0, 0, 0, 1])
    rig.front.calibration_add()
    assert rig.note("calibration")
    rig.lose_stream(lambda: rig.note("calibration") is None)
    assert "the poses of the calibration count no more: another client" in caplog.text


def test_a_calibration_that_tells_nothing_is_refused(rig) -> None:
    with pytest.raises(CommandRefused, match="orientation"):
        rig.front.calibration_add()
    rig.front.orientation([0, 0, 0, 0, 0, 0, 1])
    for _ in range(3):
        rig.front.calibration_add()
    with pytest.raises(CommandRefused, match="too much alike"):
        rig.front.calibration_finish()
    rig.front.calibration_clear()
    with pytest.raises(CommandRefused, match="too few"):
        rig.front.calibration_finish()
    assert rig.device.pipeline.tool is None


# -------------------------------------------------------------------------------- rates and full rate


def test_the_mean_of_a_window_is_published_at_the_rate(make, peer) -> None:
    rig = make(rate=100.0)
    eventually(lambda: rig.front.health().device["record_rate"] > 900, "rate known")

    def delays_by(seconds: float) -> bool:
        return rig.front.health().device["filter_delay"] == pytest.approx(seconds, rel=0.05)

    eventually(lambda: delays_by(4.5e-3), "the filter is that of the rate")

    def records_of_a_sample() -> float:
        before = rig.front.health()
        eventually(lambda: rig.front.health().samples >= before.samples + 20, "samples")
        after = rig.front.health()
        records = after.device["received"] - before.device["received"]
        return float(records / (after.samples - before.samples))

    # Of a thread that was held up, a sample has more.
    eventually(lambda: records_of_a_sample() == pytest.approx(10.0, rel=0.2), "ten of each")


def test_a_low_pass_may_take_its_place(make, peer) -> None:
    rig = make(low_pass=20.0)
    rig.set_load(10, 0, 0, 0, 0, 0)
    rig.until_load([10, 0, 0, 0, 0, 0], 1e-3)

    def is_known() -> bool:
        return rig.front.health().device["filter_delay"] == pytest.approx(0.01125, rel=0.05)

    eventually(is_known, "its delay")


@pytest.mark.real_time  # a world may change the order of datagrams
def test_every_measurement_reaches_programs_in_the_same_process(rig, peer) -> None:
    seen: list[np.ndarray] = []
    rig.device.add_listener(seen.append)
    reader = rig.device.blocks()
    eventually(lambda: sum(map(len, seen)) > 200, "listened")
    rig.device.remove_listener(seen.append)
    blocks = np.concatenate([reader.read() for _ in range(3)])
    heard = np.concatenate(seen)
    for some in (heard, blocks):
        begins = some["sequence"][1:] == 1  # asked for once more, where the peer was held up
        assert (begins | (np.diff(some["sequence"].astype(int)) == 1)).all()
        assert (begins | (np.diff(some["ticks"]) == 7)).all()
        assert (np.diff(some["stamp"]) > 0).all()
    assert reader.missed == 0
    assert len(rig.device.newest(100)) == 100
    assert abs(heard["stamp"][-1] - time.time_ns()) < LONG * 1e9


def test_iterating_ends_when_the_device_is_closed(rig) -> None:
    blocks: list[np.ndarray] = []
    thread = threading.Thread(target=lambda: blocks.extend(rig.device.blocks()))
    thread.start()
    eventually(lambda: len(blocks) > 2, "iterated")
    rig.front.close()
    thread.join(LONG)
    assert not thread.is_alive()


def test_a_listener_that_fails_is_called_no_more_and_the_others_are(rig, caplog) -> None:
    seen: list[np.ndarray] = []

    def broken(block: object) -> None:
        raise RuntimeError("mine")

    rig.device.add_listener(broken)
    rig.device.add_listener(seen.append)
    eventually(lambda: len(seen) > 3, "heard")
    assert "a listener failed" in caplog.text
    assert rig.session.engine.connected
