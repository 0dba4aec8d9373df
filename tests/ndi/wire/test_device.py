"""The driver at simulated trackers: what its tools tell, over TCP and a serial line, in every dialect."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_ndi import PLUGIN
from crtk_driver_ndi.codec import command
from crtk_driver_ndi.device import NdiDevice
from crtk_driver_ndi.frames import Frame
from crtk_driver_ndi.stream import FrameStream
from crtk_drivers.cli import main
from crtk_drivers.errors import ConfigError, ConnectionFailed, TransitionFailed
from crtk_drivers.geometry.frames import product
from crtk_drivers.samples import Pose, Poses, Stamp
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from rigs.ndi_bench import (
    TRANSPORTS,
    NdiBench,
    configuration,
    eventually,
    ndi_bench,
    simulated,
    write_rom,
)
from rigs.waiting import LONG

WIRED = [
    {"name": "pointer", "part_number": "SIM-POINTER"},
    {"name": "bone", "part_number": "SIM-REFERENCE"},
]
APART = 0.04
"""m along x from one tool of a simulator to the next."""


@pytest.fixture(scope="module")
def vega() -> Iterator[RunningSim]:
    with simulated(family="vega", motion="still", noise=0.0) as sim:
        yield sim


@pytest.fixture(autouse=True)
def clear(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    if "vega" in request.fixturenames:
        request.getfixturevalue("vega").control.clear()


def newest(bench: NdiBench, tool: str, name: str = "measured_cp") -> Pose:
    # The tracker tells what it has of all tools before each tool does.
    found = eventually(lambda: bench.session.children[tool].feedback(name), f"a pose of {tool}")
    assert isinstance(found[0], Pose)
    return found[0]


@pytest.mark.parametrize(
    ("family", "transport", "replies", "middle"),
    [
        ("vega", "tcp", "BX2", -1.5),
        ("vega", "serial", "TX", -1.5),
        ("vega-xt", "tcp", "BX", -1.5),
        ("lyra", "tcp", "auto", -0.55),
        ("spectra", "serial", "auto", -1.5),
        ("vicra", "serial", "TX", -0.95),
        ("aurora", "serial", "auto", -0.25),
    ],
)
def test_poses_are_in_metres_in_the_frame_of_the_tracker(
    family: str, transport: str, replies: str, middle: float
) -> None:
    with (
        simulated(family=family, motion="still", noise=0.0) as sim,
        ndi_bench(sim, transport=transport, replies=replies, family=family) as bench,
    ):
        bench.tracking()
        first, second = newest(bench, "pointer"), newest(bench, "reference")
        assert first.position == pytest.approx([0.0, 0.0, middle], abs=1e-6)
        assert second.position - first.position == pytest.approx([APART, 0.0, 0.0], abs=1e-6)
        assert first.frame_id == "tracker"
        assert np.linalg.norm(first.orientation) == pytest.approx(1.0, abs=1e-12)
        error = bench.front.pointer.state.tracking_error()
        assert error == pytest.approx(0.1 if family == "aurora" else 1e-4)


def test_wireless_tools_come_from_their_definitions(vega: RunningSim, tmp_path: Path) -> None:
    tools = [
        {"rom": write_rom(tmp_path, "8700340")},
        {"name": "bone", "rom": write_rom(tmp_path, "8700449", 1)},
    ]
    with ndi_bench(vega, tools=tools) as bench:
        assert list(bench.session.children) == ["tool_8700340", "bone"]
        bench.tracking()
        apart = newest(bench, "bone").position - newest(bench, "tool_8700340").position
        assert apart == pytest.approx([APART, 0.0, 0.0], abs=1e-6)


def test_in_the_frame_of_a_reference_and_in_that_of_the_tracker(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED, reference="bone") as bench:
        bench.tracking()
        pose, local = newest(bench, "pointer"), newest(bench, "pointer", "local/measured_cp")
        assert pose.frame_id == "bone"
        assert np.linalg.norm(pose.position) == pytest.approx(APART, abs=1e-6)
        back = product(newest(bench, "bone"), pose)
        assert back.position == pytest.approx(local.position, abs=1e-6)
        assert abs(back.orientation @ local.orientation) == pytest.approx(1.0, abs=1e-9)
        assert local.position == pytest.approx([0.0, 0.0, -1.5], abs=1e-6)
        assert newest(bench, "bone").frame_id == "tracker"
        vega.control.inject("hide", tool=1)
        bench.sees("pointer", False)
        eventually(lambda: "the reference bone is missing" in bench.told("pointer"), "said why")


def test_a_missing_tool_has_stamp_0_and_its_last_pose(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED) as bench:
        bench.tracking()
        before = newest(bench, "pointer")
        vega.control.inject("hide", tool=0)
        # A pose that is only late is not valid, too.
        eventually(lambda: bench.told("pointer") == "missing", "told")
        bench.sees("pointer", False)
        assert newest(bench, "pointer").position == pytest.approx(before.position)
        bench.sees("bone")
        assert not bench.front.pointer.state.visible()
        assert bench.front.state.tools_in_view() == 1.0
        vega.control.clear("hide")
        bench.sees("pointer")
        assert bench.told("pointer") == ""


@pytest.mark.parametrize("replies", ["BX2", "BX", "TX"])
@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("out", "out of volume"),
        ("interference", "infrared interference"),
        ("algorithm", "algorithm limit"),
    ],
)
def test_a_bad_pose_is_told_with_its_quality(
    vega: RunningSim, replies: str, how: str, words: str
) -> None:
    with ndi_bench(vega, tools=WIRED, replies=replies) as bench:
        bench.tracking()
        vega.control.inject("hide", tool=0, how=how)
        eventually(lambda: bench.told("pointer") == words, words)
        bench.sees("pointer")


def test_what_is_outside_can_be_taken_as_missing(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED, replies="BX", outside="missing") as bench:
        bench.tracking()
        vega.control.inject("hide", tool=0, how="partly")
        eventually(lambda: bench.told("pointer") == "partly out of volume", "told")
        bench.sees("pointer", False)


@pytest.mark.parametrize("replies", ["BX2", "BX", "TX"])
def test_buttons(vega: RunningSim, replies: str) -> None:
    with ndi_bench(vega, tools=WIRED, replies=replies) as bench:
        bench.tracking()
        vega.control.inject("press", tool=0, button=2)
        pointer = bench.front.pointer
        eventually(lambda: pointer.state.buttons() == (0.0, 1.0, 0.0), "pressed")


@pytest.mark.parametrize("replies", ["BX2", "BX"])
def test_stamps_are_those_of_the_frames(vega: RunningSim, replies: str) -> None:
    """By the line through frame numbers: the simulator says when it took each."""
    with ndi_bench(vega, tools=WIRED, replies=replies) as bench:
        bench.tracking()
        eventually(lambda: bench.counters["frames"] > 120.0, "two seconds")
        tracker = bench.session.engine.device
        assert isinstance(tracker, NdiDevice)
        assert tracker.stream is not None
        origin, rate = vega.control.status()["origin"], 60.0
        stream = tracker.stream

        def is_of_its_frame() -> bool:
            found = _together(stream)
            if found is None:
                return False
            newest, stamp = found
            return abs(stamp.monotonic - (origin + newest.number / rate)) < 0.25 / rate

        eventually(is_of_its_frame, "a stamp of the frame, once answers have come in time")


@pytest.mark.parametrize("begins", ["before it tracks", "in mid-stream"])
@pytest.mark.parametrize(
    ("replies", "direction", "seconds"),
    [("BX2", "out", 0.1), ("TX", "out", 0.3), ("BX", "in", 0.1)],
)
def test_late_replies_are_not_stamped_fresh(
    vega: RunningSim, replies: str, begins: str, direction: str, seconds: float
) -> None:
    """By the simulator's own time of each frame, while a link holds all back by the same time."""
    period = 1.0 / 60.0
    with ndi_bench(vega, tools=WIRED, replies=replies) as bench:

        def hold_back() -> None:
            vega.control.inject("delay", seconds=seconds, direction=direction)

        if begins == "before it tracks":
            hold_back()
        bench.front.enable()
        if begins == "in mid-stream":
            eventually(lambda: bench.counters["frames"] > 60.0, "a second")
            hold_back()
            eventually(lambda: bench.counters["reply_time"] > seconds, "a late reply")
        tracker = bench.session.engine.device
        assert isinstance(tracker, NdiDevice)
        assert tracker.stream is not None
        stream, origin = tracker.stream, vega.control.status()["origin"]
        younger, first = [], stream.frames
        seen = first
        while seen < first + 2.0 / seconds:
            found, count = _together(stream), stream.frames
            if found is not None and count > seen:
                seen, (newest, stamp) = count, found
                younger.append(stamp.monotonic - (origin + newest.number * period))
            time.sleep(0.002)
        assert len(younger) > 1.0 / seconds
        assert max(younger) < period + 0.02
        assert min(younger) > -seconds - period - 0.02
        vega.control.clear()


