"""A scripted CiA 402 node at the level of frames, on any python-can bus: for the driver's lower layers.

It has its own tables and knows nothing of the driver. It answers what it is told to, and misbehaves where a
test asks it to (`ignore`, `abort`, `silent`, `drop_tpdos`).
"""

from __future__ import annotations

import itertools
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Self

import can

_channels = itertools.count()

READ_ONLY = {0x1000, 0x1018, 0x6041, 0x6061, 0x6064, 0x6502, 0x1008}
SIZES = {"B": 1, "b": 1, "H": 2, "h": 2, "I": 4, "i": 4}


class Abort(Exception):
    """An SDO abort with this code."""


def _objects(node: int) -> dict[tuple[int, int], tuple[str, Any]]:
    table: dict[tuple[int, int], tuple[str, Any]] = {
        (0x1000, 0): ("I", 0x00020192),
        (0x1001, 0): ("B", 0),
        (0x1008, 0): ("s", b"scripted servo drive"),
        (0x1016, 0): ("B", 2),
        (0x1016, 1): ("I", 0),
        (0x1016, 2): ("I", 0),
        (0x1017, 0): ("H", 0),
        (0x1018, 0): ("B", 4),
        (0x1018, 1): ("I", 0x1234),
        (0x1018, 2): ("I", 0x402),
        (0x1018, 3): ("I", 0x00010002),
        (0x1018, 4): ("I", 1000 + node),
        (0x2000, 0): ("s", b""),
        (0x6007, 0): ("h", 1),
        (0x6040, 0): ("H", 0),
        (0x6041, 0): ("H", 0x0250),
        (0x605A, 0): ("h", 2),
        (0x6060, 0): ("b", 0),
        (0x6061, 0): ("b", 0),
        (0x6064, 0): ("i", 100 * node),
        (0x606C, 0): ("i", 0),
        (0x6077, 0): ("h", 0),
        (0x607A, 0): ("i", 0),
        (0x608F, 1): ("I", 4096),
        (0x608F, 2): ("I", 1),
        (0x6091, 1): ("I", 50),
        (0x6091, 2): ("I", 1),
        (0x6076, 0): ("I", 2000),
        (0x6502, 0): ("I", 0x3A5),
    }
    for pdo in range(2):
        table |= {
            (0x1400 + pdo, 1): ("I", (0x200 + 0x100 * pdo + node) | (pdo and 1 << 31)),
            (0x1400 + pdo, 2): ("B", 255),
            (0x1600 + pdo, 0): ("B", 1),
            (0x1800 + pdo, 1): ("I", (0x180 + 0x100 * pdo + node) | (pdo and 1 << 31)),
            (0x1800 + pdo, 2): ("B", 255),
            (0x1800 + pdo, 3): ("H", 0),
            (0x1800 + pdo, 5): ("H", 0),
            (0x1A00 + pdo, 0): ("B", 1),
        }
        for sub in range(1, 5):
            table[0x1600 + pdo, sub] = ("I", 0x60400010 if sub == 1 else 0)
            table[0x1A00 + pdo, sub] = ("I", 0x60410010 if sub == 1 else 0)
    return table


