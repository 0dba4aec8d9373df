"""Recordings of devices whose machines have clocks of their own."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_drivers.cli import main
from crtk_drivers.client import clock_watch
from crtk_drivers.client.clock_offset import ANSWERED_WITHIN
from crtk_drivers.client.recorded_clocks import RecordedClocks
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.topic_recorder import TopicRecorder
from crtk_drivers.errors import RecordingError
from crtk_drivers.labs.tapes.contents import Contents, contents_of
from crtk_drivers.recording import Raw, Recorder, Recording, Series, cdr, opened
from crtk_drivers.recording.clock_records import CLOCK, clock_texts, offsets_in
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.samples import CLOCKS_AGREE, ClockOffset, JointState, Vector, vector
from rigs.system_clock import YEAR, shifted
from rigs.waiting import LONG, eventually

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
RATE = 100
OLD = "/old/measured_js"
OWN = {"crtk_drivers device": {"name": "arm"}}


def write(
    path: Path,
    late: dict[str, float],
    metadata: dict[str, dict[str, str]],
    clocks: Sequence[dict[str, str]] = (),
) -> Path:
    """Record steps at 1 s on some topics, each stamped so many seconds before its arrival."""
    series = Series(path, metadata=metadata)
    for number, texts in enumerate(clocks):
        series.hold(str(number), CLOCK, texts)
    for number in range(2 * RATE):
        at = BEGIN + number * SECOND // RATE
        for topic, seconds in late.items():
            state = JointState(vector([float(number >= RATE)]), name=("joint",))
            stamp = at - round(seconds * SECOND)
            data = cdr.encode(state, stamp, "base")
            series.message(Raw(topic, cdr.TYPE_NAMES[JointState], data, at, stamp, definition=""))
    series.finish()
    return path


def steps(contents: Contents) -> dict[str, float]:
    """Return when (s) the joint of each topic steps."""
    return {
        f"{space}/{name}": float(track.times[np.argmax(track.columns["position/joint"] > 0.5)])
        for space, device in contents.devices.items()
        for name, track in device.tracks.items()
    }


@pytest.mark.parametrize("off", [-0.006, 2.0, -2.0, YEAR, -YEAR])
def test_devices_of_two_clocks_line_up_by_arrival(tmp_path: Path, off: float) -> None:
    late = {"/a/measured_js": 0.0005, "/b/measured_js": off}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}))[0])
    assert steps(contents) == pytest.approx(dict.fromkeys(late, 1.0))
    side = "after" if off > 0.0 else "before"
    assert f"what /b sends arrives {abs(off):.3f} s {side} its stamp" in contents.note
    assert "/a" not in contents.note
    assert "chrony or PTP" in contents.note


@pytest.mark.parametrize("late_b", [0.004, 0.02, 0.4])
def test_devices_that_may_agree_line_up_by_stamp(tmp_path: Path, late_b: float) -> None:
    late = {"/a/measured_js": 0.001, "/b/measured_js": late_b, "/b/setpoint_js": late_b}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}))[0])
    assert steps(contents) == pytest.approx({t: 1.0 - each for t, each in late.items()})
    old = f"/b is {late_b:.3f} s old when it arrives, or its clock is behind; drawn by stamp"
    assert contents.note == ("" if late_b < CLOCKS_AGREE else old)


def clock(namespace: str, *offsets: tuple[float, float]) -> Iterator[dict[str, str]]:
    for value, uncertainty in offsets:
        yield clock_texts(namespace, ClockOffset(value, uncertainty), BEGIN)


@pytest.mark.parametrize("late_b", [-0.02, 0.02, 0.8])
def test_stamps_of_clocks_known_to_agree_are_used(tmp_path: Path, late_b: float) -> None:
    late = {"/a/measured_js": 0.001, "/b/measured_js": late_b, "/b/local/measured_js": late_b}
    known = [*clock("/b", (0.009, 0.005))]
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}, known))[0])
    assert steps(contents) == pytest.approx({t: 1.0 - each for t, each in late.items()})
    assert contents.note == ""


@pytest.mark.parametrize("late_b", [0.001, 0.02])
@pytest.mark.parametrize("offset", [0.012, -0.012])
def test_a_clock_that_was_ever_apart_counts(tmp_path: Path, late_b: float, offset: float) -> None:
    late = {"/a/measured_js": 0.02, "/b/measured_js": late_b}
    known = [*clock("/b", (0.0, 0.001), (offset, 0.006), (0.0, 0.001))]
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}, known))[0])
    assert steps(contents) == pytest.approx(dict.fromkeys(late, 1.0))
    side = "ahead" if offset > 0.0 else "behind"
    assert f"that of /b is 0.012 s {side}. Compare" in contents.note


def test_old_samples_of_one_process_keep_their_stamps(tmp_path: Path) -> None:
    late = {"/a/measured_js": 0.03, "/a/gripper/measured_js": 0.0}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, OWN))[0])
    assert steps(contents) == pytest.approx({t: 1.0 - each for t, each in late.items()})
    assert contents.note == ""


@pytest.mark.parametrize("off", [0.006, -0.006, 2.0, -2.0, YEAR])
def test_setpoints_by_the_clock_of_a_client_go_by_arrival(tmp_path: Path, off: float) -> None:
    late = {"/a/measured_js": 0.001, "/a/setpoint_js": off}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, OWN))[0])
    assert steps(contents) == pytest.approx({"/a/measured_js": 0.999, "/a/setpoint_js": 1.0})


@pytest.mark.parametrize("command", ["plot", "convert"])
def test_the_commands_tell_of_two_clocks(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], command: str
) -> None:
    path = write(tmp_path / "run.mcap", {"/a/measured_js": 0.0, "/b/measured_js": 2.0}, {})
    assert main([command, str(path)]) == 0
    told = " ".join(capfd.readouterr().err.split())
    assert "what /b sends arrives 2.000 s after its stamp" in told
    if command == "plot":
        page = path.with_suffix(".html").read_text()
        assert "what /b sends arrives 2.000 s after its stamp" in page


# -------------------------------------------------------------------------------------- whole processes


@contextmanager
def driver(namespace: str, *words: str, ahead: float = 0.0) -> Iterator[subprocess.Popen[bytes]]:
    """Run a driver in a process of its own.

    Args:
        namespace: of it.
        words: of `rigs.serve_loopback`.
        ahead: seconds that its clock is ahead.
    """
    process = subprocess.Popen(
        [sys.executable, "-m", "rigs.serve_loopback", namespace, *words],
        env=shifted(ahead),
        stdout=subprocess.PIPE,
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.communicate(timeout=LONG)


@pytest.fixture(scope="module")
def drivers() -> Iterator[None]:
    """One whose clock is 2 s ahead, one whose samples are 20 ms old, and one of which neither is so."""
    with (
        driver("/ahead", ahead=2.0),
        driver("/old", "--old", "0.02"),
        driver("/here"),
    ):
        yield


def recorded(path: Path, *namespaces: str, end: signal.Signals = signal.SIGINT) -> str:
    """Record until each device has said something and its clock is known; return what was told."""
    command = [sys.executable, "-m", "crtk_drivers.cli", "record", *namespaces, "-o", str(path)]
    recorder = subprocess.Popen(command, env=shifted(0.0), stderr=subprocess.PIPE, text=True)

    def has_all() -> bool:
        try:
            found = Recording(path)
        except RecordingError:  # nothing is written yet
            return False
        said = (found.counts.get(f"{each}/measured_js", 0) > 50 for each in namespaces)
        return all(said) and offsets_in(found.metadata).keys() >= set(namespaces)

    try:
        eventually(has_all, "all devices are recorded, and their clocks are known")
    finally:
        recorder.send_signal(end)
        _, told = recorder.communicate(timeout=LONG)
    return told


def times_of(recording: Recording | Foreign, topic: str, by: str) -> Vector:
    """Return stamps or arrivals of a topic, in s since the recording began."""
    began = min(each.log_time for each in recording.messages())
    return vector(sorted((getattr(m, by) - began) / SECOND for m in recording.messages(topic)))


def drawn(recording: Recording | Foreign, namespace: str) -> Vector:
    return contents_of(recording).devices[namespace].tracks["measured_js"].times


@pytest.mark.usefixtures("drivers")
def test_old_samples_of_a_known_clock_are_drawn_by_stamp(tmp_path: Path) -> None:
    told = recorded(tmp_path / "run.mcap", "/here", "/old")
    recording, _ = opened(tmp_path / "run.mcap")
    late = [(m.log_time - m.decoded().stamp_ns) / SECOND for m in recording.messages(OLD)]
    assert np.median(late) > 0.02, "the rig makes them old"
    for offset in itertools.chain(*offsets_in(recording.metadata).values()):
        assert abs(offset.value) <= offset.uncertainty
    for each in ("/here", "/old"):
        stamps = times_of(recording, f"{each}/measured_js", "publish_time")
        assert drawn(recording, each) == pytest.approx(stamps, abs=1e-6)
    assert contents_of(recording).note == ""
    assert "clock:" not in told


@pytest.mark.usefixtures("drivers")
def test_a_clock_apart_is_told_and_drawn_by_arrival(tmp_path: Path) -> None:
    told = recorded(tmp_path / "run.mcap", "/old", "/ahead")
    recording, _ = opened(tmp_path / "run.mcap")
    for offset in offsets_in(recording.metadata)["/ahead"]:
        assert abs(offset.value - 2.0) <= offset.uncertainty
    for each in ("/old", "/ahead"):
        arrivals = times_of(recording, f"{each}/measured_js", "log_time")
        assert drawn(recording, each) == pytest.approx(arrivals, abs=1e-6)
    # As precisely as it could be measured, not to the millisecond on a busy machine.
    ahead = r"that of /ahead is (1\.99|2\.00)\d s ahead"
    assert re.search(rf"{ahead}\. Compare", contents_of(recording).note)
    assert len(re.findall(rf"clock: {ahead} of this computer's", told)) == 1


@pytest.mark.usefixtures("drivers")
def test_a_killed_recording_keeps_what_was_measured(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", "/ahead", end=signal.SIGKILL)
    recording, told = opened(tmp_path / "run.mcap")
    assert "has been mended" in told
    (offset,) = offsets_in(recording.metadata)["/ahead"]
    assert abs(offset.value - 2.0) <= offset.uncertainty


@dataclass
class Taken:
    """A recording by this process, with the namespaces whose clocks were measured."""

    link: Link
    recorder: Recorder
    topics: TopicRecorder
    measured: list[str]

    def until_there(self, *namespaces: str) -> None:
        def there() -> bool:
            self.topics.look()
            return self.topics.drivers >= set(namespaces)

        eventually(there, "the drivers are found")


@pytest.fixture
def taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Taken]:
    monkeypatch.setattr(clock_watch, "PERIOD", 0.0)
    measured: list[str] = []
    with closing(Link("recorder")) as link, Recorder(tmp_path / "run.mcap") as recorder:
        link.start()
        topics = TopicRecorder(link, recorder, ["/ahead", "/here", "/silent"])
        hold = recorder.hold

        def note(key: str, *others: Any, **more: Any) -> None:
            measured.append(key.rpartition(" ")[2])
            hold(key, *others, **more)

        monkeypatch.setattr(recorder, "hold", note)
        yield Taken(link, recorder, topics, measured)
        topics.close()


@pytest.mark.usefixtures("drivers")
def test_a_clock_apart_is_warned_of_once(taken: Taken) -> None:
    taken.until_there("/ahead", "/here")
    found = []
    with closing(RecordedClocks(taken.link, taken.recorder, taken.topics)) as clocks:
        eventually(lambda: taken.measured.count("/ahead") > 2, "it is measured again and again")
        found += clocks.newly_apart()
    found += clocks.newly_apart()
    ((namespace, offset),) = found
    assert namespace == "/ahead"
    assert abs(offset.value - 2.0) <= offset.uncertainty


@pytest.mark.usefixtures("drivers")
def test_a_silent_driver_keeps_nobody_waiting(taken: Taken) -> None:
    with driver("/silent") as silent:
        taken.until_there("/silent", "/here")
        silent.send_signal(signal.SIGSTOP)
        missed = taken.topics.missed
        with closing(RecordedClocks(taken.link, taken.recorder, taken.topics)):
            eventually(lambda: taken.measured.count("/here") > 1, "others are measured")
            ending = time.monotonic()
        assert time.monotonic() - ending < 2.0 * ANSWERED_WITHIN
        assert taken.topics.missed == missed
    assert "/silent" not in taken.measured
    assert taken.recorder.totals.lost == 0
