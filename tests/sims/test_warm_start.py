"""A simulator that is forked is as one that is started: what the tests of drivers rely on."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import pytest

from crtk_drivers.kit import child_process
from crtk_sim_backends import process
from crtk_sim_backends.can import SIM
from crtk_sim_backends.process import SimStartError
from rigs import warm_start
from rigs.waiting import LONG, eventually
from rigs.warm_start import WarmStart


@pytest.fixture(scope="module", params=["cold", "warm"], autouse=True)
def start(request: pytest.FixtureRequest) -> Iterator[WarmStart | None]:
    if request.param == "cold":
        request.getfixturevalue("cold_start")
        yield None
        return
    warm = WarmStart()
    with (
        patch.object(process, "_start", warm.start),
        patch.object(child_process, "_start", warm.start_child),
    ):
        yield warm
    warm.close()


def test_it_leads_a_session_and_ends_as_it_is_told() -> None:
    with SIM.spawn() as sim:
        assert os.getsid(sim.pid) == sim.pid
        assert sim.control.status()
        assert sim.running
        assert sim.stop() == 0
        assert not sim.running


def test_how_it_ended_is_known() -> None:
    with SIM.spawn() as sim:
        sim.suspend()
        sim.kill()
        assert not sim.running
        assert sim.stop() == -signal.SIGKILL


def test_what_it_says_when_it_cannot_start_is_told(tmp_path: Path) -> None:
    faults = tmp_path / "faults.yaml"
    faults.write_text("no timeline")
    with pytest.raises(SimStartError, match=r"faults\.yaml"):
        SIM.spawn(faults=str(faults))


def test_it_ends_with_whom_it_is_for() -> None:
    sim = SIM.spawn()
    os.close(sim._life)
    sim._life = -1
    assert sim._process.wait(30.0) == 0


@pytest.mark.parametrize("start", ["warm"], indirect=True)
def test_what_nobody_waits_for_any_more_is_no_answer_to_the_next(start: WarmStart) -> None:
    SIM.spawn().stop()
    os.kill(start._process.pid, signal.SIGSTOP)
    with patch.object(warm_start, "ANSWERED_WITHIN", 0.1), pytest.raises(SimStartError):
        SIM.spawn()
    os.kill(start._process.pid, signal.SIGCONT)
    with SIM.spawn() as sim:
        assert sim.control.status()
        assert sim.stop() == 0


CHILD = """
import os, sys
from crtk_drivers.kit.child_process import Parent

if __name__ == "__main__":
    Parent(int(sys.argv[1])).send(f"{os.getppid()} {sys.argv[2]} {os.getsid(0) == os.getpid()}".encode())
    sys.exit("it has told")
"""


def test_a_process_of_a_driver_has_it_for_a_parent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "telling_child.py").write_text(CHILD)
    monkeypatch.syspath_prepend(tmp_path)
    child, peer, errors = child_process.spawn("telling_child", "why", called="it", where="here")
    with open(errors, "rb") as said, peer:
        assert child.wait(LONG) == 1
        assert peer.recv(100).split() == [str(os.getpid()).encode(), b"why", b"True"]
        assert said.read() == b"it has told\n"


RUN = """
import os, signal, subprocess, sys, threading, time
from unittest.mock import patch

from crtk_sim_backends import process
from crtk_sim_backends.can import SIM
from rigs.warm_start import WarmStart

def begin():
    global sim, stubborn
    with patch.object(process, "_start", warm.start):
        sim = SIM.spawn()
    stubborn = warm.start_text("stubborn", stdout=subprocess.PIPE)
    stubborn.stdout.readline()

warm = WarmStart()
if sys.argv[1] == "main thread":
    begin()
    os.kill(warm._process.pid, signal.SIGSTOP)
else:
    thread = threading.Thread(target=begin)
    thread.start()
    thread.join()
sim.suspend()
print(warm._process.pid, sim.pid, stubborn.pid, flush=True)
time.sleep(1000.0)
"""

STUBBORN = """
import signal, time

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    print("ready", flush=True)
    time.sleep(1000.0)
"""


@pytest.mark.parametrize("start", ["warm"], indirect=True)
@pytest.mark.parametrize(
    ("begun_by", "killed"),
    [("main thread", "run"), ("another thread", "run"), ("another thread", "server")],
)
@pytest.mark.usefixtures("start")
def test_a_run_that_is_killed_leaves_nothing_behind(
    tmp_path: Path, begun_by: str, killed: str
) -> None:
    """Neither what is stopped, nor what ignores signals; the same where SIGTERM ends what forks."""
    (tmp_path / "stubborn.py").write_text(STUBBORN)
    (tmp_path / "run.py").write_text(RUN)
    with subprocess.Popen(
        [sys.executable, tmp_path / "run.py", begun_by],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
    ) as run:
        assert run.stdout is not None
        pids = [int(pid) for pid in run.stdout.readline().split()]
        try:
            assert len(pids) == 3
            if killed == "run":
                run.kill()
            else:
                os.kill(pids[0], signal.SIGTERM)
            for pid in pids:
                eventually(lambda pid=pid: not is_there(pid), f"{pid} of {pids} has ended")
        finally:
            run.kill()
            for pid in filter(is_there, pids):
                os.kill(pid, signal.SIGKILL)


def is_there(pid: int) -> bool:
    """Return whether a process runs or is stopped; one that has ended may still wait to be reaped."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2][0] not in "ZX"
    except OSError:
        return False


TOLD = """
import os, pathlib, sys

if __name__ == "__main__":
    print(sys.argv[0] == __file__, sys.argv[1], os.environ["CRTK_TEST"], pathlib.Path.cwd().name)
    print(sys.stdin.read(), os.getsid(0) == os.getpid(), file=sys.stderr)
    sys.exit(7)
"""


def test_it_has_the_path_arguments_environment_folder_and_files(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    (tmp_path / "told.py").write_text(TOLD)
    (tmp_path / "here").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setenv("CRTK_TEST", "set")
    with pytest.raises(SimStartError, match=r"exit code 7 before it was ready; .*: True"):
        process.spawn("told", ["--first"])
    assert capfd.readouterr().out.split() == ["True", "--first", "set", "here"]
    assert caplog.messages == ["told:  True"]
