"""The bench over devices that exist in memory: what it finds, keeps and refuses."""

from __future__ import annotations

import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from html import escape
from multiprocessing.connection import Connection, Listener, Pipe
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.config import BoxConfig
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import conductor, host, report
from crtk_drivers.labs.bench import run as run_module
from crtk_drivers.labs.bench.acquisition import Safety, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, lacking, unguarded
from crtk_drivers.labs.bench.bed import Bed, Broken, Tripped
from crtk_drivers.labs.bench.calls import About, Glance, HostOrder
from crtk_drivers.labs.bench.catalogue import TESTS, chosen
from crtk_drivers.labs.bench.conducting import RunOrder
from crtk_drivers.labs.bench.door import Door, DoorClosed, Refused
from crtk_drivers.labs.bench.locks import alone
from crtk_drivers.labs.bench.motions import SINES
from crtk_drivers.labs.bench.results import Run, read_run, write_run
from crtk_drivers.labs.bench.run import judged_again, run_bench
from crtk_drivers.labs.bench.watch import Watch, judged, let_go
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.recording import Recording
from crtk_drivers.samples import JointState, Pose, Stamp, vector
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing.loopback import LoopbackDevice
from rigs import stepped_bed
from rigs.processes import children_of, has_ended, process_of
from rigs.waiting import LONG, eventually

ABOUT = About(
    name="arm",
    capabilities=LoopbackDevice().capabilities,
    commands=("servo_jp", "move_jp", "hold", "measured_js", "setpoint_js"),
    silence=0.1,
    sample_timeout=0.5,
    stale_after=0.05,
    max_step=0.05,
    has_kinematics=True,
    readings={"serial": "7"},
    is_homed=True,
)

GANTRY = '[devices.gantry]\nplugin = "loopback"\nsettings = { rate = 200 }\n'
CARRIED = 'on = "gantry"\n'
ANY_CLOCK = '[bounds."sampling.stamps.slope"]\nvalue = 1e6\nbecause = "others have the processor"\n'
"""How fast a simulated clock is, for a lab file: in three seconds of a busy machine that cannot be told."""
SKIPPED = "F2"
"""Of a gantry, which has no bias."""

Bench = Callable[..., Run]


def carried_out(
    folder: Path,
    lab: str,
    *only: str,
    stop: StopRequest | None = None,
    progress: Callable[..., None] = lambda *_: None,
    out: str = "run",
) -> Run:
    path = folder / "lab.toml"
    path.write_text(lab)
    options = BenchOptions(Suite.QUICK, only, may_move=False, out=folder / "runs" / out)
    return run_bench(load_lab(path), options, progress, stop or StopRequest())


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return partial(carried_out, tmp_path)


Told = list[tuple[str, str, Verdict | None]]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Told]:
    """A run that passed: its folder, and what was told of it."""
    path = tmp_path_factory.mktemp("bench")
    told: Told = []
    carried_out(path, GANTRY, "T3", "S8", progress=lambda *what: told.append(what[:3]))
    return path / "runs" / "run", told


@pytest.fixture
def folder(sound: tuple[Path, Told]) -> Path:
    return sound[0]


@pytest.fixture
def run(folder: Path) -> Run:
    return read_run(folder)


def test_ids_are_the_same_for_ever_and_each_is_there_once() -> None:
    ids = [test.id for test in TESTS]
    assert len(ids) == len(set(ids))
    assert {"T1", "T2", "T3", "T4", "J1", "M1", "M2", "S1", "S2", "S8"} <= set(ids)
    quantities = [quantity.id for test in TESTS for quantity in test.quantities]
    assert len(quantities) == len(set(quantities))
    for test in TESTS:
        assert all(quantity.id.startswith(f"{test.group}.") for quantity in test.quantities), (
            test.id
        )
    safeties = [test.acquisition.safety for test in TESTS]
    assert safeties == sorted(safeties), "what reads comes before what moves"