class ScriptedNode:
    """One node. Call `frame` for every frame of the bus.

    Attributes:
        values: of its objects.
        ignore: objects that acknowledge a value and keep their own.
        abort: abort codes by object, for reads and writes.
        silent: answers nothing.
        drop_tpdos: how many of the next TPDOs are not sent.
        received: data of its RPDOs, in order.
        commands: NMT commands that it was given.
        log: objects that were written, in order.
    """

    def __init__(self, node: int, send: Callable[[int, bytes], None]) -> None:
        self.id = node
        self._send = send
        self.ignore: set[tuple[int, int]] = set()
        self.abort: dict[tuple[int, int], int] = {}
        self.silent = False
        self.drop_tpdos = 0
        self.received: list[bytes] = []
        self.commands: list[int] = []
        self.log: list[tuple[int, int]] = []
        self.reset()

    def reset(self) -> None:
        table = _objects(self.id)
        self.types = {key: kind for key, (kind, _) in table.items()}
        self.values = {key: value for key, (_, value) in table.items()}
        self.state = 0x7F
        self._segments = b""
        self._target: tuple[int, int] | None = None
        self._fresh: bytes | None = None
        self._heartbeat_at = 0.0
        self._send(0x700 + self.id, b"\0")

    def emergency(self, code: int, register: int = 1, vendor: bytes = bytes(5)) -> None:
        self._send(0x080 + self.id, struct.pack("<HB5s", code, register, vendor))

    def tick(self, now: float) -> None:
        period = self.values[0x1017, 0] / 1000
        if period and now >= self._heartbeat_at and not self.silent:
            self._heartbeat_at = now + period
            self._send(0x700 + self.id, bytes([self.state]))

    def frame(self, cob_id: int, data: bytes) -> None:
        if self.silent:
            return
        if cob_id == 0x000 and len(data) == 2 and data[1] in (0, self.id):
            self._nmt(data[0])
        elif cob_id == 0x080:
            self._sync()
        elif cob_id == 0x600 + self.id and self.state != 4:
            self._sdo(data)
        elif self.state == 5 and cob_id == self.values[0x1400, 1]:
            self.received.append(data)

    def _nmt(self, command: int) -> None:
        self.commands.append(command)
        if command in (0x81, 0x82):
            self.reset()
        else:
            self.state = {0x01: 0x05, 0x02: 0x04, 0x80: 0x7F}.get(command, self.state)

    def _sync(self) -> None:
        if self.state != 5:
            return
        for pdo in range(2):
            cob_id = self.values[0x1800 + pdo, 1]
            if cob_id >> 31 or self.values[0x1800 + pdo, 2] > 240:
                continue
            if self.drop_tpdos:
                self.drop_tpdos -= 1
                continue
            self._send(cob_id & 0x7FF, self._tpdo(pdo))

    def _tpdo(self, pdo: int) -> bytes:
        entries = [self.values[0x1A00 + pdo, n + 1] for n in range(self.values[0x1A00 + pdo, 0])]
        keys = [(entry >> 16, entry >> 8 & 0xFF) for entry in entries]
        return b"".join(struct.pack("<" + self.types[key], self.values[key]) for key in keys)

    # SDO server

    def _sdo(self, data: bytes) -> None:
        key = (data[1] | data[2] << 8, data[3])
        try:
            self._answer(data[0], key, data)
        except Abort as abort:
            self._reply(0x80, key, struct.pack("<I", abort.args[0]))

    def _reply(self, command: int, key: tuple[int, int], rest: bytes = b"") -> None:
        self._send(0x580 + self.id, struct.pack("<BHB4s", command, *key, rest))

    def _answer(self, command: int, key: tuple[int, int], data: bytes) -> None:
        kind = command >> 5
        if kind == 2:
            raw = self._read(key)
            if len(raw) <= 4:
                self._reply(0x43 | (4 - len(raw)) << 2, key, raw)
            else:
                self._segments = raw
                self._reply(0x41, key, struct.pack("<I", len(raw)))
        elif kind == 3:
            part, self._segments = self._segments[:7], self._segments[7:]
            first = command & 0x10 | (7 - len(part)) << 1 | (not self._segments)
            self._send(0x580 + self.id, bytes([first]) + part.ljust(7, b"\0"))
        elif kind == 1 and command & 2:
            self._write(key, data[4 : 8 - (command >> 2 & 3)])
            self._reply(0x60, key)
        elif kind == 1:
            self._segments, self._target = b"", key
            self._reply(0x60, key)
        elif kind == 0 and self._target:
            self._segments += data[1 : 8 - (command >> 1 & 7)]
            if command & 1:
                self._write(self._target, self._segments)
            self._send(0x580 + self.id, bytes([0x20 | command & 0x10]) + bytes(7))
        elif kind != 4:
            raise Abort(0x05040001)

    def _read(self, key: tuple[int, int]) -> bytes:
        self._check(key)
        kind, value = self.types[key], self.values[key]
        return bytes(value) if kind == "s" else struct.pack("<" + kind, value)

    def _check(self, key: tuple[int, int]) -> None:
        if key in self.abort:
            raise Abort(self.abort[key])
        if key not in self.types:
            raise Abort(
                0x06090011 if any(index == key[0] for index, _ in self.types) else 0x06020000
            )

    def _write(self, key: tuple[int, int], data: bytes) -> None:
        self._check(key)
        if key[0] in READ_ONLY:
            raise Abort(0x06010002)
        kind = self.types[key]
        if kind != "s" and len(data) != SIZES[kind]:
            raise Abort(0x06070010)
        value = data if kind == "s" else struct.unpack("<" + kind, data)[0]
        self._guard_mapping(key, value)
        self.log.append(key)
        if key not in self.ignore:
            self.values[key] = value
        if key == (0x6060, 0):
            self.values[0x6061, 0] = value

    def _guard_mapping(self, key: tuple[int, int], value: Any) -> None:
        """Refuse changes in the wrong order, as a strict device does."""
        index, sub = key
        if index not in (0x1600, 0x1601, 0x1A00, 0x1A01):
            return
        if not self.values[index - 0x200, 1] >> 31:
            raise Abort(0x06010000)
        if sub and self.values[index, 0]:
            raise Abort(0x06010000)
        if sub and value and (value >> 16, value >> 8 & 0xFF) not in self.types:
            raise Abort(0x06040041)


class ScriptedBus:
    """Nodes on a python-can bus, served by a thread until the end of the `with`.

    Args:
        ids: of the nodes.
        bus: to serve; a `virtual` one of its own if None, whose name is `channel`.

    Attributes:
        seen: all frames that others sent.
    """

    def __init__(self, *ids: int, bus: can.BusABC | None = None) -> None:
        self.channel = f"scripted {next(_channels)}"
        self._bus = bus or can.Bus(interface="virtual", channel=self.channel)
        self._lock = threading.RLock()
        self._ending = threading.Event()
        self.nodes = {node: ScriptedNode(node, self.send) for node in ids}
        self.seen: list[tuple[int, bytes]] = []
        self._thread = threading.Thread(target=self._run, name="scripted nodes", daemon=True)

    def __getitem__(self, node: int) -> ScriptedNode:
        return self.nodes[node]

    def send(self, cob_id: int, data: bytes, **more: Any) -> None:
        message = can.Message(arbitration_id=cob_id, data=data, is_extended_id=False, **more)
        with self._lock:
            self._bus.send(message)

    def _run(self) -> None:
        while not self._ending.is_set():
            with suppress(can.CanError):
                message = self._bus.recv(0.002)
                if message is not None:
                    self.seen.append((message.arbitration_id, bytes(message.data)))
                    for node in self.nodes.values():
                        node.frame(message.arbitration_id, bytes(message.data))
            now = time.monotonic()
            for node in self.nodes.values():
                node.tick(now)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._bus.shutdown()
