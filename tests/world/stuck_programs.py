"""Scenarios that end badly: the world must say so, and where."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time

from crtk_drivers.testing.world import World


def two_locks(_: World) -> None:
    """Take two locks in different orders, sooner or later."""
    one, other = threading.Lock(), threading.Lock()

    def take(first: threading.Lock, second: threading.Lock) -> None:
        while True:
            with first:
                time.sleep(0.001)
                with second:
                    time.sleep(0.001)

    threading.Thread(target=take, args=(one, other), name="left").start()
    threading.Thread(target=take, args=(other, one), name="right").start()
    threading.Event().wait(1.0)


def three_rlocks(_: World) -> None:
    locks = [threading.RLock() for _ in range(3)]

    def take(number: int) -> None:
        with locks[number]:
            time.sleep(0.01)
            with locks[(number + 1) % 3]:
                pass

    for number in range(3):
        threading.Thread(target=take, args=(number,), name=f"thread {number}").start()
    threading.Event().wait(1.0)


def no_deadlock(_: World) -> int:
    """Wait for locks that are given back: by a condition, and by another thread."""
    condition, count = threading.Condition(), 0

    def is_even() -> bool:
        return count % 2 == 0

    def work() -> None:
        nonlocal count
        for _ in range(20):
            with condition:
                condition.wait_for(is_even, 0.01)
                count += 1
                condition.notify_all()

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return count


def nobody_comes(_: World) -> None:
    def wait_in_a_thread(reading: int) -> None:
        os.read(reading, 1)

    reading, _writing = os.pipe()
    threading.Thread(target=wait_in_a_thread, args=(reading,), name="reader").start()
    _wait_for_nobody()


def _wait_for_nobody() -> None:
    threading.Event().wait()


def not_done(_: World) -> None:
    while True:
        time.sleep(1.0)


def error_in_a_thread(_: World) -> None:
    thread = threading.Thread(target=lambda: {}["missing"], name="looker")
    thread.start()
    thread.join()
    time.sleep(1.0)


def error_in_a_child(_: World) -> None:
    subprocess.Popen([sys.executable, "-c", "raise LookupError('on purpose')"]).wait()
    time.sleep(1.0)


def killed_child(_: World) -> list[object]:
    """Kill a child of two threads that beat; return whether it beats later, and what its files do."""
    reading, writing = os.pipe()
    told, tells = os.pipe()
    program = (
        "import os, sys, threading, time\n"
        "def beat():\n"
        "    while True:\n"
        "        os.write(int(sys.argv[1]), b'x')\n"
        "        time.sleep(0.001)\n"
        "threading.Thread(target=beat, daemon=True).start()\nbeat()"
    )
    command = [sys.executable, "-c", program, str(writing)]
    child = subprocess.Popen(command, pass_fds=(writing, told))
    os.close(writing)
    os.close(told)
    time.sleep(0.1)
    child.kill()
    beats = len(os.read(reading, 1 << 16))
    time.sleep(1.0)
    later = os.read(reading, 1 << 16)
    try:
        os.write(tells, b"x")
        broken = False
    except BrokenPipeError:
        broken = True
    return [beats > 20, later == b"", broken, child.wait()]


def compute(_: World) -> None:
    """Never end, and let no time pass."""
    while True:
        pass


def leave(_: World) -> None:
    sys.exit(3)


def kill_itself(_: World) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def read_input(_: World) -> None:
    input()


def return_a_set(_: World) -> set[int]:
    return {1}