def _together(stream: FrameStream) -> tuple[Frame, Stamp] | None:
    """Return the newest frame and its stamp, while another thread writes them."""
    newest, stamp, count = stream.newest, stream.stamp, stream.frames
    return (newest, stamp) if newest is stream.newest and stream.frames == count else None


@pytest.mark.parametrize("replies", ["BX2", "BX"])
@pytest.mark.parametrize("set_by", ["driver", "tracker"])
def test_a_slower_track_frequency_loses_nothing(replies: str, set_by: str) -> None:
    """Frame numbers rise by 3: by the simulator's own count it is asked as often as at 60 Hz, by frame."""
    driver: dict[str, Any] = {"track_frequency": 20} if set_by == "driver" else {}
    tracker = {} if driver else {"track_frequency": "20"}
    with simulated(**tracker) as sim, ndi_bench(sim, replies=replies, **driver) as bench:
        bench.tracking()
        begun, asked = bench.counters["frames"], sim.control.status()["questions"]
        eventually(lambda: bench.counters["frames"] >= begun + 40, "2 s of frames")
        assert sim.control.status()["step"] == 3
        asked = sim.control.status()["questions"] - asked
        assert asked / (bench.counters["frames"] - begun) < 12.0
        assert bench.counters["lost"] <= 2
        assert bench.counters["frame_rate"] == pytest.approx(20.0, rel=0.02)


