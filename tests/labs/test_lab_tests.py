"""A lab's own tests: what pytest makes of them, what is kept, what is refused. Each session is a process.

Those with a lab are forked, as the processes of the bench are; those without are started, which shows what
they import.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from textwrap import dedent
from typing import Any
from xml.etree import ElementTree

import pytest

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench import programs
from crtk_drivers.labs.bench.locks import alone
from crtk_drivers.labs.bench.results import Run, read_run
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_sim_backends.netft import SIM

ROOT = Path(__file__).parents[2]

GANTRY = 'name = "room"\n[devices.gantry]\nplugin = "loopback"\nsettings = { rate = 200 }\n'

Session = Callable[..., "subprocess.CompletedProcess[str]"]


def options(*, plugin: bool = True) -> list[str]:
    named = ["-p", "crtk_drivers.testing.lab_tests"] if plugin else []
    return ["-c", "pytest.ini", "-p", "no:cacheprovider", *named]


def started(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", *arguments]
    return subprocess.run(command, capture_output=True, text=True)


def forked(*arguments: str) -> subprocess.CompletedProcess[str]:
    with TemporaryFile() as errors:
        process = programs._start("pytest", arguments, subprocess.PIPE, errors.fileno(), ())
        with process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.close()
            said = process.stdout.read().decode()
        errors.seek(0)
        return subprocess.CompletedProcess(
            arguments, process.returncode, said, errors.read().decode()
        )


@pytest.fixture
def session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    """Write tests, run them, and return what pytest printed."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pytest.ini").write_text("[pytest]\naddopts = --strict-markers\n")
    (tmp_path / "lab.toml").write_text(GANTRY)

    def run(
        tests: str, *arguments: str, conftest: str = "", lab: bool = True, plugin: bool = True
    ) -> subprocess.CompletedProcess[str]:
        (tmp_path / "test_own.py").write_text(dedent(tests))
        (tmp_path / "conftest.py").write_text(dedent(conftest))
        own = options(plugin=plugin)
        if not lab or not plugin:
            named = ("--lab", "lab.toml", "--lab-out", "runs/one") if lab else ()
            return started(*own, *named, *arguments)
        return forked(*own, "--lab", "lab.toml", "--lab-out", "runs/one", *arguments)

    return run


def kept(folder: Path) -> Run:
    return read_run(folder / "runs" / "one")


def verdicts(run: Run) -> dict[str, tuple[Verdict, str]]:
    return {test.id.rpartition("::")[2]: (test.verdict, test.reason) for _, test in run.tests}


VERDICTS = """
import os
import pytest
from crtk_drivers.labs.bench.bed import Process

def test_passes(lab, measure):
    "The gantry is where it is. It stays there."
    before = lab.gantry.position
    lab.gantry.rest(0.5)  # in which something is recorded
    measure("lab.rest.moved", float(abs(lab.gantry.position - before).max()), "m", at_most=1e-3)

def test_fails(measure):
    measure("lab.depth.low", 3.0, "mm", at_most=2.0, because="the drawing")
    measure("lab.depth.high", 1.0, "mm", at_most=2.0)

def test_is_open(measure):
    measure("lab.depth.mean", [1.0, 2.0, 3.0], "mm", at_most=2.1)

def test_asserts(lab):
    assert lab.gantry.state == "ENABLED"

def test_only_asserts(lab):
    assert lab.gantry.offers("move_jp")

def test_doubts(measure):
    measure("lab.depth.low", 3.0, "mm", at_most=2.0)
    measure.doubt("the press was cold")

def test_is_judged_by_the_lab_file(measure):
    measure("lab.width.told", 3.0, "mm")

@pytest.mark.needs("gantry", "block")
def test_needs_what_is_there(lab):
    assert lab.features["block"] == 0.03

@pytest.mark.needs("tracker")
def test_needs_what_is_not(lab):
    raise NotImplementedError

def test_loses_its_driver(lab):
    lab.gantry.enable()
    os.kill(lab.gantry.station.host.pid(Process.DRIVER), 9)
    lab.gantry.rest(10.0)

def test_comes_after_that(lab):
    lab.gantry.enable()
"""

LAB = (
    f"{GANTRY}[features]\nblock = 0.03\ntracker = false\n"
    '[bounds."lab.width.told"]\nvalue = 2.0\nbecause = "so"\n'
)


