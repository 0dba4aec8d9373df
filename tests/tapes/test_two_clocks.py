"""Recordings of devices whose machines have clocks of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from crtk_drivers.cli import main
from crtk_drivers.errors import RecordingError
from crtk_drivers.labs.tapes.contents import Contents, contents_of
from crtk_drivers.recording import Raw, Recording, Series, cdr, opened
from crtk_drivers.samples import JointState, vector
from rigs.loopback_client import Far, far_device
from rigs.system_clock import YEAR, library_in, shifted
from rigs.waiting import LONG, eventually

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
RATE = 100
OWN = {"crtk_drivers device": {"name": "arm"}}


def write(path: Path, late: dict[str, float], metadata: dict[str, dict[str, str]]) -> Path:
    """Record steps at 1 s on some topics, each stamped so many seconds before its arrival."""
    series = Series(path, metadata=metadata)
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


@pytest.mark.parametrize("off", [0.006, -0.006, 2.0, -2.0, YEAR, -YEAR])
def test_devices_of_two_clocks_line_up_by_arrival(tmp_path: Path, off: float) -> None:
    late = {"/a/measured_js": 0.0005, "/b/measured_js": off}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}))[0])
    assert steps(contents) == pytest.approx(dict.fromkeys(late, 1.0))
    assert f"/a +0.001 s, /b {off:+.3f} s" in contents.note
    assert "chrony or PTP" in contents.note


def test_devices_of_one_clock_line_up_by_stamp(tmp_path: Path) -> None:
    late = {"/a/measured_js": 0.001, "/b/measured_js": 0.004}
    contents = contents_of(opened(write(tmp_path / "run.mcap", late, {}))[0])
    assert steps(contents) == pytest.approx({t: 1.0 - each for t, each in late.items()})
    assert contents.note == ""


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
    assert "arrival less stamp is /a +0.000 s, /b +2.000 s" in told
    if command == "plot":
        page = path.with_suffix(".html").read_text()
        assert "arrival less stamp is /a +0.000 s, /b +2.000 s" in page


# -------------------------------------------------------------------------------------- whole processes


@pytest.fixture
def ahead(tmp_path: Path) -> Iterator[str]:
    """A driver whose clock is 2 s ahead, in a process of its own; its namespace."""
    driver = subprocess.Popen(
        [sys.executable, "-m", "rigs.serve_loopback", "/ahead"],
        env=shifted(library_in(tmp_path), 2.0),
        stdout=subprocess.PIPE,
    )
    try:
        yield "/ahead"
    finally:
        driver.terminate()
        driver.communicate(timeout=LONG)


@pytest.fixture
def here() -> Iterator[Far]:
    with far_device("/here") as far:
        yield far


def test_record_keeps_arrivals_and_plot_uses_them(here: Far, ahead: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    recorder = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "crtk_drivers.cli",
            "record",
            here.namespace,
            ahead,
            "-o",
            str(path),
        ],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )

    def has_both() -> bool:
        try:
            counts = Recording(path).counts
        except RecordingError:  # nothing is written yet
            return False
        return all(counts.get(f"{each}/measured_js", 0) > 50 for each in (here.namespace, ahead))

    try:
        eventually(has_both, "both devices are recorded")
    finally:
        recorder.send_signal(signal.SIGINT)
        recorder.communicate(timeout=LONG)
    recording, _ = opened(path)
    for topic, off in ((f"{here.namespace}/measured_js", 0.0), (f"{ahead}/measured_js", 2.0)):
        messages = list(recording.messages(topic))
        early = [(each.decoded().stamp_ns - each.log_time) / SECOND for each in messages]
        assert np.median(early) == pytest.approx(off, abs=0.3)
        began = min(each.log_time for each in recording.messages())
        track = contents_of(recording).devices[topic.rpartition("/")[0]].tracks["measured_js"]
        arrived = sorted((each.log_time - began) / SECOND for each in messages)
        assert track.times == pytest.approx(np.array(arrived), abs=1e-6)
    assert f"{ahead} -" in contents_of(recording).note