def test_another_track_frequency_counts_from_enable_on() -> None:
    """Another client has set it, while this one tracked nothing."""
    with simulated() as sim, ndi_bench(sim) as bench:
        bench.tracking()
        bench.front.disable()
        with socket.create_connection((sim.host, sim.ports["tcp"]), timeout=LONG) as other:
            other.sendall(command("SET:Param.Tracking.Track Frequency=0"))
            assert other.recv(100).startswith(b"OKAY")
        bench.front.enable()
        eventually(lambda: bench.counters["frames"] >= 20, "1 s of frames")
        assert sim.control.status()["step"] == 3
        assert bench.counters["lost"] <= 2


def test_a_track_frequency_that_it_does_not_have_is_refused() -> None:
    with simulated(family="aurora") as sim:
        device = NdiDevice(configuration(sim, track_frequency=30))
        with pytest.raises(ConnectionFailed, match=r"track_frequency: 30 Hz cannot be set"):
            device.open(time.monotonic() + LONG)


def test_enabled_means_tracking_and_tools_follow(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED) as bench:
        assert vega.control.status()["mode"] == "setup"
        with pytest.raises(TransitionFailed, match="Enable the tracker"):
            bench.front.pointer.enable()
        bench.tracking()
        assert vega.control.status()["mode"] == "tracking"
        bench.front.pointer.enable()
        bench.front.pause()
        assert vega.control.status()["mode"] == "tracking"
        bench.front.resume()
        bench.front.disable()
        assert vega.control.status()["mode"] == "setup"
        pointer = bench.front.pointer
        eventually(lambda: pointer.operating_state().state is OperatingState.DISABLED, "with it")
        assert "does not track" in pointer.operating_state().detail


def test_closing_leaves_a_tracker_that_does_not_track(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED) as bench:
        bench.tracking()
    assert vega.control.status()["mode"] == "setup"


@pytest.mark.parametrize("left", ["tracking", "not tracking", "scanned"])
def test_the_next_program_can_initialise_every_tool(vega: RunningSim, left: str) -> None:
    """Without freeing handles that somebody may have left: by the simulated tracker's own PINIT."""
    if left == "scanned":
        assert main(["ndi", "scan", "--host", vega.host, "--tcp-port", str(vega.ports["tcp"])]) == 0
    else:
        with ndi_bench(vega, tools=WIRED) as bench:
            if left == "tracking":
                bench.tracking()
    with socket.create_connection((vega.host, vega.ports["tcp"]), timeout=LONG) as other:
        for text, start in (
            ("INIT:", b"OKAY"),
            ("PHSR:02", b"02"),
            ("PINIT:01", b"OKAY"),
            ("PINIT:02", b"OKAY"),
        ):
            other.sendall(command(text))
            assert other.recv(100).startswith(start), text


def initialised(sim: RunningSim) -> list[str]:
    """Return the handles that are initialised, by the simulated tracker."""
    handles = str(sim.control.status()["handles"]).split()
    return [each for each in handles if int(each.partition(":")[2], 16) & 0x10]


