"""Processes of a lab: started again when they end, told to stop in order, never left."""

import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from crtk_drivers.cli import main, up_command
from crtk_drivers.errors.exit_codes import NOT_INSTALLED
from crtk_drivers.labs import Lab, LabProgram, load_lab, reports, supervisor
from crtk_drivers.labs.child import Child, Phase
from crtk_drivers.labs.lab_file import LabSettings
from crtk_drivers.labs.machines import Elsewhere
from crtk_drivers.labs.reports import Report, Reporter, read_reports
from crtk_drivers.labs.seen import Seen
from crtk_drivers.labs.supervisor import Supervisor
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.marked_processes import left_behind
from crtk_drivers.status.pulse import Pulse, pulse_ends
from rigs.processes import children_of, command_of, has_ended
from rigs.waiting import LONG, eventually

PYTHON = (sys.executable, "-S", "-c")
"""Without `site`, which takes longer than all that the programs below do."""

FOREVER = "import time; print('up', flush=True)\nwhile True: time.sleep(0.05)"
"""Short sleeps: a signal that comes just before one does not end it."""

STUBBORN = "import signal, time; signal.signal(2, signal.SIG_IGN); print('up', flush=True); time.sleep(1000)"


def lab_of(folder, programs):
    """A lab of programs alone, as no file can say it."""
    return Lab("lab", folder / "lab.toml", {}, programs, LabSettings.model_construct(), {})


@pytest.fixture
def lab(tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "FIRST_DELAY", 0.05)
    made = []

    def running(**programs: str) -> Supervisor:
        started = {name: LabProgram(name, (*PYTHON, text), ()) for name, text in programs.items()}
        made.append(Supervisor(lab_of(tmp_path, started), tmp_path / "logs"))
        for child in made[-1].programs.values():
            child.delay = supervisor.FIRST_DELAY  # of the class, it is that of users
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


def is_up(child: Child) -> bool:
    """Whether it has said so: before that, Python may lose a Ctrl-C."""
    return child.log.exists() and "up" in child.log.read_text()


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


KILLED = """
import sys, time
from pathlib import Path
from crtk_drivers.errors.exit_codes import NOT_INSTALLED
from crtk_drivers.labs import Lab, LabProgram
from crtk_drivers.labs.lab_file import LabSettings
from crtk_drivers.labs.supervisor import Supervisor
folder = Path(sys.argv[1])
program = LabProgram("work", (sys.executable, "-c", "import time; time.sleep(1000)"), ())
lab = Lab("lab", folder / "lab.toml", {}, {"work": program}, LabSettings.model_construct(), {})
running = Supervisor(lab, folder / "logs")
running.step()
print(running.programs["work"].process.pid, flush=True)
time.sleep(1000)
"""


