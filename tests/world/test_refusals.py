"""What a world does not have is refused by name."""

from __future__ import annotations

from pathlib import Path

from crtk_drivers.testing.world import Host

TOLD = {
    "fork": "os.fork",
    "exec": "os.execv",
    "waitpid": "os.waitpid",
    "another program": "the program ls",
    "a script": "a program that is given neither by -c nor by -m",
    "a folder": "subprocess.Popen(cwd='/')",
    "a shell": "subprocess.Popen(shell=True)",
    "a timer": "signal.setitimer",
    "an alarm": "signal.alarm",
    "waking up": "signal.set_wakeup_fd",
    "SIGCHLD": "a handler of SIGCHLD",
    "AF_INET6": "EAFNOSUPPORT",
    "edge-triggered": "an edge-triggered epoll",
    "exclusive": "EPOLLEXCLUSIVE",
    "writev": "os.writev",
    "pread": "os.pread",
    "an ioctl": "ioctl 0x5401",
    "an fcntl": "fcntl 1031",
    "a lock": "flock",
    "lines": "a terminal that edits lines",
    "an echo": "a terminal that edits lines or echoes",
    "VMIN 5": "a terminal with VMIN 5",
    "a name": "_socket.gethostbyname_ex",
}


def test_refusals_name_what_is_missing() -> None:
    with Host(Path(__file__).parent / "refused_programs.py") as host:
        outcome = host.run("refused_calls", 1)
    outcome.check()
    assert outcome.result.keys() == TOLD.keys()
    for name, told in outcome.result.items():
        assert told.startswith(TOLD[name]), name
