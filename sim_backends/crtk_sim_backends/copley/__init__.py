"""Simulated Copley drives: node 0 at a serial line, the others behind it, with axes that move.

:data:`SIM` starts them; ``python -m crtk_sim_backends.copley`` runs them alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

from typing_extensions import override

from crtk_sim_backends.copley.axis import STEP
from crtk_sim_backends.copley.config import SimConfig
from crtk_sim_backends.copley.drives import FIRST_BAUD, Drives
from crtk_sim_backends.kit import LoopServer, RunningSim, Simulator, TcpDoor
from crtk_sim_backends.page import Gauge, Gauges

__all__ = ["SIM", "CopleySimulator", "RunningSim", "SimConfig"]

LONGEST: Final = 200
"""Bytes of a command; what is longer is forgotten."""
_TURNAROUND: Final = 0.001
_BITS: Final = 10
_BREAK: Final = b"\0"
"""What a break is on a line that carries none."""


class LineSession:
    """One program at the line.

    Args:
        drives: that hear it.
        hears: whether its rate is that of the drives.
        later: lets an answer be sent later.
        rate: of the line, in bit/s.
    """

    ended = False

    def __init__(
        self,
        drives: Drives,
        hears: Callable[[], bool],
        later: Callable[[float, bytes], object],
        rate: Callable[[], int],
    ) -> None:
        self._drives = drives
        self._hears = hears
        self._later = later
        self._rate = rate
        self._rest = b""
        self._free = 0.0  # monotonic s at which the line is free

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the answers that come at once."""
        if _BREAK in data:
            self._drives.baud = FIRST_BAUD
            self._rest, data = b"", data.rpartition(_BREAK)[2]
        if not self._hears():
            self._rest = b""
            return b""
        *lines, self._rest = (self._rest + data).split(b"\r")
        if len(self._rest) > LONGEST:
            self._rest = b""
        return b"".join(self._answer(line) for line in lines)

    def _answer(self, line: bytes) -> bytes:
        rate = self._rate()
        answer = self._drives.obey(line.decode("ascii", "replace"))
        late = self._drives.faults["late"]["seconds"] if self._drives.strikes("late") else 0.0
        if self._drives.config.line_time:
            now = time.monotonic()
            takes = (len(line) + 1 + len(answer)) * _BITS / rate + _TURNAROUND
            self._free = max(self._free, now) + takes
            late += self._free - now
        if not late or not answer:
            return answer
        self._later(late, answer)
        return b""

    def close(self) -> None:
        """Forget an unfinished command."""
        self._rest = b""


def _gauges(drives: Drives) -> list[Gauges]:
    travel = float(drives.config.travel)
    gauges: list[Gauge] = [
        {"name": f"node {node}", "low": -travel, "high": travel, "value": drive.axis.position}
        for node, drive in enumerate(drives.drives)
    ]
    return [{"title": "Axes", "unit": "counts", "rate": "", "digits": 0, "gauges": gauges}]


class CopleySimulator(Simulator[SimConfig, LoopServer]):
    """The drives as a plug-in."""

    name = "copley"
    summary = "Copley drives at a serial line, with axes that move, limit and home switches"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind the line."""
        drives = Drives(config)

        def later(name: str) -> Callable[[float, bytes], object]:
            return lambda seconds, data: server.after(seconds, lambda: server.send(name, data))

        def serial() -> LineSession:
            return LineSession(
                drives,
                lambda: server.baud("serial") == drives.baud,
                later("serial"),
                lambda: drives.baud,
            )

        def behind_server() -> LineSession:
            return LineSession(
                drives, lambda: drives.baud == FIRST_BAUD, later("server"), lambda: FIRST_BAUD
            )

        server = LoopServer(
            config,
            parent_fd,
            drives,
            title="Copley drives",
            tcp={"server": TcpDoor(config.tcp_port, behind_server, 1)},
            ttys={"serial": serial},
            gauges=lambda: _gauges(drives),
            requests={"place": drives.place, "points": drives.points},
        )
        server.every(STEP, drives.step)
        return server


SIM: Final = CopleySimulator()
