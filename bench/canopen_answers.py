"""Drives that take no time to answer: simulated ones, whose TPDOs are recorded and then played back.

A cycle at them is what the client and the bus take: real drives reckon by themselves, simulated ones on the
same cores. They are set up as any others, and the first cycles are those of the simulator.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.processes import module, running, wait_ready
from crtk_sim_backends.can.hub import Hub
from crtk_sim_backends.canopen.drive import DriveConfig
from crtk_sim_backends.canopen.node import BusDrives

SYNC = 0x080
TPDOS = range(0x181, 0x200)
RECORDED = 20
"""SYNCs that the simulated drives answer themselves."""


class Answers:
    """A node that takes the place of all others which have sent TPDOs."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._drives = hub.nodes
        self._node = hub.attach(self._hear, "answers")
        self._tpdos: dict[int, bytes] = {}
        self._syncs = 0

    def _hear(self, can_id: int, data: bytes) -> None:
        if can_id in TPDOS:
            self._tpdos[can_id] = data
        if can_id != SYNC:
            return
        self._syncs += 1
        if self._syncs > RECORDED:
            for cob_id, answer in self._tpdos.items():
                self._node.send(cob_id, answer)
        elif self._syncs == RECORDED:
            for drive in self._drives:
                drive.detach()
            self._node.interests = {SYNC}


@contextmanager
def answers(nodes: int) -> Iterator[str]:
    """Run drives with the node-IDs from 1 on, for one client; yield the path of their bus."""
    with tempfile.TemporaryDirectory() as folder:
        path = str(Path(folder) / "bus.sock")
        command = [*module("bench.canopen_answers"), path, str(nodes)]
        with running(command, Path(folder)) as child:
            wait_ready(child)
            yield path


def main() -> None:
    """Run until SIGTERM."""
    path, nodes = sys.argv[1], int(sys.argv[2])
    with Hub() as hub:
        BusDrives(hub, {node: DriveConfig() for node in range(1, nodes + 1)})
        Answers(hub)
        hub.open_socket(path)
        signal.signal(signal.SIGTERM, lambda *_: hub.stop())
        print("ready", time.monotonic(), flush=True)
        hub.run()


if __name__ == "__main__":
    main()
