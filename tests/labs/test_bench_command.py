"""``crtk-driver bench`` as a user has it: in a process of its own, with what goes wrong around it."""

from __future__ import annotations

import io
import json
import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

from crtk_drivers.cli import bench_runs, main
from crtk_drivers.labs.bench.results import read_run
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import StopRequest
from crtk_sim_backends.netft import SIM
from rigs.full_disk import NO_BYTECODE, limit
from rigs.programs import COMMAND, Start
from rigs.waiting import eventually

GANTRY = '[devices.gantry]\nplugin = "loopback"\nsettings = { rate = 200 }\n'

Command = Callable[..., "subprocess.CompletedProcess[str]"]


def bench(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "crtk_drivers.cli", "bench", *arguments]


@pytest.fixture
def command(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    (tmp_path / "lab.toml").write_text(GANTRY)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        pipe = subprocess.PIPE
        with start(COMMAND, *arguments, stdout=pipe, stderr=pipe) as process:
            out, errors = process.communicate(timeout=100.0)
        return subprocess.CompletedProcess(arguments, process.returncode, out, errors)

    return run


REASON = (
    "the machine is too busy: the bench's own timer was late by 3.9 ms, at most 2.0 ms are allowed"
)


def test_drivers_under_test_have_the_environment_of_the_lab(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "lab.toml").write_text('environment = { MINE = "yes" }\n' + GANTRY)
    monkeypatch.setenv("MINE", "no")
    seen: list[str] = []

    def run(*_: object) -> None:
        seen.append(os.environ["MINE"])
        raise OSError(0, "this is all")

    monkeypatch.setattr(bench_runs, "run_bench", run)
    main(["bench", str(tmp_path / "lab.toml"), "--out", str(tmp_path / "run")])
    assert seen == ["yes"]


@pytest.mark.parametrize(("terminal", "width"), [(True, 200), (True, 80), (True, 40), (False, 40)])
def test_a_verdict_has_its_tests_name_and_whole_reason(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, width: int
) -> None:
    console = Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system=None)
    monkeypatch.setattr(bench_runs, "ERR", console)
    with bench_runs._shown(StopRequest()) as show:
        show("arm", "T1", None, "rate and loss")
        show("arm", "T1", Verdict.INCONCLUSIVE, REASON)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    words = " ".join(text.split())
    assert "arm INCONCLUSIVE T1 rate and loss" in words
    assert REASON in words
    assert "…" not in text
    if not terminal:
        assert len(text.splitlines()) == 1


def test_skipped_tests_are_named_with_their_reason(command: Command) -> None:
    """Once: neither as they are skipped, nor in the table of `show` a second time."""
    found = command("bench", "lab.toml", "--only", "S8,F2", "--out", "run")
    lines = [line for line in found.stdout.splitlines() if line.startswith("skipped: ")]
    assert len(lines) == 1, found.stdout
    assert lines[0] == "skipped: gantry F2 bias (the device does not offer bias)"
    assert command("bench", "show", "run").stdout.count("F2 ") == 1


def test_ctrl_z_ends_a_run_that_may_move_hardware(tmp_path: Path) -> None:
    with SIM.spawn() as sim:
        ports = ", ".join(f"{name}_port = {sim.ports[name]}" for name in ("rdt", "tcp", "http"))
        settings = f'host = "{sim.host}", {ports}'
        (tmp_path / "lab.toml").write_text(
            f'[devices.ft]\nplugin = "ati-netft"\nsettings = {{ {settings} }}\n'
        )
        command = bench("lab.toml", "--only", "T3", "--may-move", "--out", "run")
        process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE)
        try:
            recording = tmp_path / "run" / "data" / "ft-rest.mcap"
            eventually(
                lambda: recording.exists() or process.poll() is not None, "something is recorded"
            )
            assert process.poll() is None
            process.send_signal(signal.SIGTSTP)
            _, said = process.communicate(timeout=90.0)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 4
    assert b"Ctrl-Z ends the run as Ctrl-C does" in said
    assert read_run(tmp_path / "run").ended_by == "stopped by the operator"


@pytest.mark.slow  # test_cli.py has what tells it
def test_a_terminal_that_is_gone_ends_a_run_as_ctrl_c_does(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(GANTRY)
    ours, theirs = pty.openpty()
    command = bench("lab.toml", "--only", "S8", "--out", "run")
    process = subprocess.Popen(command, cwd=tmp_path, stderr=theirs)  # no SIGHUP, as under nohup
    os.close(theirs)
    try:
        eventually((tmp_path / "run" / "run.json").exists, "it runs")
        os.close(ours)
        process.wait(50.0)
    finally:
        process.kill()
        process.wait()
    assert read_run(tmp_path / "run").ended_by == "stopped by the operator"


@pytest.mark.slow  # test_bench.py has a full disk
def test_a_disk_that_fills_up_is_told_and_passes_nothing(tmp_path: Path) -> None:
    (tmp_path / "lab.toml").write_text(GANTRY)
    found = subprocess.run(
        bench("lab.toml", "--only", "S8", "--out", "run"),
        cwd=tmp_path,
        capture_output=True,
        text=True,
        preexec_fn=partial(limit, 3000),
        env=NO_BYTECODE,
    )
    assert found.returncode == 4, found.stderr
    assert "results cannot be written: File too large" in found.stderr
    assert "INCONCLUSIVE" in found.stderr
    assert "Traceback" not in found.stderr
    assert "Report" not in found.stdout, "half a report is none"
    assert "Traceback" not in (tmp_path / "run" / "log.txt").read_text()


def test_a_run_of_a_newer_version_is_told(command: Command, tmp_path: Path) -> None:
    (tmp_path / "new").mkdir()
    (tmp_path / "new" / "run.json").write_text(json.dumps({"schema": "crtk_bench/99"}))
    for arguments in (("show", "new"), ("again", "new"), ("baseline", "new")):
        found = command("bench", *arguments)
        assert found.returncode == 2
        assert "was written as crtk_bench/99" in " ".join(found.stderr.split())
        assert "Traceback" not in found.stderr
    against = command("bench", "lab.toml", "--against", "new")
    assert against.returncode == 2
    assert not (tmp_path / "runs").exists(), "nothing was begun"


@pytest.mark.slow
def test_what_is_compared_with_the_baseline(command: Command, tmp_path: Path) -> None:
    options = ("bench", "lab.toml", "--only", "S8")
    assert command(*options, "--out", "runs/one").returncode == 0
    made = command("bench", "baseline", "runs/one")
    assert made.returncode == 0
    assert made.stdout.startswith("gantry, simulated: PASS")
    assert command(*options, "--against", "baseline", "--out", "runs/two").returncode == 0
    page = (tmp_path / "runs" / "two" / "report.html").read_text()
    assert "over runs" not in page, "one value is no course"


def test_a_misspelt_bound_is_told_by_check_and_run(command: Command, tmp_path: Path) -> None:
    with (tmp_path / "lab.toml").open("a") as file:
        file.write('[bounds."motion.lag.lga"]\nvalue = 1.0\nbecause = "so"\n')
    for words in (["bench", "lab.toml"], ["lab", "check", "lab.toml"]):
        found = command(*words)
        assert found.returncode == 2
        assert "lab.toml:4: bounds.motion.lag.lga" in found.stderr
        assert "Did you mean 'motion.lag.lag'?" in found.stderr