def test_a_session_has_the_environment_of_the_lab(session: Session, tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text('environment = { MINE = "yes" }\n' + GANTRY)
    said = session("import os\ndef test_it(lab):\n    assert os.environ['MINE'] == 'yes'\n")
    assert said.returncode == 0, said.stdout


def test_a_session_tests_the_devices_of_its_machine(session: Session, tmp_path: Path) -> None:
    other = '[devices.camera]\nplugin = "of-tracking"\nmachine = "tracking"\n'
    (tmp_path / "lab.toml").write_text('machine = "control"\n' + GANTRY + other)
    tests = "def test_it(lab):\n    assert lab.gantry.state == 'DISABLED'\n"
    said = session(tests, "--lab-machine", "control")
    assert said.returncode == 0, said.stdout
    assert "left out of the lab: camera on tracking" in said.stdout
    said = session(tests, "--lab-machine", "laptop")
    assert said.returncode == 4
    assert "--lab-machine: there is no machine 'laptop' in the lab file" in said.stderr


def test_verdicts_are_those_of_the_bench_and_kept_as_such(session: Session, tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(LAB)
    said = session(VERDICTS, "-v")
    assert said.returncode == 1, said.stdout
    run = kept(tmp_path)
    assert run.complete
    found = verdicts(run)
    assert {name: verdict for name, (verdict, _) in found.items()} == {
        "test_passes": "PASS",
        "test_fails": "FAIL",
        "test_is_open": "INCONCLUSIVE",
        "test_asserts": "FAIL",
        "test_only_asserts": "PASS",
        "test_doubts": "INCONCLUSIVE",
        "test_is_judged_by_the_lab_file": "FAIL",
        "test_needs_what_is_there": "PASS",
        "test_needs_what_is_not": "SKIPPED",
        "test_loses_its_driver": "INCONCLUSIVE",
        "test_comes_after_that": "SKIPPED",
    }
    reasons = {name: reason for name, (_, reason) in found.items()}
    assert reasons["test_fails"] == "low 3 mm, at most 2 mm"
    assert reasons["test_asserts"].startswith("assert ")
    assert reasons["test_doubts"] == "the press was cold"
    assert reasons["test_is_judged_by_the_lab_file"] == "told 3 mm, at most 2 mm"
    assert reasons["test_needs_what_is_not"] == "the lab has no tracker"
    assert "the driver's process is gone" in reasons["test_loses_its_driver"]
    assert reasons["test_comes_after_that"].startswith("gantry: no more after test_own.py::test_l")
    for line, verdict in (
        ("test_passes", "PASSED"),
        ("test_fails", "FAILED"),
        ("test_is_open", "INCONCLUSIVE"),
        ("test_doubts", "INCONCLUSIVE"),
        ("test_loses_its_driver", "INCONCLUSIVE"),
        ("test_needs_what_is_not", "SKIPPED"),
    ):
        assert re.search(rf"{line} {verdict}", said.stdout), said.stdout
    assert "low 3 mm, at most 2 mm" in said.stdout
    assert "INCONCLUSIVE test_own.py::test_is_open: mean 2 mm" in said.stdout
    first = run.devices[0]
    assert (first.name, first.simulated, first.tests[0].name) == (
        "gantry",
        True,
        "The gantry is where it is. It stays there",
    )
    folder = tmp_path / "runs" / "one"
    assert (folder / first.tests[0].recording).stat().st_size > 1000
    assert "low 3 mm, at most 2 mm" in (folder / "report.html").read_text()
    suites = ElementTree.parse(folder / "junit.xml").getroot()
    assert [suite.get("name") for suite in suites] == ["gantry", "room", "bench"]
    index = (tmp_path / "runs" / "index.jsonl").read_text()
    assert '"id": "lab.rest.moved"' in index


MOVES = """
def test_moves(lab, measure):
    gantry = lab.gantry
    gantry.enable()
    home = gantry.setpoint
    gantry.move_to(home + 0.01)
    assert gantry.state == "ENABLED"
    joints = gantry.trace().joints
    measure("lab.way.length", float(abs(joints.position[-1] - home).max()), "m", at_least=0.007)

def test_begins_disabled(lab):
    assert lab.gantry.state == "DISABLED"
"""


def test_a_device_is_left_disabled_after_each_test_that_moved_it(
    session: Session, tmp_path: Path
) -> None:
    said = session(MOVES)
    assert said.returncode == 0, said.stdout
    assert {verdict for verdict, _ in verdicts(kept(tmp_path)).values()} == {Verdict.PASS}


def test_what_is_not_decided_may_be_no_failure(session: Session, tmp_path: Path) -> None:
    tests = "def test_open(measure):\n    measure('lab.a.b', [1.0, 3.0], at_most=2.0)\n"
    assert session(tests).returncode == 1
    (tmp_path / "runs" / "one").rename(tmp_path / "runs" / "before")
    assert session(tests, "--inconclusive-ok").returncode == 0


@pytest.mark.parametrize(
    ("tests", "told"),
    [
        ("measure('depth', 1.0)", "'depth' is no id"),
        ("measure('lab.a.b', 1.0); measure('lab.a.b', 1.0)", "measured twice"),
        ("measure('lab.a.b', float('nan'))", "give None for what could not be measured"),
        ("measure('lab.a.b', 1.0, at_most=1.0, at_least=1.0)", "one of them"),
    ],
)
def test_a_figure_that_is_none_is_refused(
    session: Session, tmp_path: Path, tests: str, told: str
) -> None:
    said = session(f"def test_one(measure):\n    {tests}\n")
    assert said.returncode == 1
    assert told in said.stdout
    ((verdict, reason),) = verdicts(kept(tmp_path)).values()
    assert verdict is Verdict.INCONCLUSIVE
    assert reason.startswith("the test itself broke: ValueError")


TWO = """
import pytest

def test_one(lab):
    pass

def test_two(lab):
    pass
"""

REVERSED = "def pytest_collection_modifyitems(items):\n    items.reverse()\n"

TWICE = """
from _pytest.runner import runtestprotocol

def pytest_runtest_protocol(item, nextitem):
    for _ in range(2):
        runtestprotocol(item, nextitem=nextitem)
    return True
"""


@pytest.mark.parametrize(
    ("tests", "arguments", "conftest", "told"),
    [
        (TWO, ("-n", "2"), "", "two tests at once (pytest-xdist)"),
        (TWO, (), REVERSED, "the tests of a lab keep their order"),
        (TWO.replace("def test_two", "@pytest.mark.flaky\ndef test_two"), (), "", "flaky"),
        (TWO, (), TWICE, "it would run again"),
        (TWO, ("--lab", "other.toml"), "", "other.toml"),
    ],
    ids=["parallel", "reordered", "rerun by a mark", "rerun", "no lab"],
)
def test_what_repeats_or_mixes_motions_is_refused(
    session: Session, tests: str, arguments: tuple[str, ...], conftest: str, told: str
) -> None:
    markers = 'def pytest_configure(config):\n    config.addinivalue_line("markers", "flaky")\n'
    said = session(tests, *arguments, conftest=markers + conftest)
    assert said.returncode != 0
    assert told in said.stdout + said.stderr
    assert "Traceback" not in said.stderr


def test_one_at_a_time(session: Session, tmp_path: Path) -> None:
    with alone(load_lab(tmp_path / "lab.toml")):
        said = session(TWO)
    assert said.returncode == 4
    assert "room is being tested by process" in said.stdout
    assert not (tmp_path / "runs").exists()


READS = """
def test_reads(lab):
    assert lab.ft.glance().connected

def test_commands(lab):
    lab.ft.enable()
    raise NotImplementedError

def test_asks_for_a_service(lab):
    lab.ft.service("set_bias")
    raise NotImplementedError
"""


@contextmanager
def hardware(folder: Path, power_off: str = '["touch", "off"]') -> Iterator[None]:
    """A sensor that the lab file does not call simulated."""
    with SIM.spawn() as sim:
        ports = ", ".join(f"{name}_port = {sim.ports[name]}" for name in ("rdt", "tcp", "http"))
        (folder / "lab.toml").write_text(
            f'[devices.ft]\nplugin = "ati-netft"\npower_off = {power_off}\n'
            f'settings = {{ host = "{sim.host}", {ports} }}\n'
        )
        yield


def test_hardware_is_only_read_unless_it_may_move(session: Session, tmp_path: Path) -> None:
    with hardware(tmp_path):
        said = session(READS)
    assert said.returncode == 0, said.stdout
    assert verdicts(kept(tmp_path)) == {
        "test_reads": (Verdict.PASS, ""),
        "test_commands": (
            Verdict.SKIPPED,
            "ft: enable: needs --may-move: it enables the device",
        ),
        "test_asks_for_a_service": (
            Verdict.SKIPPED,
            "ft: set_bias: needs --may-move: it enables the device",
        ),
    }
    assert not kept(tmp_path).devices[0].simulated
    assert not (tmp_path / "off").exists()


HOMES = """
def test_homes(lab):
    lab.ft.command_state("home")
    raise NotImplementedError
"""


def test_hardware_is_not_homed(session: Session, tmp_path: Path) -> None:
    with hardware(tmp_path):
        session(HOMES, "--may-move")
    ((_, reason),) = verdicts(kept(tmp_path)).values()
    assert reason == "ft: home: moves as it likes, which is not done to hardware"


LEAVES = """
import pytest
from crtk_drivers.labs.bench.bed import Broken

@pytest.fixture
def arm(lab):
    lab.gantry.enable()
    yield lab.gantry
    raise Broken("it did not get home")

def test_one(arm):
    pass

def test_two(lab):
    lab.gantry.enable()
"""


def test_a_device_that_broke_when_a_test_was_left_is_not_used_any_more(
    session: Session, tmp_path: Path
) -> None:
    session(LEAVES)
    found = verdicts(kept(tmp_path))
    assert found["test_one"] == (
        Verdict.INCONCLUSIVE,
        "what it leaves: Broken: it did not get home",
    )
    assert found["test_two"][0] is Verdict.SKIPPED
    assert "no more after" in found["test_two"][1]


LOST = """
import os
from crtk_drivers.labs.bench.bed import Process

def test_loses_it(lab):
    lab.ft.enable()
    os.kill(lab.ft.station.host.pid(Process.DRIVER), 9)
    lab.ft.rest(10.0)
"""


def test_what_was_lost_in_the_midst_of_a_test_has_its_power_taken_away(
    session: Session, tmp_path: Path
) -> None:
    with hardware(tmp_path):
        assert session(LOST).returncode == 1
        assert not (tmp_path / "off").exists(), "it was not commanded"
        (tmp_path / "runs" / "one").rename(tmp_path / "runs" / "before")
        assert session(LOST, "--may-move").returncode == 1
    assert verdicts(kept(tmp_path))["test_loses_it"][0] is Verdict.INCONCLUSIVE
    assert (tmp_path / "off").exists()


HANGS = """
import os, signal, time
from pathlib import Path
from crtk_drivers.labs.bench.bed import Process

def test_hangs(lab):
    lab.ft.enable()
    driver = lab.ft.station.host.pid(Process.DRIVER)
    os.kill(driver, signal.SIGSTOP)
    try:
        end = time.monotonic() + 40.0
        while not Path("off").exists():
            assert time.monotonic() < end, "its power was not taken"
            time.sleep(0.01)
    finally:
        os.kill(driver, signal.SIGCONT)
"""


def test_of_what_cannot_be_held_the_power_is_taken_at_once(
    session: Session, tmp_path: Path
) -> None:
    with hardware(tmp_path, power_off='["mkdir", "off"]'):
        said = session(HANGS, "--may-move")
    assert said.returncode == 1, "what the watch has stopped is open"
    found = verdicts(kept(tmp_path))["test_hangs"]
    assert found == (Verdict.INCONCLUSIVE, "glance: no answer in 2 s")


UNSEEN = """
from crtk_drivers.labs.bench import watch

def test_is_not_seen(lab):
    watch.BLIND = 0.5
    gantry = lab.gantry
    gantry.enable()
    gantry._watch.look = lambda: None
    gantry.rest(2.0)

def test_comes_after_that(lab):
    lab.gantry.enable()
"""


def test_a_device_at_which_nobody_looked_is_not_used_any_more(
    session: Session, tmp_path: Path
) -> None:
    session(UNSEEN)
    (unseen, after) = verdicts(kept(tmp_path)).values()
    assert unseen[0] is Verdict.INCONCLUSIVE
    assert unseen[1].startswith("the watch has not looked for")
    assert after[0] is Verdict.SKIPPED
    assert after[1].startswith("gantry: no more after test_own.py::test_is_not_seen")


ENDLESS = """
def test_moves_for_long(lab):
    gantry = lab.gantry
    gantry.enable()
    home = gantry.setpoint
    gantry.stream("servo_jp", lambda t: JointState(position=home), 60.0)
"""


SLEEPS = """
import os, signal, time

def test_sleeps(lab):
    lab.ft.enable()
    os.kill(os.getpid(), signal.SIGTSTP)
    time.sleep(60.0)
"""


def test_ctrl_z_ends_what_may_move_hardware(session: Session, tmp_path: Path) -> None:
    with hardware(tmp_path):
        said = session(SLEEPS, "--may-move")
    assert said.returncode == pytest.ExitCode.INTERRUPTED, said.stdout
    assert kept(tmp_path).ended_by == "stopped by the operator"


def test_ctrl_c_holds_and_keeps_what_there_was(session: Session, tmp_path: Path) -> None:
    (tmp_path / "test_own.py").write_text(
        f"from crtk_drivers.samples import JointState\n{TWO}{ENDLESS}"
    )
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "pytest", *options()),
            *("--lab", "lab.toml", "--lab-out", "runs/one"),
        ],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        folder = tmp_path / "runs" / "one" / "data"
        while not any(path.stat().st_size > 300_000 for path in folder.glob("*.mcap")):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        said, _ = process.communicate(timeout=90.0)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == pytest.ExitCode.INTERRUPTED, said
    run = kept(tmp_path)
    assert (run.complete, run.ended_by) == (False, "stopped by the operator")
    assert verdicts(run)["test_moves_for_long"][0] is Verdict.INCONCLUSIVE
    log = (tmp_path / "runs" / "one" / "gantry.log").read_text()
    assert "Traceback" not in log
    assert "the bench is gone" not in log, "it was left, not lost"


