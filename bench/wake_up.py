"""What it takes to wake a process on another core: a packet to it, and back. Run, it is that process."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import time
from statistics import median

from bench.processes import ROOT, module, on_core

PACKETS = 3000
WAIT = 5.0


def receive(mine: socket.socket) -> bytes:
    """Wait for the next packet and return it; empty at the end."""
    if not select.select([mine], [], [], WAIT)[0]:
        raise TimeoutError("the other process does not answer")
    return mine.recv(1)


def round_trip() -> float:
    """Return the median of the seconds until a packet is back; nobody has anything to reckon."""
    mine, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    cores = os.sched_getaffinity(0)
    with on_core(max(cores)), other:
        command = [*module("bench.wake_up"), str(other.fileno())]
        peer = subprocess.Popen(command, cwd=ROOT, pass_fds=[other.fileno()])
    took = []
    with peer, mine, on_core(min(cores)):
        for _ in range(PACKETS):
            began = time.perf_counter()
            mine.send(b"\0")
            receive(mine)
            took.append(time.perf_counter() - began)
    return median(took[PACKETS // 10 :])


def main() -> None:
    """Send everything back until the other end is closed."""
    with socket.socket(fileno=int(sys.argv[1])) as mine:
        while packet := receive(mine):
            mine.send(packet)


if __name__ == "__main__":
    main()