def test_a_suite_holds_those_before_it() -> None:
    sizes = [len(chosen(suite)) for suite in Suite]
    assert sizes == sorted(sizes)
    assert all(test.acquisition.safety is Safety.READ for test in chosen(Suite.REST))
    with pytest.raises(ConfigError, match="no test 'T99'"):
        chosen(Suite.QUICK, ["T99"])


def test_a_sound_device_passes_and_everything_is_kept(run: Run, sound: tuple[Path, Told]) -> None:
    folder, told = sound
    assert {test.id: test.verdict for _, test in run.tests} == {"T3": "PASS", "S8": "PASS"}
    assert run.complete
    assert told == [
        ("gantry", "T3", None),
        ("gantry", "T3", Verdict.PASS),
        ("gantry", "S8", None),
        ("gantry", "S8", Verdict.PASS),
    ]
    for _, test in run.tests:
        assert (folder / test.recording).stat().st_size > 1000
        assert test.measurements
        assert all(found.bound_from for found in test.measurements if found.bound is not None)


def test_the_same_recording_is_judged_again_with_the_bounds_of_the_lab_file(
    run: Run, folder: Path, tmp_path: Path
) -> None:
    (_, (_, first)) = run.tests
    assert (first.id, first.verdict) == ("S8", Verdict.PASS)
    lab = tmp_path / "strict.toml"
    bound = '[bounds."staying.refusals.moved"]\nvalue = -1.0\nbecause = "nothing is that still"\n'
    lab.write_text(GANTRY + bound)
    ((_, stamps), (_, again)) = judged_again(folder, lab).tests
    assert stamps.verdict is Verdict.PASS
    assert again.verdict is Verdict.FAIL
    (_, _, found) = again.measurements
    assert found.value == first.measurements[2].value
    assert found.bound_from == "the lab file: nothing is that still"