INACTIVE = """
import sys
import pytest

def test_nothing_is_imported():
    loaded = {name for name in sys.modules if name.startswith("crtk_drivers.")}
    worlds = "testing.world", "testing.world.hosts", "testing.world.hosts.pytest_worlds"
    assert loaded == {f"crtk_drivers.{name}" for name in ("testing", "testing.lab_tests", *worlds)}

@pytest.mark.needs("nothing")
def test_nothing_is_skipped():
    pass

def test_a_fixture_of_this_name_may_be_the_users(request):
    with pytest.raises(pytest.FixtureLookupError):
        request.getfixturevalue("lab")
"""


def test_without_a_lab_it_does_nothing(session: Session, tmp_path: Path) -> None:
    said = session(INACTIVE, lab=False)
    assert said.returncode == 0, said.stdout
    assert not (tmp_path / "runs").exists()


OWN_OPTION = """
def pytest_addoption(parser):
    parser.addoption("--lab")
"""

OWN_LAB = """
def test_it_is_mine(pytestconfig):
    assert pytestconfig.getoption("--lab") == "chemistry"
"""


def test_an_option_of_this_name_stays_the_users(session: Session) -> None:
    said = session(OWN_LAB, "--lab=chemistry", conftest=OWN_OPTION, lab=False)
    assert said.returncode == 0, said.stdout + said.stderr


