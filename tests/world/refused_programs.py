"""Programs that ask for what a world does not have; each returns what it is told."""

from __future__ import annotations

import errno
import fcntl
import os
import select
import signal
import socket
import subprocess
import sys
import termios
import tty
from collections.abc import Callable
from typing import Any

from crtk_drivers.testing.world import NotSimulated, World


def _told(function: Callable[..., Any], *arguments: Any, **more: Any) -> str:
    try:
        return f"returned {function(*arguments, **more)!r}"
    except NotSimulated as error:
        return str(error)
    except OSError as error:
        return errno.errorcode[error.errno or 0]


def refused_calls(_: World) -> dict[str, str]:
    reading, writing = os.pipe()
    master, client = os.openpty()
    python = [sys.executable, "-c", "pass"]
    return {
        "fork": _told(os.fork),
        "exec": _told(os.execv, sys.executable, python),
        "waitpid": _told(os.waitpid, -1, 0),
        "another program": _told(subprocess.Popen, ["ls"]),
        "a script": _told(subprocess.Popen, [sys.executable, "script.py"]),
        "a folder": _told(subprocess.Popen, python, cwd="/"),
        "a shell": _told(subprocess.Popen, "exit", shell=True),
        "a timer": _told(signal.setitimer, signal.ITIMER_REAL, 1.0),
        "an alarm": _told(signal.alarm, 1),
        "waking up": _told(signal.set_wakeup_fd, writing),
        "SIGCHLD": _told(signal.signal, signal.SIGCHLD, lambda *_: None),
        "AF_INET6": _told(socket.socket, socket.AF_INET6),
        "edge-triggered": _told(select.epoll().register, reading, select.EPOLLET),
        "exclusive": _told(select.epoll().register, reading, select.EPOLLEXCLUSIVE),
        "writev": _told(os.writev, writing, [b"x"]),
        "pread": _told(os.pread, reading, 1, 0),
        "an ioctl": _told(fcntl.ioctl, reading, 0x5401, bytes(64)),
        "an fcntl": _told(fcntl.fcntl, reading, 1031, 4096),
        "a lock": _told(fcntl.flock, reading, fcntl.LOCK_EX),
        "lines": _told(os.read, client, 1),
        "an echo": _told(os.write, master, b"x"),
        "VMIN 5": _told(_read_five, client),
        "a name": _told(socket.gethostbyname_ex, "localhost"),
    }


def _read_five(client: int) -> bytes:
    tty.setraw(client)
    attributes = termios.tcgetattr(client)
    attributes[6][termios.VMIN] = 5
    termios.tcsetattr(client, termios.TCSANOW, attributes)
    return os.read(client, 5)


def returns_no_json(_: World) -> object:
    return object()
