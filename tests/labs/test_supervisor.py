"""Processes of a lab: started again when they end, told to stop in order, never left."""

import os
import signal
import sys
import time
from pathlib import Path

import pytest

from crtk_drivers.labs import Lab, LabProgram, supervisor
from crtk_drivers.labs.lab_file import LabSettings
from crtk_drivers.labs.reports import Report, Reporter, read_reports
from crtk_drivers.labs.supervisor import Phase, Supervisor
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health

LONG = 30.0
FOREVER = "import time; time.sleep(1000)"
STUBBORN = "import signal, time; signal.signal(2, signal.SIG_IGN); print('up', flush=True); time.sleep(1000)"


def lab_of(folder, programs):
    """A lab of programs alone, as no file can say it."""
    return Lab("lab", folder / "lab.toml", {}, programs, LabSettings.model_construct(), {})


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "FIRST_DELAY", 0.05)
    made = []

    def running(**programs: str) -> Supervisor:
        started = {
            name: LabProgram(name, (sys.executable, "-c", text), ())
            for name, text in programs.items()
        }
        made.append(Supervisor(lab_of(tmp_path, started), tmp_path / "logs"))
        return made[-1]

    yield running
    for each in made:
        each.stop()


def until(lab: Supervisor, test, what: str) -> None:
    deadline = time.monotonic() + LONG
    while not test():
        assert time.monotonic() < deadline, f"never: {what}"
        lab.step()
        time.sleep(0.005)


def test_one_that_has_done_its_work_is_not_started_again(lab):
    running = lab(work="print('done')")
    until(running, lambda: running.is_over, "it is over")
    child = running.programs["work"]
    assert (child.phase, child.code, child.restarts) == (Phase.ENDED, 0, 0)
    assert child.log.read_text() == "done\n"
    assert running.stop()


def test_one_that_fails_is_started_again_later_each_time(lab):
    running = lab(bad="raise SystemExit(3)")
    child = running.programs["bad"]
    until(running, lambda: child.restarts >= 2, "it was started again twice")
    assert "exit code 3" in child.why or child.phase is Phase.RUNNING
    until(running, lambda: child.phase is Phase.RESTARTING, "it failed again")
    assert child.delay > 4 * supervisor.FIRST_DELAY


def test_one_that_is_killed_is_started_again(lab):
    running = lab(work=FOREVER)
    child = running.programs["work"]
    until(running, lambda: child.process is not None, "it runs")
    first = child.process.pid
    os.kill(first, signal.SIGKILL)
    until(running, lambda: child.phase is Phase.RESTARTING, "its end is seen")
    assert "SIGKILL" in child.why
    until(running, lambda: child.process is not None, "it runs again")
    assert child.process.pid != first


def test_what_cannot_be_started_says_so(lab, tmp_path):
    started = {"none": LabProgram("none", ("/nowhere/at-all",), ())}
    running = Supervisor(lab_of(tmp_path, started), tmp_path / "logs")
    running.step()
    child = running.programs["none"]
    assert child.phase is Phase.ENDED
    assert "No such file" in child.why


def test_all_are_told_to_stop_and_nothing_is_left(lab):
    running = lab(one=FOREVER, two=FOREVER)
    until(running, lambda: all(c.process is not None for c in running.children), "they run")
    pids = [child.process.pid for child in running.children]
    assert running.stop()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert running.is_over


def test_one_that_does_not_stop_is_killed_and_that_is_told(lab, monkeypatch):
    monkeypatch.setattr(supervisor, "STOP_TIMEOUT", 0.2)
    running = lab(stubborn=STUBBORN)
    child = running.programs["stubborn"]
    until(running, lambda: child.log.exists() and "up" in child.log.read_text(), "it is up")
    assert not running.stop()
    assert "was killed" in child.why


def test_reports_come_whole_whatever_the_pieces():
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    status = Status(OperatingState.ENABLED, True)
    clock = iter(range(100))
    reporter = Reporter(writing, lambda: (status, Health()), lambda: float(next(clock)))
    assert reporter.update()
    assert reporter.update()
    reports, rest = read_reports(reading, b"")
    assert [report.state for report in reports] == ["ENABLED", "ENABLED"]
    assert rest == b""
    line = b'{"state": "x"'
    os.write(writing, line)
    assert read_reports(reading, b"") == ([], line)
    os.close(reading)
    assert not reporter.update(), "nobody reads any more"
    os.close(writing)


def test_a_report_is_written_as_a_whole_or_not_at_all():
    """However long the texts are, and however full the pipe is."""
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    told = "\N{GREEK SMALL LETTER MU}" * 10_000
    status = Status(OperatingState.FAULT, True, detail=told)
    clock = iter(range(10_000))
    reporter = Reporter(
        writing, lambda: (status, Health(last_refusal=told)), lambda: float(next(clock))
    )
    for _ in range(200):
        assert reporter.update()
    reports, rest = read_reports(reading, b"")
    assert 10 < len(reports) < 200, "the pipe was full"
    assert rest == b""
    assert reports[0].cause.endswith("…")
    os.close(reading)
    os.close(writing)


def test_a_report_says_whether_it_measures():
    status = Status(OperatingState.DISABLED, True)
    old = Health(connected=True, sample_age=5.0)
    new = Health(connected=True, sample_age=0.01)
    assert not Report.of(status, Health()).measures
    assert not Report.of(status, old).measures
    assert Report.of(status, new).measures
