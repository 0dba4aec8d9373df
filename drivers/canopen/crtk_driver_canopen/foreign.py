"""Frames that only the master of these drives may send, sent by somebody else.

No frame of CAN tells who sent it. But SYNC, the PDOs to a drive, and the heartbeat of this computer are ours
alone, and we do not receive what we send: whoever else sends them commands the same drives.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Final

from crtk_driver_canopen.cycle import SYNC
from crtk_driver_canopen.heartbeat import NmtCommand, nmt_text
from crtk_driver_canopen.master import ALL_NODES, Master
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.pdo import Pdo
from crtk_driver_canopen.sdo import Sdo, SdoSilent

logger = logging.getLogger(__name__)

REMEMBERED: Final = 1.0
"""Seconds for which a frame of another master counts."""

SYNC_TEXT: Final = "SYNC that is not ours"

PRODUCES_SYNC: Final = 1 << 30
"""Bit of the COB-ID of SYNC (1005) in a node that sends it."""


class ForeignMaster:
    """What is heard of another master. Belongs to the thread that owns the link.

    Args:
        master: of the bus.
        node: our own id.
        nodes: that are ours to command.
    """

    def __init__(self, master: Master, node: int, nodes: Iterable[int]) -> None:
        self._master = master
        self._node = node
        self._nodes = frozenset(nodes)
        self._seen: dict[str, float] = {}
        self._commands: dict[int, str] = {}
        link = master.link
        if link.hears_itself:
            return  # what we send ourselves cannot be told from what another one sends
        link.subscribe(0x000, self._take_command)
        heartbeat = f"the heartbeat of node {node}, which is this computer"
        link.subscribe(0x700 + node, self._noting(heartbeat))

    def watch(self, rpdos: Iterable[Pdo]) -> None:
        """Take note of these when somebody else sends them: they are ours to send."""
        link = self._master.link
        if not link.hears_itself:
            for pdo in rpdos:
                link.subscribe(pdo.id, self._noting(f"PDO 0x{pdo.id:x} to node {pdo.node}"))

    def _noting(self, text: str) -> Callable[[bytes, float], None]:
        return lambda data, now: self.note(text, now)

    def listen(self, until: float) -> str:
        """Return what is heard of another master until a monotonic time; empty if nothing is.

        Nothing is sent, but a question to the drives if there is SYNC: one that produces it is no master.

        Raises:
            SdoAborted, ProtocolError: a drive does not tell.
            BusLost: the bus cannot be used.
        """
        link = self._master.link
        syncs: list[float] = []
        link.subscribe(SYNC, lambda data, now: syncs.append(now))
        link.poll(until)
        link.unsubscribe(SYNC)
        # Asking sends our heartbeat as well: not while there is somebody who must not hear that.
        is_master = bool(self.found(time.monotonic()))
        if syncs and (is_master or not any(map(self._produces_sync, sorted(self._nodes)))):
            self.note(SYNC_TEXT, time.monotonic())
        return self.found(time.monotonic())

    def _produces_sync(self, node: int) -> bool:
        try:
            word = Sdo(self._master.sdo(node)).find(OBJECTS["sync_cob_id"]) or 0
        except SdoSilent:
            return False
        return bool(word & PRODUCES_SYNC)

    def note(self, text: str, now: float) -> None:
        """Take note of a frame, in words, at monotonic seconds."""
        if now - self._seen.get(text, -REMEMBERED) >= REMEMBERED:
            logger.warning("%s: somebody else sends %s", self._master.link.where, text)
        self._seen[text] = now

    def _take_command(self, data: bytes, now: float) -> None:
        if len(data) < 2:
            return
        try:
            command = NmtCommand(data[0]).name.lower().replace("_", " ")
        except ValueError:
            command = f"0x{data[0]:02x}"
        target = "all nodes" if data[1] == ALL_NODES else f"node {data[1]}"
        text = f"somebody else sent the NMT command '{command}' to {target}"
        logger.warning("%s: %s", self._master.link.where, text)
        for node in self._nodes if data[1] == ALL_NODES else self._nodes & {data[1]}:
            self._commands[node] = text

    def command_to(self, node: int) -> str:
        """Return the last NMT command of somebody else to a node since it was set up; empty without."""
        return self._commands.get(node, "")

    def forget_commands(self, nodes: Iterable[int]) -> None:
        """Nodes are set up anew."""
        for node in nodes:
            self._commands.pop(node, None)

    def found(self, now: float) -> str:
        """Return what another master sent of late, and who it may be; empty if nothing was heard of one."""
        texts = [text for text, seen in self._seen.items() if now - seen < REMEMBERED]
        if not texts:
            return ""
        return f"another master is on this bus: it sends {', '.join(texts)}{self._strangers()}"

    def _strangers(self) -> str:
        """Return the nodes that are heard and are not ours: one of them may be the other master."""
        known = self._nodes | {self._node}
        heard = [
            f"node {node} ({nmt_text(life.state)})"
            for node, life in sorted(self._master.watch.nodes.items())
            if node not in known and life.state is not None
        ]
        return f"; also heard: {', '.join(heard)}" if heard else ""
