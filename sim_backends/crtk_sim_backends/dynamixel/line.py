"""The wire of one bus: when bytes cross it, what a baud rate and an adapter make of them, and its faults.

A bus is half duplex. Its time runs ahead of the bytes: a client hands over a whole packet at once, and
the line reckons when its last byte would have left, when each servo would have answered, and when the
client would have got it.
"""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from crtk_sim_backends.dynamixel.adapter import Adapter
from crtk_sim_backends.dynamixel.bus import Bus, Reply
from crtk_sim_backends.dynamixel.injection import ALL, ANY, REPLIES, overlay
from crtk_sim_backends.dynamixel.packets import BROADCAST, Instruction, Parser, Parser1, Parser2
from crtk_sim_backends.dynamixel.servo import Servo
from crtk_sim_backends.faults import Fault

BITS: Final = 10  # of one byte on the wire, start and stop bit included
GAP: Final = 0.1  # s between two bytes after which servos forget an unfinished packet

_TURN: Final = 0.001  # s that servos give a missing one before they go on
_LUMP: Final = 0.001  # s of received bytes that an adapter hands over at once, while more come
_TOLERANCE: Final = 100e-6  # s by which a client may be ahead of the wire without a collision


@dataclass
class LineStatistics:
    """What has crossed a line."""

    bytes_in: int = 0
    bytes_out: int = 0
    instructions: int = 0
    damaged: int = 0  # instructions with a wrong CRC or checksum
    collisions: int = 0  # instructions sent into an answer that was still under way
    tampered: int = 0  # instructions that a fault of the kind "message" has hit
    overruns: int = 0  # bytes that a client that does not read did not get
    deliveries: int = 0
    late: float = 0.0  # s, sum over deliveries
    worst: float = 0.0  # s


@dataclass(eq=False)
class ActiveFault:
    """A fault of the wire that has begun, and how many packets it has seen."""

    fault: Fault
    seen: int = 0

    def hits(self, number: int) -> bool:
        """Whether it hits this packet of a servo."""
        parameters = self.fault.parameters
        if parameters["id"] not in (ALL, number):
            return False
        self.seen += 1
        return self.seen % int(parameters["every"]) == 0


Trace = Callable[[Instruction, float], None]
Piece = tuple[float, int, float, bytes]
"""When to hand bytes over, a running number, when their last one has left the wire, and the bytes."""
Deferred = tuple[float, int, Callable[[], None]]
"""When servos hear an instruction that is late, a running number, and what they then do."""


