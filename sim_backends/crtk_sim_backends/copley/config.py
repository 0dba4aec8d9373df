"""The options of the simulated drives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.kit import Options, check_port, check_range, option


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim copley``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The drives": ("nodes", "firmware", "pvt_places", "echo", "line_time"),
        "Their axes, in counts": ("travel", "home_at", "index_every", "motor_speed", "start"),
        "Ports": ("tcp_port",),
        **Options.HEADINGS,
    }

    nodes: int = option(3, "how many drives: node 0 at the line, the others behind it")
    firmware: int = option(0x0340, "version * 256 + revision (0x94); below 0x0100 it knows no PVT")
    pvt_places: int = option(32, "points that fit in the buffer of a drive")
    echo: bool = option(False, "the line repeats each command")
    line_time: bool = option(
        False, "answers take the time that bytes need on the line, and 1 ms in the drive"
    )
    travel: int = option(60_000, "limit switches at so many counts on both sides of 0")
    home_at: int = option(20_000, "the home switch is active from there on, in counts")
    index_every: int = option(4000, "counts from one index pulse to the next")
    motor_speed: int = option(80_000, "how fast its motors turn at most, in counts/s")
    start: int = option(0, "where the axes are at the start, in counts")
    tcp_port: int = option(0, "TCP port of a serial server at 9600 bit/s; 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("nodes", self.nodes, 1, 16)
        check_range("firmware", self.firmware, 0, 0xFFFF)
        check_range("pvt_places", self.pvt_places, 4, 64)
        check_range("travel", self.travel, 1000, 2**33)
        check_range("home_at", self.home_at, -(2**33), 2**33)
        check_range("index_every", self.index_every, 4, 1_000_000)
        check_range("motor_speed", self.motor_speed, 1000, 10_000_000)
        check_range("start", self.start, -self.travel, self.travel)
        check_port("tcp_port", self.tcp_port)