def test_a_full_disk_leaves_the_old_results(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(run, tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_run(run.model_copy(update={"lab": "other"}), tmp_path)
    assert read_run(tmp_path) == run


def test_the_report_has_what_was_found_and_loads_nothing(run: Run) -> None:
    page = report.html(run)
    assert "<script" not in page
    assert "src=" not in page
    for _, test in run.tests:
        assert test.name in page
        for found in test.measurements:
            assert escape(found.title) in page
    suites = ElementTree.fromstring(report.junit(run).encode())
    assert [suite.get("name") for suite in suites] == ["gantry", "bench"]


def test_one_that_is_not_reached_is_open_and_the_others_do_what_they_offer(bench: Bench) -> None:
    gone = '[devices.gone]\nplugin = "ati-netft"\nsettings = { host = "127.0.0.254", open_timeout = 0.2 }\n'
    there = '[devices.ft]\nplugin = "ati-netft"\nsim = true\n'
    run = bench(f"{gone}{there}{ANY_CLOCK}", "M1", "T3")
    verdicts = {device.name: device.verdict for device in run.devices}
    assert verdicts == {"gone": Verdict.INCONCLUSIVE, "ft": Verdict.PASS}
    assert run.devices[0].trouble
    tests = {test.id: test for test in run.devices[1].tests}
    assert tests["T3"].verdict is Verdict.PASS
    assert tests["M1"].verdict is Verdict.SKIPPED
    assert tests["M1"].reason == "the device does not offer measured_js"


def test_one_bench_at_a_time(bench: Bench, tmp_path: Path) -> None:
    def progress(device: str, test: str, verdict: Verdict | None, reason: str) -> None:
        with pytest.raises(ConfigError, match=f"being tested by process {os.getpid()}"):
            bench(GANTRY, SKIPPED, out="second")

    assert bench(GANTRY, SKIPPED, progress=progress).verdict is Verdict.SKIPPED
    assert not (tmp_path / "runs" / "second").exists()
    assert bench(GANTRY, SKIPPED, out="third").complete, "the lock ends with the run"


@pytest.mark.slow
def test_simulated_devices_are_tested_at_the_same_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What one carries is tested with it, one after the other."""
    ft = '[devices.{name}]\nplugin = "ati-netft"\nsim = true\n{more}'
    path = tmp_path / "lab.toml"
    other = ft.format(name="other", more="")
    path.write_text(f"{GANTRY}{ft.format(name='ft', more=CARRIED)}{other}{ANY_CLOCK}")
    started: list[list[str]] = []
    at_first: list[int] = []

    def start(order: RunOrder) -> Any:
        started.append([device.name for device in order.devices])
        return conductor.start_conductor(order)

    monkeypatch.setattr(run_module, "start_conductor", start)
    options = BenchOptions(Suite.QUICK, ("T3",), may_move=False, out=tmp_path / "run", at_once=2)
    run = run_bench(
        load_lab(path), options, lambda *_: at_first.append(len(started)), StopRequest()
    )
    assert started == [["gantry", "ft"], ["other"]]
    assert at_first[0] == 2, "before anything was told of the first"
    assert {device.name: device.verdict for device in run.devices} == dict.fromkeys(
        ("gantry", "ft", "other"), Verdict.PASS
    )


def test_hardware_is_not_tested_at_the_same_time_as_anything(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text('[devices.arm]\nplugin = "ur"\nsettings = { host = "192.168.1.9" }\n')
    options = BenchOptions(Suite.QUICK, (), may_move=True, out=tmp_path / "run", at_once=2)
    with pytest.raises(ConfigError, match=r"one device after the other, and arm is not simulated"):
        run_bench(load_lab(path), options, lambda *_: None, StopRequest())
    assert not (tmp_path / "run").exists()


def test_nothing_is_overwritten(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "runs" / "run").mkdir(parents=True)
    with pytest.raises(ConfigError, match="is there already"):
        bench(GANTRY, "T3")


def test_stopped_in_a_motion_it_holds_and_keeps_what_it_had(bench: Bench, tmp_path: Path) -> None:
    stop = StopRequest()

    def progress(device: str, test: str, verdict: Verdict | None, reason: str) -> None:
        if test == "M2" and verdict is None:
            stop.set()

    run = bench(GANTRY, "S8", "M2", stop=stop, progress=progress)
    assert not run.complete
    assert run.ended_by == "stopped by the operator"
    verdicts = {test.id: (test.verdict, test.reason) for _, test in run.tests}
    assert verdicts["S8"][0] is Verdict.PASS
    assert verdicts["M2"] == (Verdict.INCONCLUSIVE, "the run was stopped")
    assert report.exit_code(run) == 4
    log = (tmp_path / "runs" / "run" / "log.txt").read_text()
    assert "stopped by the watch: the run was stopped" in log
    (box,) = (tmp_path / "runs" / "run" / "data").glob("*.black_box.mcap")
    assert Recording(box).is_complete


@pytest.mark.usefixtures("cold_bench")
def test_when_the_conductor_dies_the_results_so_far_are_kept(bench: Bench) -> None:
    def progress(device: str, test: str, verdict: Verdict | None, reason: str) -> None:
        if test == "M2" and verdict is None:
            os.kill(process_of("labs.bench.conductor"), signal.SIGKILL)

    run = bench(GANTRY, "S8", "M2", progress=progress)
    assert (run.complete, run.ended_by) == (False, "the conductor's process died")
    verdicts = {test.id: test.verdict for _, test in run.tests}
    assert verdicts == {"S8": Verdict.PASS, "M2": Verdict.SKIPPED}


@pytest.mark.usefixtures("cold_bench")
def test_of_a_driver_that_hangs_in_motion_the_power_is_taken_at_once(
    bench: Bench, tmp_path: Path
) -> None:
    """It can be neither held nor disabled: nobody knows whether it stands. It goes on when that is done."""
    off, recording = tmp_path / "off", tmp_path / "runs" / "run" / "data" / "gantry-sines.mcap"

    def hang() -> None:
        eventually(lambda: recording.exists() and recording.stat().st_size > 50_000)
        driver = process_of("labs.bench.host")
        os.kill(driver, signal.SIGSTOP)
        try:
            eventually(off.exists)
        finally:
            os.kill(driver, signal.SIGCONT)

    hanging = threading.Thread(target=hang)
    hanging.start()
    run = bench(f'{GANTRY}power_off = ["mkdir", "{off}"]\n', "M5")
    hanging.join()
    ((_, test),) = run.tests
    assert test.verdict is Verdict.INCONCLUSIVE
    assert "no answer in 2 s" in test.reason


def test_a_driver_to_which_no_bench_comes_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(host, "FIRST_CONNECTION", 0.2)
    plugin = plugins.device("loopback")
    config = plugin.config()
    order = HostOrder("loopback", config, str(tmp_path / "door"), b"key")
    host.Host(Session(plugin, config), order).serve(StopRequest())


def test_what_real_devices_must_pass_comes_before_they_go_far(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text('[devices.arm]\nplugin = "ur"\nsettings = { host = "192.168.1.9" }\n')
    far, near = (next(test for test in TESTS if test.id == each) for each in ("S9", "M2"))
    arm = load_lab(path).devices["arm"]
    assert "needs S8, S1 in the same run" in unguarded(far, arm, {"S9", "M1"})
    assert unguarded(far, arm, {"S9", "M1", "S8", "S1"}) == ""
    assert unguarded(near, arm, {"M2"}) == ""
    assert unguarded(far, load_lab(path, sim=True).devices["arm"], {"S9"}) == ""


def test_the_watch_tells_of_what_does_not_answer_as_it_is_to_be_held() -> None:
    class Closed(Door):
        def __init__(self) -> None:
            """It leads nowhere."""

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            raise DoorClosed(f"{name}: no answer")

    lost: list[str] = []
    watch = Watch(Closed(), ABOUT, None, StopRequest(), partial(lost.append, "arm"))
    watch.trip("it moves at 9.00")
    assert lost == ["arm"]


def test_the_reason_of_the_watch_wins_over_a_later_refusal() -> None:
    """A driver that goes on, as its power was taken, refuses what waited."""

    class Hanging(Door):
        def __init__(self) -> None:
            """It leads to a driver that stands still until it was to be held."""

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            if name == "submit":
                raise Refused("servo_jp: its stamp is 2.0 s old", "TOO_OLD")
            raise DoorClosed(f"{name}: no answer in 2 s")

        @override
        def close(self) -> None:
            """It holds nothing."""

    def refused(bed: Bed) -> None:
        eventually(lambda: watch.tripped)
        door.submit("servo_jp")

    door = Hanging()
    watch = Watch(door, ABOUT, None, StopRequest())
    bed = Bed("arm", ABOUT, door, watch, 1.0)
    watch.start()
    with pytest.raises(Tripped, match="glance: no answer in 2 s"):
        conductor.carry_out(replace(SINES, run=refused), bed, watch)
    watch.close()


def test_an_answer_that_nobody_waited_for_is_not_taken_for_the_next(tmp_path: Path) -> None:
    """Ctrl-C may come between a question and its answer; what is asked then is to hold and disable."""
    path = tmp_path / "door"

    def answer() -> None:
        with listener.accept() as connection:
            number, _ = connection.recv()
            connection.send((number - 1, "to what was asked before"))
            connection.send((number, "held"))

    with Listener(str(path), "AF_UNIX", authkey=b"key") as listener:
        answering = threading.Thread(target=answer)
        answering.start()
        with Door(str(path), b"key", LONG) as door:
            assert door.call("hold", within=LONG) == "held"
        answering.join()


@pytest.mark.parametrize(
    ("state", "connected", "is_off"),
    [("DISABLED", True, True), ("DISABLED", False, False), ("FAULT", True, False)],
)
def test_what_is_not_seen_without_power_is_not_believed_to_be(
    state: str, connected: bool, is_off: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("crtk_drivers.labs.bench.watch.HOLD_TIME", 0.0)

    class Left(Door):
        def __init__(self) -> None:
            """It leads to a device that ends in a state, whatever it is told."""

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            status = Status(OperatingState(state))
            return replace(seen(), status=status, connected=connected)

    assert let_go(Left(), "arm", 1.0) is is_off


def test_what_cannot_be_looked_at_is_not_believed_to_be_without_power() -> None:
    class Failing(Door):
        def __init__(self) -> None:
            """It leads to a driver in which something breaks."""

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            raise Refused("internal error", "")

    assert not let_go(Failing(), "arm", 1.0)


@pytest.mark.parametrize("refuses", [True, False])
def test_the_watch_tells_of_what_keeps_its_power_when_it_is_disabled(refuses: bool) -> None:
    class Powered(Door):
        def __init__(self) -> None:
            """It leads to a device that nothing disables."""

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            if name != "glance" and refuses:
                raise Refused("it is busy", "transition_running")
            return seen()

    lost: list[str] = []
    watch = Watch(Powered(), ABOUT, None, StopRequest(), partial(lost.append, "arm"))
    watch.trip("it moves at 9.00")
    assert lost == ["arm"]


def test_a_move_that_is_refused_on_its_way_has_not_arrived() -> None:
    class Refusing(Door):
        def __init__(self) -> None:
            """It leads to a device that refuses a move when that is to begin."""
            self.refused = 0

        @override
        def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
            self.refused += name == "submit"
            if name == "health":
                counts = {"move_jp: unsupported": self.refused}
                return Health(refusals=counts, last_refusal="it sleeps")
            return seen()

    door = Refusing()
    bed = Bed("arm", ABOUT, door, Watch(door, ABOUT, None, StopRequest()), 1.0)
    with pytest.raises(Broken, match="a move was refused: it sleeps"):
        bed.move_to(vector((0.2, 0.0, 0.0, 0.0)))


def seen(**values: Any) -> Glance:
    sound = {
        "measured_js": JointState(vector((0.1, 0.0, 0.0, 0.0)), vector((0.0,) * 4)),
        "measured_cp": Pose(vector((0.1, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0))),
    }
    told = {name: (value, Stamp(1, 0.0)) for name, value in (sound | values).items() if value}
    return Glance(Status(OperatingState.ENABLED), True, 0.0, told, 0, 0.0)


@pytest.mark.parametrize(
    ("values", "wrong"),
    [
        ({}, ""),
        ({"measured_js": None}, "it tells no joints"),
        (
            {"measured_js": JointState(vector((0.0,) * 4), vector((math.nan, 0.0, 0.0, 0.0)))},
            "moves at nan",
        ),
        ({"measured_cp": None}, "does not tell where its tool is"),
        (
            {"measured_cp": Pose(vector((math.nan, 0.0, 0.0)), vector((0.0, 0.0, 0.0, 1.0)))},
            "outside of its space",
        ),
    ],
)
def test_the_watch_stops_what_it_cannot_see(values: dict[str, Any], wrong: str) -> None:
    about = replace(ABOUT, commands=("measured_js", "measured_cp"))
    box = BoxConfig(lower=(-1.0, -1.0, -1.0), upper=(1.0, 1.0, 1.0))
    found = judged(seen(**values), about, box)
    assert wrong in found
    assert bool(found) is bool(wrong)


@contextmanager
def in_motion(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """``crtk-driver bench`` with a gantry that is moved; it is killed within, or at the end."""
    (folder / "lab.toml").write_text(GANTRY)
    command = [sys.executable, "-m", "crtk_drivers.cli", "bench", "lab.toml", "--only", "M2"]
    parent = subprocess.Popen([*command, "--out", "run"], cwd=folder)
    try:
        recording = folder / "run" / "data" / "gantry-approaches.mcap"
        eventually(lambda: recording.exists() and recording.stat().st_size > 50_000)
        yield parent
    finally:
        parent.kill()
        parent.wait()


def wait_for_the_end_of(*processes: int) -> None:
    eventually(lambda: not any(Path(f"/proc/{each}").exists() for each in processes))


@pytest.mark.slow  # that the conductor dies is its quick brother
def test_when_whoever_started_it_is_gone_it_holds_and_everything_ends(tmp_path: Path) -> None:
    with in_motion(tmp_path) as parent:
        children = children_of(parent.pid)
        assert len(children) == 2, "a conductor and a driver"
    wait_for_the_end_of(*children)
    log = (tmp_path / "run" / "log.txt").read_text()
    assert "stopped by the watch: the run was stopped" in log
    assert not read_run(tmp_path / "run").complete


@pytest.mark.sweep(2)
@pytest.mark.parametrize("left", ["conductor", "host"])
def test_what_is_left_of_a_killed_bench_keeps_others_from_its_devices(
    left: str, tmp_path: Path
) -> None:
    with in_motion(tmp_path) as parent:
        lab = load_lab(tmp_path / "lab.toml")
        found = {
            name: process_of(f"labs.bench.{name}", parent.pid) for name in ("conductor", "host")
        }
        keeper = found.pop(left)
        os.kill(keeper, signal.SIGSTOP)
    try:
        for other in found.values():
            with suppress(ProcessLookupError):  # it has ended by itself
                os.kill(other, signal.SIGKILL)
            eventually(partial(has_ended, other))
        gone = f"was being tested by process {parent.pid}, which is gone"
        with pytest.raises(ConfigError, match=gone), alone(lab):
            pass
    finally:
        os.kill(keeper, signal.SIGCONT)
    wait_for_the_end_of(keeper)
    with alone(lab):
        pass


class InThread:
    """A conductor in this process, as `subprocess.Popen` has one."""

    returncode: int | None = None

    def __init__(self, order: RunOrder, parent: Connection) -> None:
        self._thread = threading.Thread(target=self._run, args=(order, parent))
        self._thread.start()

    def _run(self, order: RunOrder, parent: Connection) -> None:
        with parent:
            conductor.conduct(order, parent)

    def wait(self, timeout: float | None = None) -> int:
        self._thread.join(timeout)
        self.returncode = 0
        return 0


@pytest.mark.slow  # test_lab_tests.py has it quickly
def test_a_device_at_which_nobody_looked_is_not_used_any_more(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(order: RunOrder) -> tuple[InThread, Connection]:
        ours, theirs = Pipe()
        return InThread(order, theirs), ours

    monkeypatch.setattr(run_module, "start_conductor", started)
    monkeypatch.setattr(conductor, "stop_signals", lambda: nullcontext(StopRequest()))
    monkeypatch.setattr(Watch, "look", lambda _: None)
    run = bench(GANTRY, "M1", "S8", "T3")
    verdicts = {test.id: (test.verdict, test.reason) for _, test in run.tests}
    for test in ("T3", "M1"):  # after what only reads it goes on
        assert verdicts[test][0] is Verdict.INCONCLUSIVE
        assert "the watch has not looked for" in verdicts[test][1]
    assert verdicts["S8"][0] is Verdict.SKIPPED
    assert verdicts["S8"][1].startswith("no more after transitions")


def test_a_real_device_is_only_read_unless_it_is_allowed(tmp_path: Path) -> None:
    def why(test_id: str, *, may_move: bool, more: str = "", travels: str = "") -> str:
        path = tmp_path / "lab.toml"
        path.write_text(
            f'[devices.arm]\nplugin = "ur"\nsettings = {{ host = "192.168.1.9" }}\n{more}'
        )
        lab = load_lab(path)
        device = lab.devices["arm"]
        options = BenchOptions(Suite.QUICK, (), may_move, tmp_path, (travels,))
        test = next(test for test in TESTS if test.id == test_id)
        return lacking(test, ABOUT, device, options)

    space = "space = { speed = 0.2 }\n"
    assert why("T3", may_move=False) == ""
    assert "--may-move" in why("M1", may_move=False, more=space)
    assert why("M1", may_move=True) == ""
    assert "`space`" in why("M2", may_move=True)
    assert why("M2", may_move=True, more=space) == ""
    assert "`space.joints`" in why("S9", may_move=True, more=space, travels="arm")
    ranges = ", ".join(["{ lower = -0.5, upper = 0.5 }"] * 6)
    fast, slow = (f"space = {{ speed = {speed}, joints = [{ranges}] }}\n" for speed in (0.6, 0.5))
    assert "at 0.5 at most" in why("S9", may_move=True, more=fast, travels="arm")
    assert "--may-travel arm" in why("S9", may_move=True, more=slow, travels="other")
    assert "--may-move" in why("S9", may_move=False, more=slow, travels="arm")
    assert why("S9", may_move=True, more=slow, travels="arm") == ""
    assert why("M2", may_move=True, more=slow) == ""
    assert "simulators only" in why("S3", may_move=True, more=slow, travels="arm")
    other = f'{space}identity = {{ serial = "8" }}\n'
    assert why("M2", may_move=True, more=other) == (
        "it is another device than the lab file says: serial is 7, not 8"
    )
    assert why("T3", may_move=True, more=other) == ""


def test_a_name_that_may_travel_is_one_of_the_lab(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(GANTRY)
    options = BenchOptions(Suite.QUICK, ("S9",), True, tmp_path / "run", ("gentry",))
    with pytest.raises(ConfigError, match=r"no device 'gentry' that may travel.*gantry"):
        run_bench(load_lab(tmp_path / "lab.toml"), options, lambda *_: None, StopRequest())
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("test_id", ["T1", "T2", "T3", "T4"])
def test_samples_are_not_asked_of_what_measures_nothing_itself(
    test_id: str, tmp_path: Path
) -> None:
    """A tracker, for example, whose tools do."""
    path = tmp_path / "lab.toml"
    path.write_text('[devices.polaris]\nplugin = "ndi"\n')
    (test,) = chosen(Suite.FULL, [test_id])
    options = BenchOptions(Suite.FULL, (), False, tmp_path)
    device = load_lab(path, sim=True).devices["polaris"]
    blind = replace(ABOUT, capabilities=replace(ABOUT.capabilities, measured=(), modes=frozenset()))
    assert lacking(test, blind, device, options) == "the device measures nothing itself"
    assert lacking(test, ABOUT, device, options) == ""


def test_efforts_are_asked_of_those_that_measure_them(tmp_path: Path) -> None:
    whole = (Path(__file__).parents[1] / "data" / "pan_tilt.urdf").read_text()
    urdf = tmp_path / "without_masses.urdf"
    urdf.write_text(re.sub("<inertial>.*?</inertial>", "", whole, flags=re.DOTALL))
    path = tmp_path / "lab.toml"
    path.write_text('[devices.arm]\nplugin = "virtual"\n')
    (test,) = chosen(Suite.FULL, ["J5"])
    options = BenchOptions(Suite.FULL, (), False, tmp_path)
    about = stepped_bed.about("virtual", {"urdf": str(urdf)})
    why = lacking(test, about, load_lab(path).devices["arm"], options)
    assert why == "the device does not offer measured_js.effort"


def test_results_of_a_newer_version_are_refused(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"schema": "crtk_bench/99"}))
    with pytest.raises(ConfigError, match=r"crtk_bench/99.*reads crtk_bench/1"):
        read_run(tmp_path)
    (tmp_path / "run.json").write_text("{")
    with pytest.raises(ConfigError, match="is no run"):
        read_run(tmp_path)
