"""The boards on their bus, faults, and who is asked what. No sockets."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from crtk_sim_backends.dvrk import wire
from crtk_sim_backends.dvrk.axis import Load
from crtk_sim_backends.dvrk.board import AXES, Board
from crtk_sim_backends.dvrk.config import HIGHEST_BOARD, SimConfig
from crtk_sim_backends.faults import Fault, FaultKind, Parameter
from crtk_sim_backends.kit.datagrams import EVERY, STREAM, STREAM_KINDS, FaultyWay

HUB: Final = 0
"""Node of the board with the Ethernet cable."""

_NODE = Parameter(int, 0, minimum=0, maximum=HIGHEST_BOARD)
_AXIS = Parameter(int, 0, minimum=0, maximum=AXES - 1)


def _kind(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters, lasting=True)


KINDS: Final[dict[str, FaultKind]] = {
    **STREAM_KINDS,
    **{
        kind.name: kind
        for kind in (
            _kind("silence", "no board answers"),
            _kind("mute", "one board does not answer", node=_NODE),
            _kind("delay", "answers come late",
                  seconds=Parameter(float, 0.1, minimum=0.001, maximum=10.0)),
            FaultKind("bus_reset", "the FireWire bus is reset", {}),
            FaultKind("restart", "a board starts anew: no power, encoders from the middle",
                      {"node": _NODE}),
            FaultKind("watchdog", "the watchdog of a board expires", {"node": _NODE}),
            _kind("other_board", "another board answers in its place", node=_NODE,
                  number=Parameter(int, 9, minimum=0, maximum=HIGHEST_BOARD)),
            _kind("other_firmware", "a board starts anew with another firmware", node=_NODE,
                  version=Parameter(int, 7, minimum=1, maximum=100)),
            _kind("supply_off", "motors have no voltage", node=_NODE),
            _kind("supply_fault", "over-voltage or over-current of the motors", node=_NODE),
            _kind("relay_open", "the safety relay stays open", node=_NODE),
            _kind("encoder_supply", "encoders have no good supply", node=_NODE),
            _kind("encoder_overflow", "an encoder has counted beyond its range", node=_NODE, axis=_AXIS),
            _kind("encoder_error", "A and B of an encoder change at once", node=_NODE, axis=_AXIS),
            _kind("amplifier", "an amplifier is too hot", node=_NODE, axis=_AXIS),
            _kind("trip", "the current is not what was asked for", node=_NODE, axis=_AXIS),
            _kind("encoder_velocity", "an encoder tells a velocity that it does not have",
                  node=_NODE, axis=_AXIS),
            _kind("amplifier_sticks", "an amplifier cannot be switched off", node=_NODE, axis=_AXIS),
            _kind("amplifier_dead", "an amplifier cannot be switched on", node=_NODE, axis=_AXIS),
            _kind("power_sticks", "power of the motors cannot be switched off", node=_NODE),
            _kind("heat", "amplifiers are hot", node=_NODE,
                  celsius=Parameter(float, 70.0, minimum=0.0, maximum=127.0)),
            _kind("current", "another current is measured than flows", node=_NODE, axis=_AXIS,
                  by=Parameter(float, -1.0, minimum=-12.0, maximum=12.0)),
            _kind("potentiometer", "a potentiometer has slipped", node=_NODE, axis=_AXIS,
                  by=Parameter(float, 20_000.0, minimum=-300_000.0, maximum=300_000.0)),
            _kind("write_loss", "the last `burst` of every n writes are lost", every=EVERY,
                  burst=Parameter(int, 1, minimum=1)),
            _kind("write_duplicate", "every n-th write arrives twice", every=EVERY),
            _kind("write_late", "every n-th write is overtaken by later ones", every=EVERY,
                  by=Parameter(int, 2, minimum=1, maximum=10_000)),
        )
    },
}  # fmt: skip

_FLAGS: Final[Mapping[str, tuple[str, bool]]] = {
    "supply_off": ("supply", False),
    "supply_fault": ("supply_fault", True),
    "relay_open": ("relay_sticks", True),
    "encoder_supply": ("encoder_supply_fault", True),
    "power_sticks": ("power_sticks", True),
}
"""Attribute of a board, and what it is while a fault lasts."""

_OF_AXES: Final[Mapping[str, str]] = {
    "encoder_overflow": "overflow",
    "encoder_error": "jumped",
    "amplifier": "overheated",
    "trip": "tripped",
    "encoder_velocity": "runs_wild",
    "amplifier_sticks": "sticks",
    "amplifier_dead": "dead",
}

_AMOUNTS: Final[Mapping[str, str]] = {"current": "current_error", "potentiometer": "sensor_error"}
"""Attribute of an axis that a fault makes another one than 0."""

_COOL: Final = 31.0
"""°C."""

_WRITES: Final = "write_"
"""Begins the kinds that are on the way of writes to the boards."""


class Controller:
    """The controller.

    Args:
        config: its options.
        clock: monotonic s.
    """

    def __init__(self, config: SimConfig, clock: Callable[[], float] = time.monotonic) -> None:
        self.kinds = KINDS
        self.config = config
        self.faults: dict[str, Mapping[str, Any]] = {}
        self.generation = 1
        self._clock = clock
        self._way = FaultyWay()
        self._writes = FaultyWay()
        self._errors = self._heard = 0
        self.boards = [
            Board(
                number,
                config.hardware,
                config.firmware,
                config.fpga,
                clock(),
                load=Load(config.gravity, config.friction),
                power_delay=config.power_delay,
                patience=config.patience,
            )
            for number in config.numbers
        ]

    # Faults

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        kind, parameters = fault.kind, fault.parameters
        board = self._board(parameters)
        if kind in STREAM:
            self._way.begin(kind, STREAM[kind](parameters))
        elif kind.startswith(_WRITES):
            stream = STREAM[kind.removeprefix(_WRITES)]
            self._writes.begin(kind, stream(parameters))
        elif kind in _AMOUNTS:
            setattr(board.axes[parameters["axis"]], _AMOUNTS[kind], parameters["by"])
        elif kind == "heat":
            board.celsius = parameters["celsius"]
        elif kind in _FLAGS:
            setattr(board, *_FLAGS[kind])
        elif kind in _OF_AXES:
            setattr(board.axes[parameters["axis"]], _OF_AXES[kind], True)
        elif kind == "bus_reset":
            self.generation += 1
        elif kind == "watchdog":
            board.expire()
        elif kind == "restart":
            self._restart(board)
        elif kind == "other_board":
            board.number = parameters["number"]
        elif kind == "other_firmware":
            board.firmware = parameters["version"]
            self._restart(board)
        else:
            self.faults[kind] = parameters

    def end(self, fault: Fault) -> None:
        """Let it end."""
        kind, parameters = fault.kind, fault.parameters
        board = self._board(parameters)
        self._way.end(kind)
        self._writes.end(kind)
        self.faults.pop(kind, None)
        if kind in _FLAGS:
            name, value = _FLAGS[kind]
            setattr(board, name, not value)
        elif kind in _OF_AXES:
            setattr(board.axes[parameters["axis"]], _OF_AXES[kind], False)
        elif kind in _AMOUNTS:
            setattr(board.axes[parameters["axis"]], _AMOUNTS[kind], 0.0)
        elif kind == "heat":
            board.celsius = _COOL
        elif kind == "other_board":
            board.number = self.config.numbers[self.boards.index(board)]
        elif kind == "other_firmware":
            board.firmware = self.config.firmware
            self._restart(board)

    def _board(self, parameters: Mapping[str, Any]) -> Board:
        node: int = parameters.get("node", HUB)
        return self.boards[min(node, len(self.boards) - 1)]

    def _restart(self, board: Board) -> None:
        board.restart()
        self.generation += 1

    # Requests of the control door

    def turn(self, node: int = 0, axis: int = 0, velocity: float | None = None) -> None:
        """Let somebody move a motor by hand, at counts/s; None: let go."""
        self.advance()
        self.boards[node].axes[axis].hand = velocity

    def place(self, node: int = 0, axis: int = 0, counts: float = 0.0) -> None:
        """Put a motor somewhere."""
        self.boards[node].axes[axis].position = counts

    def press(self, node: int = 0, bit: int = 0, *, high: bool = True) -> None:
        """Let a digital input be high or low."""
        board = self.boards[node]
        board.inputs = board.inputs | 1 << bit if high else board.inputs & ~(1 << bit)

    # Time and datagrams

    def advance(self) -> None:
        """Let all boards come to the present."""
        now = self._clock()
        for board in self.boards:
            board.advance(now)

    def datagram(self, data: bytes) -> list[bytes]:
        """Take a datagram, and return what is sent in answer."""
        self._heard += 1
        asked = wire.request(data)
        if asked is None:
            self._errors += 1
            return []
        if "silence" in self.faults:
            return []
        self.advance()
        reads = asked.code in (wire.QUADLET_READ, wire.BLOCK_READ)
        if asked.node != wire.EVERYBODY and asked.generation != self.generation & 0xFF:
            return self._through(wire.extra(wire.DROPPED, self.generation, self._errors), reads)
        if not reads:
            for arrived in self._writes.through([data]):
                self._carry_out(arrived)
            return []
        node = HUB if asked.node == wire.EVERYBODY else asked.node
        mute = self.faults.get("mute")
        is_there = node < len(self.boards) and (node == HUB or asked.forward)
        if not is_there or (mute is not None and mute["node"] == node):
            return []
        board = self.boards[node]
        quadlets = self._read(board, asked)
        flags = 0 if asked.forward else 0x10
        told = wire.answer(asked, node, quadlets, sealed=node != HUB)
        return self._through(told + wire.extra(flags, self.generation, self._errors), reads)

    def _carry_out(self, data: bytes) -> None:
        asked = wire.request(data)
        if asked is not None:
            for board in self._written(asked):
                self._write(board, asked)

    def _through(self, data: bytes, is_sent: bool) -> list[bytes]:
        return self._way.through([data]) if is_sent else []

    def _written(self, asked: wire.Request) -> list[Board]:
        if asked.node == wire.EVERYBODY:
            return self.boards if asked.forward else self.boards[:1]
        return self.boards[asked.node : asked.node + 1]

    @staticmethod
    def _write(board: Board, asked: wire.Request) -> None:
        if asked.code == wire.QUADLET_WRITE:
            board.write(asked.address, asked.data[0])
        elif asked.address == 0:
            board.write_block(asked.data)

    @staticmethod
    def _read(board: Board, asked: wire.Request) -> list[int]:
        if asked.code == wire.QUADLET_READ:
            return [board.read(asked.address)]
        return board.read_block(asked.address, asked.size)

    def status(self) -> dict[str, Any]:
        """What a test or a person wants to know."""
        self.advance()
        return {
            "generation": self.generation,
            "datagrams": self._heard,
            "damaged": self._errors,
            "boards": [board.describe() for board in self.boards],
        }