class Line:
    """One bus on its adapter.

    Args:
        name: of the bus.
        port: where the clients are.
        servos: on it.
        lead: s by which a line that is timed is ahead of its time, see `wake_up`; None: bytes take no time.
        latency: of the adapter, s.
        chain: "stalls" or "goes_on".
        seed: of what faults do at random.
        trace: is told of every instruction and its time.
    """

    def __init__(
        self,
        name: str,
        port: Adapter,
        servos: list[Servo],
        *,
        lead: float | None,
        latency: float,
        chain: str,
        seed: int,
        trace: Trace,
    ) -> None:
        self.name = name
        self.port = port
        self.bus = Bus(servos)
        self.statistics = LineStatistics()
        self.faults: dict[tuple[str, int], ActiveFault] = {}
        self._timed = lead is not None
        self._lead = lead or 0.0
        self._latency = latency
        self._chain = chain
        self._generator = random.Random(seed)
        self._trace = trace
        self._parsers: dict[int, Parser] = {1: Parser1(), 2: Parser2()}
        self._free = 0.0  # when the last byte of the client leaves the wire
        self._quiet = 0.0  # when the last byte of the servos does
        self._received = -math.inf
        self._pieces: list[Piece] = []
        self._numbers = itertools.count()
        self._deferred: list[Deferred] = []

    # Faults

    def begin(self, fault: Fault) -> None:
        """Let a fault of the wire begin; it takes the place of one of its kind and id."""
        self.faults[fault.kind, fault.parameters.get("id", ALL)] = ActiveFault(fault)
        self._deafen()

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self.faults.pop((fault.kind, fault.parameters.get("id", ALL)), None)
        self._deafen()

    def _deafen(self) -> None:
        numbers = [servo.number for servo in self.bus.servos]
        self.bus.deaf = frozenset(n for n in numbers if self._silences(n) is not None)

    def _of_kind(self, kind: str) -> list[ActiveFault]:
        if not self.faults:
            return []
        return [active for (name, _), active in self.faults.items() if name == kind]

    def _silences(self, number: int) -> ActiveFault | None:
        for active in self._of_kind("silent"):
            if active.fault.parameters["id"] in (ALL, number):
                return active
        return None

    @property
    def latency(self) -> float:
        """At multiples of which the adapter hands over, s; 0: at once."""
        for active in self._of_kind("latency"):
            return float(active.fault.parameters["milliseconds"]) * 1e-3
        return self._latency

    @property
    def _holds(self) -> bool:
        """Whether the adapter hands over nothing."""
        return bool(self._of_kind("stall"))

    # From the client

    def receive(self, data: bytes, now: float, plant_time: float, baud: int) -> None:
        """Take what the client has sent at a baud rate."""
        self.statistics.bytes_in += len(data)
        if now - self._received > GAP:
            self._forget_packet()
        self._received = now
        byte = BITS / baud if self._timed and baud > 0 else 0.0
        start = max(now - self._lead, self._free) if self._timed else now
        self._free = start + len(data) * byte
        if self._of_kind("echo"):
            self._put(self._free, self._free, data)
        if self._timed and self._quiet > now + _TOLERANCE:
            self._collide(now)
            return
        for packet, end in self._parse(data):
            self._hear(packet, start + end * byte, byte, plant_time, baud)

    def _parse(self, data: bytes) -> list[tuple[Instruction, int]]:
        """Instructions of the protocols that servos here speak, and where in `data` they end."""
        found = []
        for protocol in {servo.protocol for servo in self.bus.servos} - {0}:
            parser = self._parsers[protocol]
            taken = parser.taken
            found += [(packet, packet.end - taken) for packet in parser.feed(data)]
        if len(found) > 1:
            found.sort(key=lambda entry: entry[1])
        return found

    def _forget_packet(self) -> None:
        for parser in self._parsers.values():
            parser.reset()

    def _collide(self, now: float) -> None:
        """The client talks while servos do: what is under way from both sides is lost."""
        self.statistics.collisions += 1
        self._pieces = [piece for piece in self._pieces if piece[2] <= now]
        heapq.heapify(self._pieces)
        self._quiet = now
        self._forget_packet()

    def _hear(
        self, packet: Instruction, end: float, byte: float, plant_time: float, baud: int
    ) -> None:
        self.statistics.instructions += 1
        self.statistics.damaged += not packet.intact
        self._trace(packet, end)
        if self.faults and any(active.hits(packet.id) for active in self._of_kind("lost")):
            return
        fault = self._tampering(packet) if self.faults else None
        if fault is None:
            self._carry_out(packet, end, byte, plant_time, baud)
            return
        self.statistics.tampered += 1
        if fault["effect"] == "doubled":
            self._carry_out(packet, end, byte, plant_time, baud)
            self._carry_out(packet, end, byte, plant_time, baud)
        elif fault["effect"] == "late":
            later = float(fault["seconds"])
            heard = partial(self._carry_out, packet, end + later, byte, plant_time + later, baud)
            deferred: Deferred = (end + later, next(self._numbers), heard)
            heapq.heappush(self._deferred, deferred)

    def _tampering(self, packet: Instruction) -> Mapping[str, Any] | None:
        """The parameters of a fault that hits this very instruction."""
        for active in self._of_kind("message"):
            wanted = active.fault.parameters
            wide = packet.protocol
            address = int.from_bytes(packet.parameters[:wide], "little")
            if wanted["code"] in (ANY, packet.code) and wanted["address"] in (ANY, address):
                active.seen += 1
                if 0 <= active.seen - wanted["number"] < wanted["times"]:
                    return wanted
        return None

    def _carry_out(
        self, packet: Instruction, end: float, byte: float, plant_time: float, baud: int
    ) -> None:
        replies = self.bus.answer(packet, baud, plant_time)
        if len(replies) > 1 and packet.id != BROADCAST:
            replies = [_at_once(replies)]
        if replies:
            self._send(replies, end, byte)

    # To the client

    def _send(self, replies: list[Reply], end: float, byte: float) -> None:
        """Let servos send one after the other, from the `end` of the instruction on."""
        time = end
        held = bytearray()
        held_since = end
        for reply in replies:
            if reply.packet is None:
                if self._chain_policy(reply.number) == "stalls":
                    break
                time += _TURN
                continue
            start = time + reply.delay if self._timed else time
            if held and start - held_since > _LUMP:
                self._put(self._handed_over(time), time, bytes(held))
                held.clear()
            if not held:
                held_since = start
            time = start + len(reply.packet) * byte
            packet, later = self._spoil(reply) if self.faults else (reply.packet, 0.0)
            if later > 0.0:
                self._put(self._handed_over(time + later), time, packet)
            else:
                held += packet
        self._quiet = max(self._quiet, time)
        if held:
            self._put(self._handed_over(time), time, bytes(held))

    def _chain_policy(self, number: int) -> str:
        active = self._silences(number)
        return self._chain if active is None else str(active.fault.parameters["chain"])

    def _spoil(self, reply: Reply) -> tuple[bytes, float]:
        """What the faults of the wire make of a status packet, and by how much it is late."""
        packet = reply.packet or b""
        for kind, change in REPLIES.items():
            for active in self._of_kind(kind):
                if active.hits(reply.number) and packet:
                    packet = change(packet, active.fault.parameters, self._generator)
        late = [a for a in self._of_kind("late") if a.hits(reply.number)]
        return packet, max((a.fault.parameters["seconds"] for a in late), default=0.0)

    def _handed_over(self, time: float) -> float:
        latency = self.latency
        return math.ceil(time / latency) * latency if latency > 0.0 else time

    def _put(self, time: float, wire_end: float, data: bytes) -> None:
        if data:
            heapq.heappush(self._pieces, (time, next(self._numbers), wire_end, data))

    @property
    def due(self) -> float:
        """When bytes are handed over or a late instruction is heard next; infinity if never."""
        handed = self._pieces[0][0] if self._pieces and not self._holds else math.inf
        return min(handed, self._deferred[0][0]) if self._deferred else handed

    def deliver(self, now: float) -> None:
        """Hand over what is due."""
        statistics = self.statistics
        while self._deferred and self._deferred[0][0] <= now:
            heapq.heappop(self._deferred)[2]()
        while self._pieces and not self._holds and self._pieces[0][0] <= now:
            due, _, _, data = heapq.heappop(self._pieces)
            sent = self.port.write(data) if self.port.plugged else len(data)
            statistics.bytes_out += sent
            statistics.overruns += len(data) - sent
            statistics.deliveries += 1
            statistics.late += now - due
            statistics.worst = max(statistics.worst, now - due)

    def unplug(self) -> None:
        """Take the adapter away, with all that was under way."""
        self._pieces.clear()
        self._deferred.clear()
        self._forget_packet()
        self.port.unplug()

    def describe(self) -> dict[str, Any]:
        """What a person wants to know, ready for JSON."""
        return {
            "tty": self.port.tty.name if self.port.plugged else "",
            "link": str(self.port.tty.link),
            "clients": self.port.clients,
            "baud": self.port.baud if self.port.plugged else 0,
            **vars(self.statistics),
        }


def _at_once(replies: list[Reply]) -> Reply:
    """What several servos with one id put on the wire together."""
    packet = b""
    for reply in replies:
        packet = overlay(packet, reply.packet or b"")
    return Reply(replies[0].number, replies[0].delay, packet)
