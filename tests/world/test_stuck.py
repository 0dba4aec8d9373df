"""What goes wrong in a world is a finding that names who and where."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from crtk_drivers.testing.world import Finding, Host, WorldError, run

SEEDS = range(1, 6)

pytestmark = pytest.mark.sweep(1)


@pytest.fixture(scope="module")
def host() -> Iterator[Host]:
    with Host(Path(__file__).parent / "stuck_programs.py") as found:
        yield found


def found(host: Host, scenario: str, seed: int = 1, **options: float) -> Finding:
    outcome = host.run(scenario, seed, **options)
    assert len(outcome.findings) == 1, outcome.told()
    assert outcome.over == outcome.findings[0].kind
    assert outcome.result is None
    return outcome.findings[0]


@pytest.mark.parametrize("seed", SEEDS)
def test_deadlock_names_both_threads(host: Host, seed: int) -> None:
    finding = found(host, "two_locks", seed)
    assert finding.kind == "deadlock"
    circle = finding.text.splitlines()[0]
    assert sorted(circle.split(" waits for ")[:2]) == ["main/left", "main/right"]
    assert "stuck_programs.py" in finding.text


@pytest.mark.parametrize("seed", SEEDS)
def test_deadlock_of_three_is_found(host: Host, seed: int) -> None:
    finding = found(host, "three_rlocks", seed)
    assert finding.kind == "deadlock"
    assert all(f"main/thread {number}" in finding.text for number in range(3))


@pytest.mark.parametrize("seed", SEEDS)
def test_condition_is_no_deadlock(host: Host, seed: int) -> None:
    outcome = host.run("no_deadlock", seed)
    outcome.check()
    assert outcome.result == 60


def test_waiting_for_ever_names_each_place(host: Host) -> None:
    finding = found(host, "nobody_comes")
    assert finding.kind == "all wait for ever"
    lines = dict(line.split(": ", 1) for line in finding.text.splitlines())
    assert "wait_in_a_thread" in lines["main/reader"]
    assert "_wait_for_nobody" in lines["main/main"]


def test_horizon_is_a_finding(host: Host) -> None:
    finding = found(host, "not_done", horizon=7.5)
    assert finding.kind == "not done at the horizon"
    assert 6.0 < finding.at <= 7.5
    assert "not_done" in finding.text


def test_error_in_a_thread_is_a_finding(host: Host) -> None:
    finding = found(host, "error_in_a_thread")
    assert finding.kind == "a thread died"
    assert "main/looker" in finding.text
    assert "KeyError: 'missing'" in finding.text


def test_error_in_a_child_is_a_finding(host: Host) -> None:
    finding = found(host, "error_in_a_child")
    assert finding.kind == "a process died"
    assert "LookupError: on purpose" in finding.text


@pytest.mark.parametrize("seed", SEEDS)
def test_killed_child_never_runs_again(host: Host, seed: int) -> None:
    outcome = host.run("killed_child", seed)
    outcome.check()
    assert outcome.result == [True, True, True, -9]


@pytest.mark.parametrize(
    ("scenario", "kind", "said"),
    [
        ("leave", "a process died", "sys.exit(3)"),
        ("kill_itself", "all wait for ever", "no thread is left"),
        ("read_input", "a thread died", "EOFError"),
    ],
)
def test_early_end_says_how(host: Host, scenario: str, kind: str, said: str) -> None:
    finding = found(host, scenario)
    assert finding.kind == kind
    assert said in finding.text


@pytest.mark.parametrize(
    ("scenario", "said"), [("return_a_set", "a set: return what JSON"), ("nobody", "no function")]
)
def test_wrong_scenario_says_why(host: Host, scenario: str, said: str) -> None:
    with pytest.raises(WorldError, match=said):
        host.run(scenario, 1)


def test_unknown_option_is_refused(host: Host) -> None:
    said = "a world has no option wlid; it has wild, horizon, without"
    with pytest.raises(WorldError, match=f"^{said}$"):
        host.run("no_deadlock", 1, wlid=True)


def test_scenario_is_a_plain_function() -> None:
    for each in (lambda _: None, str.upper, "scenario", Host):
        with pytest.raises(ValueError, match="a scenario is"):
            run(each, 1)  # type: ignore[arg-type]  # what a user may give


ALONE = """
import sys, time
from pathlib import Path
from crtk_drivers.testing.world import Host
host = Host(Path(sys.argv[1]))
host.run("no_deadlock", 1)
host.ask("compute", 1)
print(flush=True)
time.sleep(60.0)
"""


def test_killed_test_leaves_no_world(tmp_path: Path) -> None:
    """The world computes for ever. Its host holds the pipe's other end, and ends with it."""
    file = Path(__file__).parent / "stuck_programs.py"
    with subprocess.Popen(
        [sys.executable, "-c", ALONE, str(file)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    ) as test:
        assert test.stdout is not None
        assert test.stderr is not None
        assert test.stdout.readline()
        test.kill()
        assert test.stderr.read() == b""  # until the last process that writes to it has ended
    assert not list(tmp_path.iterdir())


def test_closed_host_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with Host(Path(__file__).parent / "stuck_programs.py") as host:
        host.run("no_deadlock", 1)
        with pytest.raises(WorldError, match=r"it is at stuck_programs\.py:\d+ compute$"):
            host.run("compute", 1, patience=0.3)
    assert not list(tmp_path.iterdir())
