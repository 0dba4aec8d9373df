"""What stands still under the bench, or is killed: nothing leaps, and nothing is left or passed over."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import tempfile
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from crtk_drivers.labs.bench import bed, conductor, watch
from crtk_drivers.labs.bench.acquisition import Subject
from crtk_drivers.labs.bench.bed import LONGEST_STEP, Process, paced
from crtk_drivers.labs.bench.catalogue import TESTS
from crtk_drivers.labs.bench.conducting import DeviceOrder
from crtk_drivers.labs.bench.door import Door
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.samples import JointState, Text, vector
from crtk_drivers.testing.clock import FakeClock
from crtk_drivers.testing.loopback import ROTARY
from rigs.waiting import eventually

T5 = next(test for test in TESTS if test.id == "T5")

FREEZING = """
import sys, time
from crtk_drivers.labs.bench.programs import frozen
with frozen(int(sys.argv[1])):
    print("frozen", flush=True)
    time.sleep(1000)
"""


def test_a_stream_does_not_leap_after_a_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()
    monkeypatch.setattr(bed, "time", SimpleNamespace(monotonic=clock, sleep=clock.advance))
    times = []
    for at in paced(100.0, 1.0):
        times.append(at)
        if len(times) == 30:
            clock.advance(5.0)
    steps = [after - before for before, after in pairwise(times)]
    assert max(steps) == pytest.approx(LONGEST_STEP)
    assert sorted(steps)[-2] == pytest.approx(0.01)
    assert times[0] == 0.0
    assert 0.98 <= times[-1] < 1.0


def samples_that_stand(streams: bool) -> Findings:
    """Judge a swing of which half a second is missing in its middle; `streams` in that time."""
    rows: list[Row] = []

    def told(at: float, kind: str, text: str) -> None:
        rows.append(("events", ns(at), 0, Text(json.dumps({"kind": kind, "text": text}))))

    def ns(at: float) -> int:
        return round(1e9 * (1.0 + at))

    told(0.0, "note", '{"frequencies": [1.0], "amplitude 1": [0.05], "stream_rate": 50.0}')
    told(0.0, "mark", "begin 1")
    for at in np.arange(0.0, 8.0, 0.01).tolist():
        stands = 4.05 < at < 4.55
        place = math.sin(2.0 * math.pi * (4.05 if stands else at - 0.5 * (at >= 4.55)))
        state = JointState(position=vector([0.05 * place]))
        rows.append(("measured_js", ns(at), ns(at), state))
        if not stands or streams:
            rows.append(("command/servo_jp", ns(at + 1e-3), ns(at), state))
    told(8.0, "mark", "end 1")
    subject = Subject(("joint_1",), (ROTARY,), 100.0, 0.0, 1.0, 0.1, 0.5, 0.05, 0.1)
    return T5.analyse(Trace.of(rows), subject)


def test_a_bench_that_stood_still_is_no_device_whose_samples_do() -> None:
    assert samples_that_stand(streams=False).verdict is Verdict.PASS
    assert samples_that_stand(streams=True).verdict is Verdict.FAIL


def state_of(pid: int) -> str:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


def test_what_is_frozen_goes_on_when_the_bench_is_killed() -> None:
    """It is told to end by a connection that is lost, and would never hear of that."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as frozen:
        command = [sys.executable, "-c", FREEZING, str(frozen.pid)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as freezing:
            assert freezing.stdout is not None
            assert freezing.stdout.readline() == b"frozen\n"
            eventually(lambda: state_of(frozen.pid) == "T", "it stands still")
            freezing.kill()
        try:
            eventually(lambda: state_of(frozen.pid) != "T", "it goes on")
        finally:
            frozen.kill()


def test_a_driver_that_did_not_end_well_counts_as_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its device was disabled, and not seen to stand as it was left."""

    def let_go_and_killed(door: Door, name: str, timeout: float) -> bool:
        is_off = watch.let_go(door, name, timeout)
        os.kill(host.pid(Process.DRIVER), signal.SIGKILL)
        return is_off

    monkeypatch.setattr(watch, "HOLD_TIME", 0.0)
    monkeypatch.setattr(conductor, "let_go", let_go_and_killed)
    order = DeviceOrder("gantry", "loopback", {}, False, {}, None)
    lost: list[str] = []
    with (
        tempfile.TemporaryDirectory() as doors,
        conductor.hosted(order, Path(doors), tmp_path, (), lambda: lost.append("it")) as host,
    ):
        host.about()
        host.is_touched = True
    assert lost == ["it"]
