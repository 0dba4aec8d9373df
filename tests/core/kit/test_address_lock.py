"""One program of this machine at an address, as long as that program lives."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.kit.address_lock import AddressLock
from rigs.waiting import eventually

PORT = os.getpid()
"""Of nobody: workers of one machine have their own."""
HOLDS = f"""
from crtk_drivers.kit.address_lock import AddressLock
lock = AddressLock("test", "127.0.0.1", {PORT})
lock.take()
print("held", flush=True)
input()
"""


def test_a_second_one_is_refused_until_the_first_is_released() -> None:
    first, second = (AddressLock("test", host, PORT) for host in ("127.0.0.1", "localhost"))
    first.take()
    first.take()
    with pytest.raises(ConnectionFailed, match=rf"process {os.getpid()} .*this one\) drives it"):
        second.take()
    for other in (
        AddressLock("test", "127.0.0.1", PORT + 1),
        AddressLock("other", "127.0.0.1", PORT),
    ):
        other.take()
        other.release()
    first.release()
    first.release()
    second.take()
    second.release()


def test_one_that_is_killed_has_released_it() -> None:
    ours = AddressLock("test", "127.0.0.1", PORT)
    with subprocess.Popen(
        [sys.executable, "-c", HOLDS], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        with pytest.raises(ConnectionFailed, match=f"(?s)process {other.pid} .*drives it already"):
            ours.take()
        other.kill()
        other.wait()

    def is_free() -> bool:
        try:
            ours.take()
        except ConnectionFailed:
            return False
        return True

    eventually(is_free, "released")
    ours.release()


def test_an_address_that_is_none_is_told() -> None:
    with pytest.raises(ConnectionFailed, match="cannot be resolved"):
        AddressLock("test", "no such host", PORT).take()
