"""A process for a vendor's library: what it says, how it ends, what is told of that."""

from __future__ import annotations

import errno
import itertools
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_drivers.kit import child_process
from crtk_drivers.kit.child_process import ChildProcess
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.usefixtures("cold_start")

PROGRAM = """
import os, sys
from crtk_drivers.kit.child_process import Parent
parent = Parent(int(sys.argv[1]))
while (said := parent.receive(10.0)) is not None:
    for word in said:
        if word == b"die":
            sys.exit("the library has had enough")
        if word == b"chatter":
            import time
            for _ in range(5000):
                while True:
                    try:
                        os.write(1, b"a line of the library\\n")
                        break
                    except BlockingIOError:
                        time.sleep(0.001)
            sys.exit("its very last word")
        if word == b"babble":
            os.set_blocking(1, True)
            for _ in range(40):
                os.write(1, b"x" * 65536)
            os.write(1, b"\\nover\\n")
        if word == b"abort":
            os.abort()
        if word == b"wait":
            import time; time.sleep(60)
        parent.send(word.upper())
open(sys.argv[0] + ".ended", "w").close()
"""


@pytest.fixture
def child(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ChildProcess]:
    (tmp_path / "echoing_child.py").write_text(PROGRAM)
    monkeypatch.syspath_prepend(str(tmp_path))
    process = ChildProcess("echoing_child", "the device")
    process.start()
    yield process
    process.kill()


def heard(child: ChildProcess) -> list[bytes]:
    return child.receive(time.monotonic() + LONG)


def test_messages_stay_whole_and_in_order(child: ChildProcess) -> None:
    words = [b"a", b"bcd" * 5000, b"e"]
    for word in words:
        child.send(word)
    found: list[bytes] = []
    while len(found) < 3:
        found += heard(child)
    assert found == [word.upper() for word in words]
    assert child.receive(time.monotonic()) == []


def test_it_ends_by_itself_when_the_driver_closes(child: ChildProcess, tmp_path: Path) -> None:
    child.send(b"a")
    assert heard(child) == [b"A"]
    child.close(LONG)
    assert (tmp_path / "echoing_child.py.ended").exists()
    assert child.pid == 0
    child.close(0.0)
    for call in (lambda: child.send(b"a"), lambda: child.receive(0.0)):
        with pytest.raises(ConnectionLost, match="its process has ended"):
            call()


@pytest.mark.parametrize(
    ("word", "how"),
    [
        (b"die", "ended with status 1; last words: the library has had enough"),
        (b"abort", "signal 6"),
        (b"chatter", "last words: its very last word"),
    ],
)
def test_how_it_ended_is_told(
    child: ChildProcess, word: bytes, how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(child_process, "_TELLS_HOW", LONG)
    child.send(word)
    with pytest.raises(ConnectionLost, match=how) as caught:
        eventually(lambda: child.receive(time.monotonic() + 0.1), "an answer, though there is none")
    assert caught.value.where == "the device"


def test_one_that_hangs_is_killed_and_replaced(child: ChildProcess) -> None:
    child.send(b"wait")
    before = child.pid
    child.close(0.1)
    child.start()
    assert child.pid not in (0, before)
    child.send(b"a")
    assert heard(child) == [b"A"]
    assert child.starts == 2


def test_of_what_a_library_writes_without_an_end_the_last_is_kept(child: ChildProcess) -> None:
    child.send(b"babble")

    def is_over() -> bool:
        child.receive(time.monotonic())
        return bool(child._words) and child._words[-1] == "over"

    eventually(is_over, "it has said all")
    assert max(map(len, child._words)) <= child_process.LONGEST


def test_one_that_takes_nothing_is_told(child: ChildProcess) -> None:
    child.send(b"wait")
    with pytest.raises(ConnectionLost, match="hangs"):
        any(child.send(b"x" * 1000) for _ in itertools.count())


@pytest.fixture
def many_files() -> Iterator[None]:
    """A process with more open files than select can number."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard < 2 * 1024:
        pytest.skip("the system allows this process no 2048 files")
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2 * 1024), hard))
    opened = [os.open(os.devnull, os.O_RDONLY)]
    while opened[-1] < 1024:
        opened.append(os.dup(opened[0]))
    yield
    for descriptor in opened:
        os.close(descriptor)
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_many_open_files_are_no_hindrance(many_files: None, child: ChildProcess) -> None:
    child.send(b"a")
    assert heard(child) == [b"A"]
    assert child.receive(time.monotonic()) == []


def test_where_the_system_has_no_more_files_it_says_so_and_keeps_none(
    child: ChildProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    child.kill()
    before = os.listdir("/proc/self/fd")

    def refuse(flags: int) -> tuple[int, int]:
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(os, "pipe2", refuse)
    with pytest.raises(ConnectionFailed, match="Too many open files"):
        child.start()
    assert os.listdir("/proc/self/fd") == before
    assert child.pid == 0