def test_the_entry_point_brings_it(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an environment of its own: this one may have been set up before there was an entry point."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    points = project["entry-points"]["pytest11"]
    site = tmp_path / "site" / "fresh-1.dist-info"
    site.mkdir(parents=True)
    (site / "METADATA").write_text("Metadata-Version: 2.1\nName: fresh\nVersion: 1\n")
    lines = "".join(f"{name} = {value}\n" for name, value in points.items())
    (site / "entry_points.txt").write_text(f"[pytest11]\n{lines}")
    monkeypatch.setenv("PYTHONPATH", str(site.parent), prepend=":")
    for named in (False, True):  # with and without -p beside it
        said = session(INACTIVE, lab=False, plugin=named)
        assert said.returncode == 0, said.stdout + said.stderr
    assert session(TWO, plugin=False).returncode == 0


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_example_runs(tmp_path: Path) -> None:
    folder = ROOT / "examples" / "lab_tests"
    said = subprocess.run(
        [
            *(sys.executable, "-m", "pytest", "-p", "crtk_drivers.testing.lab_tests"),
            *("-p", "no:cacheprovider", str(folder)),  # whose pytest.ini makes it a root of its own
            *("--lab", str(folder / "lab.toml"), "--lab-out", str(tmp_path / "run")),
            "--inconclusive-ok",
        ],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert said.returncode == 0, said.stdout
    run = read_run(tmp_path / "run")
    assert len(list(run.tests)) == 4
    assert run.verdict in (Verdict.PASS, Verdict.INCONCLUSIVE)