def test_an_open_that_fails_frees_its_tools() -> None:
    with simulated() as sim:
        device = NdiDevice(configuration(sim, tools=WIRED))
        sim.control.inject("error", command="PENA")
        with pytest.raises(ConnectionFailed, match="PENA"):
            device.open(time.monotonic() + LONG)
        assert not initialised(sim)
        device.close()
        assert not initialised(sim)


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_closing_while_opening_frees_the_tools(transport: str) -> None:
    with simulated() as sim:
        sim.control.inject("swallow", command="PENA")
        session = Session(PLUGIN, configuration(sim, tools=WIRED, transport=transport))
        session.start()
        eventually(lambda: len(initialised(sim)) == 2, "both tools are initialised")
        session.close(LONG)
        assert not initialised(sim)


def test_what_a_dead_client_has_left_is_freed_first() -> None:
    """Wired tools that are initialised, and the handle of a wireless one."""
    with simulated(left=2) as sim:
        with socket.create_connection((sim.host, sim.ports["tcp"]), timeout=LONG) as other:
            for text in ("INIT:", "PHRQ:*********1****"):
                other.sendall(command(text))
                assert other.recv(100).endswith(b"\r")
        assert len(sim.control.status()["handles"].split()) == 3
        with ndi_bench(sim, tools=WIRED) as bench:
            assert sim.control.status()["handles"] == "01:31 02:31"
            bench.tracking()


@pytest.mark.parametrize("transport", TRANSPORTS)
def test_a_tracker_that_a_dead_client_has_left_tracking_is_stopped_first(transport: str) -> None:
    """Its line is at 9600 bit/s, and no rate can be changed while it tracks."""
    with simulated() as sim:
        with socket.create_connection((sim.host, sim.ports["tcp"]), timeout=LONG) as other:
            for text in ("INIT:", "TSTART:80"):
                other.sendall(command(text))
                assert other.recv(100) == b"OKAYA896\r"
        assert sim.control.status()["mode"] == "tracking"
        with ndi_bench(sim, transport=transport) as bench:
            assert sim.control.status()["mode"] == "setup"
            bench.tracking()


def test_the_rate_of_the_line_is_found_and_changed() -> None:
    with simulated(family="spectra") as sim:
        for baud in (921600, 115200, 57600):  # with few others in vain before that which it has
            with ndi_bench(sim, transport="serial", baud=baud) as bench:
                assert sim.control.status()["baud"] == baud
                bench.tracking()


def test_it_beeps_in_any_state(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=WIRED) as bench:
        assert bench.front.beep() == "it beeped"
        bench.tracking()
        assert bench.front.beep() == "it beeped"
        bench.sees("pointer")


def test_a_tool_that_is_not_plugged_in_is_told(vega: RunningSim) -> None:
    with ndi_bench(vega, tools=[*WIRED, {"name": "probe", "serial_number": "12345678"}]) as bench:
        texts = [note.text for note in bench.front.health().notes]
        assert "probe is not plugged in" in texts
        bench.front.enable()
        bench.sees("pointer")
        assert not bench.is_valid("probe")


