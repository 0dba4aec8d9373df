"""What the driver's side of the control process does where the system does not let it."""

from __future__ import annotations

import errno
import os
import subprocess

import pytest

from crtk_driver_ur.library import supervisor as supervising
from crtk_driver_ur.library.supervisor import ControlSupervisor
from crtk_drivers.errors import ConnectionFailed


def test_where_there_are_no_more_files_it_says_so_and_keeps_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(flags: int) -> tuple[int, int]:
        raise OSError(errno.EMFILE, "Too many open files")

    supervisor = ControlSupervisor("127.0.0.1")
    before = os.listdir("/proc/self/fd")
    monkeypatch.setattr(os, "pipe2", refuse)
    with pytest.raises(ConnectionFailed, match="Too many open files"):
        supervisor.start()
    assert os.listdir("/proc/self/fd") == before
    assert not supervisor.status.alive


@pytest.mark.usefixtures("cold_start")  # it is this process' own child
def test_a_process_that_the_system_keeps_is_not_waited_for_without_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    supervisor = ControlSupervisor("127.0.0.1")
    supervisor.start()
    waits: list[float | None] = []

    def endless(process: subprocess.Popen[bytes], timeout: float | None = None) -> int:
        waits.append(timeout)
        assert timeout is not None, "nobody would come back"
        raise subprocess.TimeoutExpired("", timeout)

    with monkeypatch.context() as patched:
        patched.setattr(subprocess.Popen, "wait", endless)
        patched.setattr(supervising, "DIES", 0.0)
        supervisor.close(0.0)
    supervisor.close(5.0)
    assert len(waits) == 2