def test_no_program_outlives_one_that_is_killed(tmp_path):
    command = [sys.executable, "-c", KILLED, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as up:
        pid = int(up.stdout.readline())
        up.kill()
    eventually(lambda: has_ended(pid), "the program ends, too")


LEFT = """
import sys, time
from pathlib import Path
from crtk_drivers.errors.exit_codes import NOT_INSTALLED
from crtk_drivers.labs import Lab, LabProgram
from crtk_drivers.labs.lab_file import LabSettings
from crtk_drivers.labs.supervisor import Supervisor
folder = Path(sys.argv[1])
program = LabProgram("work", ("sh", "-c", sys.argv[2]), ())
lab = Lab("lab", folder / "lab.toml", {}, {"work": program}, LabSettings.model_construct(), {})
running = Supervisor(lab, folder / "logs")
while True:
    running.step()
    time.sleep(0.05)
"""
IGNORES = "trap '' TERM INT HUP; echo $$ > pid; while :; do sleep 0.1; done"
CHILD = "sleep 1000 & echo $! > pid; wait"
DAEMON = "(trap '' TERM; setsid sh -c 'echo $$ > pid; exec sleep 1000' &); sleep 1000"


@pytest.fixture
def left(tmp_path):
    """Starts a supervisor of a program that writes the id of a process; returns both, and the guard."""
    started = []

    def run(command):
        up = subprocess.Popen([sys.executable, "-c", LEFT, str(tmp_path), command])
        started.append(up)
        written = tmp_path / "pid"
        eventually(lambda: written.exists() and written.read_text().strip(), "it runs")
        guard = eventually(lambda: guards_of(up.pid), "it is guarded")
        return up, guard[0], int(written.read_text())

    yield run
    for up in started:
        up.kill()
        up.wait()
    for each in left_behind(str(tmp_path / "lab.toml")):
        os.kill(each.pid, signal.SIGKILL)


def guards_of(pid):
    return [each for each in children_of(pid) if "marked_processes" in command_of(each)]


@pytest.mark.parametrize("command", [IGNORES, CHILD, DAEMON], ids=["ignores", "child", "daemon"])
def test_nothing_that_it_started_outlives_it(left, command):
    up, guard, pid = left(command)
    up.kill()
    up.wait()
    eventually(lambda: has_ended(pid), "what it started ends")
    eventually(lambda: has_ended(guard), "and so does its guard")


@pytest.mark.timeout(240)
def test_a_frozen_up_leaves_no_program(left, tmp_path):
    """When it goes on, it starts it again."""
    up, guard, pid = left(IGNORES)
    try:
        up.send_signal(signal.SIGSTOP)
        eventually(lambda: has_ended(pid), "the program ends")
        assert not has_ended(guard)
        up.send_signal(signal.SIGCONT)
        again = eventually(lambda: other_than(pid, tmp_path / "pid"), "it is started again")
    finally:
        up.kill()
        up.wait()
    eventually(lambda: has_ended(again), "it ends with it")


def other_than(pid, written):
    """Return the process id that was written, once it is another one."""
    found = int(written.read_text() or pid)
    return found if found != pid else 0


def test_what_was_left_is_named_by_the_next_up(left, tmp_path, monkeypatch, capsys):
    """Its guard was killed, too."""
    monkeypatch.setenv("COLUMNS", "500")
    (tmp_path / "lab.toml").write_text('[devices.arm]\nplugin = "loopback"\n')
    up, guard, pid = left(IGNORES)
    group = str(tmp_path / "lab.toml")
    try:
        assert not left_behind(group), "its starter lives"
        for each in (guard, up.pid):
            os.kill(each, signal.SIGKILL)
        up.wait()
        monkeypatch.setattr(up_command, "EARLIER_ENDS_WITHIN", 0.2)
        assert main(["up", group, "--logs", str(tmp_path / "second")]) == 2
        said = " ".join(capsys.readouterr().err.split())
        assert f"still runs: work: process {pid} (sh -c trap" in said
        assert f"kill -9 {pid}" in said
        assert not (tmp_path / "second").exists(), "nothing was started"
    finally:
        os.kill(pid, signal.SIGKILL)
    eventually(lambda: not left_behind(group), "what is left has ended")


def test_a_stop_leaves_no_child_of_a_program(lab, tmp_path, caplog):
    """A shell lets what it starts in the background ignore Ctrl-C."""
    running = lab()
    command = ("sh", "-c", CHILD)
    running.programs["work"] = Child("work", command, (), tmp_path / "work.log", False)
    written = tmp_path / "pid"
    until(running, lambda: written.exists() and written.read_text().strip(), "it runs")
    running.stop()
    pid = int(written.read_text())
    assert has_ended(pid)
    told = rf"work: process {pid} \(.*\) was left by it, and is ended"
    assert any(re.fullmatch(told, message) for message in caplog.messages)


def test_a_guard_that_was_killed_is_started_again(lab):
    running = lab(work=FOREVER)
    first = eventually_guarded(running)
    os.kill(first, signal.SIGKILL)
    until(running, lambda: running._guard.pid != first, "there is another one")


def eventually_guarded(running):
    until(running, lambda: running._guard is not None, "it is guarded")
    return running._guard.pid


def test_what_has_no_log_is_not_started_and_ends_nothing_else(lab, tmp_path):
    (tmp_path / "logs" / "none.log").mkdir(parents=True)
    running = lab(none=FOREVER, other=FOREVER)
    running.step()
    child = running.programs["none"]
    assert child.phase is Phase.ENDED
    assert "cannot be started" in child.why
    assert running.programs["other"].phase is Phase.RUNNING


def test_every_process_has_the_environment_of_the_lab(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "1")
    say = "import os; print(os.environ['ROS_DOMAIN_ID'], os.environ['MINE'], flush=True)"
    work = {"work": LabProgram("work", (*PYTHON, say), ())}
    of_lab = {"ROS_DOMAIN_ID": "42", "MINE": "yes"}
    running = Supervisor(replace(lab_of(tmp_path, work), environment=of_lab), tmp_path / "logs")
    running.devices["arm"] = Child(
        "arm", (*PYTHON, f"{say}; {FOREVER}"), (), tmp_path / "logs" / "arm.log", True
    )
    until(running, lambda: is_up(running.devices["arm"]), "it is up")
    until(running, lambda: running.programs["work"].phase is Phase.ENDED, "it has ended")
    running.stop()
    for name in ("work", "arm"):
        assert (tmp_path / "logs" / f"{name}.log").read_text().startswith("42 yes\n")


def test_relative_paths_of_the_shell_stay_where_they_were(tmp_path, monkeypatch):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    monkeypatch.setenv("ROS_SECURITY_KEYSTORE", "keys")
    say = "import os; print(os.environ['ROS_SECURITY_KEYSTORE'], flush=True)"
    work = {"work": LabProgram("work", (*PYTHON, say), ())}
    running = Supervisor(lab_of(tmp_path, work), tmp_path / "logs")
    until(running, lambda: running.programs["work"].phase is Phase.ENDED, "it has ended")
    running.stop()
    assert (tmp_path / "logs" / "work.log").read_text() == f"{elsewhere}/keys\n"


def test_a_missing_library_is_waited_for(lab, tmp_path):
    running = lab(other=FOREVER)
    text = f"print('rclpy is not installed\\n  hint: x'); raise SystemExit({NOT_INSTALLED})"
    arm = Child("arm", (*PYTHON, text), (), tmp_path / "logs" / "arm.log", True, delay=0.05)
    running.devices["arm"] = arm
    until(running, lambda: arm.restarts and arm.phase is Phase.RESTARTING, "it is tried again")
    assert "rclpy is not installed" in arm.why


@pytest.mark.parametrize("missing", ["log", "settings", "folder"])
def test_a_device_without_its_files_is_tried_again(lab, tmp_path, missing):
    running = lab(other=FOREVER)
    (tmp_path / "lab.toml").write_text('[devices.arm]\nplugin = "loopback"\n')
    running.lab = load_lab(tmp_path / "lab.toml")
    folder = tmp_path / "logs"
    arm = Child("arm", (*PYTHON, FOREVER), (), folder / "arm.log", True, delay=0.05)
    running.devices["arm"] = arm
    until(running, lambda: is_up(arm), "it is up")
    os.kill(arm.process.pid, signal.SIGKILL)
    until(running, lambda: arm.phase is Phase.RESTARTING, "its end is seen")
    if missing == "folder":
        shutil.rmtree(folder)
        folder.write_text("in its place")
    else:
        path = folder / {"log": "arm.log", "settings": "arm.yaml"}[missing]
        path.unlink()
        path.mkdir()
    until(running, lambda: "cannot be started" in arm.why, "it cannot be started")
    assert arm.phase is Phase.RESTARTING
    assert running.programs["other"].phase is Phase.RUNNING
    if missing == "folder":
        folder.unlink()
    else:
        path.rmdir()
    until(running, lambda: arm.process is not None, "it runs again")
    assert (folder / "arm.yaml").exists(), "its settings are there again"


def test_without_files_for_a_pipe_a_device_waits(lab, tmp_path, monkeypatch):
    running = lab(other=FOREVER)
    running.devices["arm"] = arm = Child(
        "arm", (*PYTHON, FOREVER), (), tmp_path / "arm.log", True, delay=0.05
    )
    with monkeypatch.context() as patch:
        patch.setattr(os, "pipe2", out_of_files)
        running.step()
    assert (arm.phase, "Too many open files" in arm.why) == (Phase.RESTARTING, True)
    until(running, lambda: is_up(arm), "it is up")


def out_of_files(*_):
    raise OSError(24, "Too many open files")


MEASURES = """
import json, os, sys, time
report = dict(state="DISABLED", cause="", is_busy=False, is_homed=True, measures=True, rate=1.0)
report |= dict(expected=1.0, late=0, refused=0, last_refusal="")
os.write(int(os.environ["CRTK_DRIVERS_REPORT_FD"]), json.dumps(report).encode() + b"\\n")
"""


def has_measured(running, folder, then):
    """Add a device that measures until it does what `then` says, and a program that comes after it."""
    command = (*PYTHON, MEASURES + then)
    arm = Child("arm", command, (), folder / "arm.log", True, delay=1000.0)
    running.devices["arm"] = arm
    until(running, lambda: arm.heard, "it measures")
    until(running, lambda: not arm.is_ready, "it is not ready any more")
    tool = Child("tool", (*PYTHON, FOREVER), ("arm",), folder / "tool.log", False)
    running.programs["tool"] = tool
    running.step()
    assert (tool.phase, tool.why) == (Phase.WAITING, "waits for arm")
    return arm


def test_a_device_that_stands_still_is_not_ready_whatever_it_told_last(lab, tmp_path, monkeypatch):
    monkeypatch.setattr("crtk_drivers.labs.child.SILENCE", 0.05)
    assert has_measured(lab(), tmp_path, "time.sleep(1000)").phase is Phase.RUNNING


@pytest.mark.parametrize(("code", "phase"), [(0, Phase.RESTARTING), (2, Phase.ENDED)])
def test_a_device_that_has_ended_is_not_ready_whatever_it_told_last(lab, tmp_path, code, phase):
    arm = has_measured(running := lab(), tmp_path, f"sys.exit({code})")
    until(running, lambda: arm.phase is phase, "its end is seen")


def test_all_are_told_to_stop_and_nothing_is_left(lab):
    running = lab(one=FOREVER, two=FOREVER)
    until(running, lambda: all(map(is_up, running.children)), "they are up")
    pids = [child.process.pid for child in running.children]
    assert running.stop()
    assert not any(Path(f"/proc/{pid}").exists() for pid in pids)
    assert running.is_over
    assert all(re.fullmatch(r"ended in \d+\.\d s", child.why) for child in running.children)


FORGETFUL = """
import signal, sys, time
signal.signal(signal.SIGINT, signal.SIG_IGN)
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
print("up", flush=True)
while True:  # a signal just before a sleep is heard after it
    time.sleep(0.05)
"""


def test_a_device_that_has_forgotten_a_ctrl_c_is_stopped_all_the_same(lab, tmp_path):
    """As Python does with one that interrupts an import."""
    running = lab()
    command = (sys.executable, "-c", FORGETFUL)
    running.devices["arm"] = arm = Child("arm", command, (), tmp_path / "arm.log", True)
    until(running, lambda: is_up(arm), "it is up")
    assert running.stop()


REPORTS = """
while True:
    time.sleep(0.02)
    os.write(int(os.environ["CRTK_DRIVERS_REPORT_FD"]), json.dumps(report).encode() + b"\\n")
"""


def test_a_frozen_device_is_killed_and_started_again(lab, tmp_path, monkeypatch):
    monkeypatch.setattr(supervisor, "STANDS_STILL", 3.0)
    running = lab(other=FOREVER)
    command = (*PYTHON, MEASURES + REPORTS)
    arm = Child("arm", command, (), tmp_path / "arm.log", True, delay=0.05)
    running.devices["arm"] = arm
    until(running, lambda: arm.is_ready, "it measures")
    pid = arm.process.pid
    os.kill(pid, signal.SIGSTOP)
    until(running, lambda: arm.phase is Phase.RESTARTING, "that is noticed")
    assert arm.why == "gave no report for 3 s, and was killed"
    assert has_ended(pid)
    until(running, lambda: arm.is_ready, "it measures again")
    assert running.programs["other"].restarts == 0


def test_a_device_ends_when_who_started_it_stands_still(monkeypatch):
    monkeypatch.setattr(reports, "STANDS_STILL", 0.5)
    reading, writing = os.pipe()
    ours, theirs = pulse_ends()
    own, other = Pulse.start(ours), Pulse.start(theirs)
    reporter = Reporter(
        writing,
        lambda: (Status(OperatingState.ENABLED, True), Health()),
        time.monotonic,
        own,
    )
    eventually(lambda: own.silence() == 0.0 and own.has_begun, "it is heard")
    assert reporter.update()
    other.close()
    eventually(lambda: not reporter.update(), "it is to end")
    own.close()
    os.close(reading)
    os.close(writing)


STOPS = """
print("the arm still moves", flush=True)
signal.signal(signal.SIGTERM, lambda *_: sys.exit({code}))
os.write(int(os.environ["CRTK_DRIVERS_REPORT_FD"]), json.dumps(report).encode() + b"\\n")
while True:
    time.sleep(0.05)
"""


@pytest.mark.parametrize(
    ("code", "how"),
    [
        (0, r"stopped in \d+\.\d s"),
        (1, r"ended with exit code 1: the arm still moves \(see .*arm.log\)"),
    ],
)
def test_how_a_device_stopped_is_logged(lab, tmp_path, caplog, code, how):
    caplog.set_level(logging.INFO)
    running = lab()
    command = (*PYTHON, "import signal\n" + MEASURES + STOPS.format(code=code))
    arm = Child("arm", command, (), tmp_path / "arm.log", True)
    running.devices["arm"] = arm
    until(running, lambda: is_still(arm), "it can be stopped")
    assert running.stop() is (code == 0)
    assert re.fullmatch(how, arm.why)
    assert f"arm: {arm.why}" in caplog.messages


def is_still(child: Child) -> bool:
    """Whether it has said its words: then it hears a signal."""
    return child.heard > 0.0 and child.log.exists() and "moves" in child.log.read_text()


def test_one_that_does_not_stop_is_killed_and_that_is_told(lab, monkeypatch):
    monkeypatch.setattr(supervisor, "STOP_TIMEOUT", 0.2)
    running = lab(stubborn=STUBBORN)
    child = running.programs["stubborn"]
    until(running, lambda: is_up(child), "it is up")
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


OBSERVES = """
import json, os, sys, time
assert json.loads(sys.argv[1]) == {"camera": "/there/camera"}
pipe = int(os.environ["CRTK_DRIVERS_REPORT_FD"])
assert os.environ["CRTK_DRIVERS_PULSE_FD"] and os.environ["MINE"] == "yes"
while True:
    with open("seen") as file:
        line = file.read()
    if line == "end":
        sys.exit(3)
    if line:
        os.write(pipe, line.encode() + b"\\n")
    time.sleep(0.02)
"""
"""In place of the observer: tells what a file says, as often as it can."""

NOT_SEEN = Seen("camera", False)
IDLE = Seen("camera", True, "DISABLED", measures=True)


@pytest.fixture
def watching(tmp_path, monkeypatch):
    """A supervisor of a lab with a device elsewhere, and what writes how that is seen."""
    monkeypatch.setattr(supervisor, "OBSERVER", (*PYTHON, OBSERVES))
    monkeypatch.setattr(supervisor, "FIRST_DELAY", 0.05)
    elsewhere = {"camera": Elsewhere("camera", "ndi", "/there/camera", "tracking")}
    program = {"work": LabProgram("work", (*PYTHON, FOREVER), ("camera",))}
    lab = replace(lab_of(tmp_path, program), elsewhere=elsewhere, environment={"MINE": "yes"})

    def tell(said):
        (tmp_path / "new").write_text(said if isinstance(said, str) else said.line.decode().strip())
        (tmp_path / "new").rename(tmp_path / "seen")

    tell(NOT_SEEN)
    running = Supervisor(lab, tmp_path / "logs")
    running.observer.delay = 0.05
    yield running, tell
    running.stop()


def test_a_program_waits_for_a_device_of_another_machine(watching):
    running, tell = watching
    work = running.programs["work"]
    until(running, lambda: running.observer.seen("camera"), "something is known of it")
    assert (work.phase, work.why) == (Phase.WAITING, "waits for camera on tracking")
    tell(replace(IDLE, measures=False))
    until(running, lambda: running.observer.seen("camera").seen, "it is seen")
    assert work.phase is Phase.WAITING
    tell(IDLE)
    until(running, lambda: is_up(work), "it is started")


def test_a_device_waits_for_another_machine_only_so_long(watching, monkeypatch, caplog, tmp_path):
    running, _ = watching
    command = (*PYTHON, FOREVER)
    ft = Child("ft", command, ("camera",), tmp_path / "logs" / "ft.log", True)
    running.devices["ft"] = ft
    until(running, lambda: running.observer.seen("camera"), "something is known of it")
    assert ft.phase is Phase.WAITING
    monkeypatch.setattr(supervisor, "PATIENCE", 0.0)
    until(running, lambda: is_up(ft), "it is started")
    assert "ft: started, though camera on tracking does not measure" in caplog.messages


def test_what_an_observer_has_said_ends_with_it(watching):
    running, tell = watching
    tell(IDLE)
    until(running, lambda: running.observer.seen("camera"), "it is seen")
    tell("end")
    until(running, lambda: running.observer.restarts, "it was started again")
    assert running.observer.seen("camera") is None
    tell(IDLE)
    until(running, lambda: running.observer.seen("camera"), "it is seen again")
    assert running.stop()


def test_an_observer_that_stands_still_says_nothing(watching, monkeypatch):
    running, tell = watching
    tell(IDLE)
    until(running, lambda: running.observer.seen("camera"), "it is seen")
    monkeypatch.setattr("crtk_drivers.labs.child.SILENCE", 0.05)
    os.kill(running.observer.process.pid, signal.SIGSTOP)
    until(running, lambda: running.observer.seen("camera") is None, "that is not known any more")
    monkeypatch.setattr(supervisor, "STANDS_STILL", 0.5)
    monkeypatch.setattr("crtk_drivers.labs.child.SILENCE", 5.0)
    until(running, lambda: running.observer.restarts, "it was killed, and started again")
    until(running, lambda: running.observer.seen("camera"), "it is seen again")


def test_devices_stop_before_an_observer_that_hangs(watching, monkeypatch, tmp_path):
    running, tell = watching
    arm = Child("arm", (*PYTHON, FOREVER), (), tmp_path / "logs" / "arm.log", True)
    running.devices["arm"] = arm
    tell(IDLE)
    until(running, lambda: is_up(arm) and running.observer.seen("camera"), "both are up")
    os.kill(running.observer.process.pid, signal.SIGSTOP)
    monkeypatch.setattr(supervisor, "STOP_TIMEOUT", 1.0)
    ended = []
    running.stop(lambda: ended.append((arm.phase, running.observer.phase)))
    assert (Phase.ENDED, Phase.STOPPING) in ended


def test_a_lab_on_one_machine_has_no_observer(lab):
    assert lab(work=FOREVER).observer is None