def test_without_a_tool_nothing_is_tracked(vega: RunningSim) -> None:
    with (
        ndi_bench(vega, tools=[{"name": "probe", "serial_number": "12345678"}]) as bench,
        pytest.raises(TransitionFailed, match="no tool"),
    ):
        bench.front.enable()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"tools": [{"name": "a", "part_number": "1", "rom": "x"}]}, "give rom, or part_number"),
        ({"tools": [{"name": "a/b", "part_number": "1"}]}, "a letter first"),
        (
            {"tools": [{"name": "a", "part_number": "1"}, {"name": "a", "part_number": "2"}]},
            "more than once",
        ),
        ({"tools": [{"part_number": "1 2"}, {"part_number": "1-2"}]}, "tool_1_2"),
        ({"tools": [{"name": "tracker", "part_number": "1"}]}, "frame of its name"),
        ({"reference": "bone"}, "no tool 'bone'"),
        ({"tools": [{"rom": "missing.rom"}]}, "missing.rom"),
        ({"baud": 19200}, "baud"),
    ],
)
def test_configurations_that_cannot_be_used(values: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        PLUGIN.make(PLUGIN.load_config(values, {}))


@pytest.mark.parametrize(("values", "key"), [({}, "host"), ({"transport": "serial"}, "port")])
def test_a_real_tracker_needs_an_address(values: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=f"{key}: is required"):
        PLUGIN.check_real(PLUGIN.load_config(values, {}))


def test_the_link_can_be_told_and_pointed_elsewhere(vega: RunningSim) -> None:
    assert PLUGIN.link is not None
    for transport in ("tcp", "serial"):
        config = configuration(vega, transport=transport)
        link = PLUGIN.link.of(config, vega)
        assert link is not None
        assert PLUGIN.link.at(config, link) == config


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("info",), ("Polaris Vega ST", "BX2, BX, TX", "Track Frequency: 2 (60 Hz)")),
        (("scan",), ("[[tools]]", 'part_number = "SIM-POINTER"')),
        (("beep",), ("it beeped",)),
    ],
)
def test_tools_for_people(
    words: tuple[str, ...], told: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ndi", *words, "--sim"]) == 0
    out = capsys.readouterr().out
    for text in told:
        assert text in out


def test_what_a_definition_says_needs_no_tracker(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["ndi", "rom", write_rom(tmp_path, "8700340")]) == 0
    assert "pointer 8700340, by CRTK SIM" in capsys.readouterr().out
    assert main(["ndi", "rom", str(tmp_path / "none.rom")]) != 0


def newest_array(bench: NdiBench) -> tuple[Poses, Stamp]:
    found = bench.session.engine.feedback("measured_cp_array")
    assert found is not None
    assert isinstance(found[0], Poses)
    return found[0], found[1]


def tracking_array(bench: NdiBench, count: int) -> Poses:
    bench.connected()
    bench.front.enable()

    def is_there() -> bool:
        found = bench.session.engine.feedback("measured_cp_array")
        return (
            found is not None
            and found[1].wall_ns != 0
            and len(newest_array(bench)[0].poses) == count
        )

    eventually(is_there, f"{count} poses")
    return newest_array(bench)[0]


@pytest.fixture(scope="module")
def with_strays() -> Iterator[RunningSim]:
    with simulated(family="vega", motion="still", noise=0.0, strays=9) as sim:
        yield sim


@pytest.mark.parametrize("replies", ["BX2", "BX", "TX"])
def test_all_that_is_seen_is_one_array_tools_first_and_strays_where_they_are_asked_for(
    with_strays: RunningSim, replies: str
) -> None:
    with ndi_bench(with_strays, tools=WIRED, replies=replies, strays=True) as bench:
        found = tracking_array(bench, 2 + 9)
        assert found.frame_id == "tracker"
        places = np.array([pose.position for pose in found.poses])
        assert np.allclose(places[:2], [(0.0, 0.0, -1.5), (APART, 0.0, -1.5)], atol=1e-4)
        assert np.allclose(places[2:, 1], 0.03 * np.arange(1, 10), atol=1e-4)
        assert bench.front.state.stray_markers() == 9.0


def test_what_is_not_seen_is_not_in_the_array_and_without_the_reference_it_is_not_valid(
    with_strays: RunningSim,
) -> None:
    with ndi_bench(with_strays, tools=WIRED, reference="bone") as bench:
        found = tracking_array(bench, 2)
        assert found.frame_id == "bone"
        assert np.allclose(found.poses[1].position, 0.0)
        with_strays.control.inject("hide", tool=0, how="missing")
        tracking_array(bench, 1)
        with_strays.control.inject("hide", tool=1, how="missing")
        eventually(lambda: newest_array(bench)[1].wall_ns == 0, "the reference is missing")
        with_strays.control.clear()


def test_a_tip_moves_a_tools_pose_to_it_and_a_base_the_poses_of_all_tools(vega: RunningSim) -> None:
    tip, base = {"position": (0.0, 0.0, -0.1)}, {"position": (1.0, 0.0, 2.0), "frame_id": "room"}
    tools = [{**WIRED[0], "tip": tip}, WIRED[1]]
    with ndi_bench(vega, tools=tools, base=base) as bench:
        found = tracking_array(bench, 2)
        assert found.frame_id == newest(bench, "pointer").frame_id == "room"
        for pose in (found.poses[0], newest(bench, "pointer")):
            assert np.allclose(pose.position, (1.0, 0.0, 0.4), atol=1e-4)
        assert np.allclose(newest(bench, "bone").position, (1.0 + APART, 0.0, 0.5), atol=1e-4)
        local = newest(bench, "pointer", "local/measured_cp")
        assert np.allclose(local.position, (0.0, 0.0, -1.6), atol=1e-4)
