"""The options of the simulated controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.galil.models import MODELS
from crtk_sim_backends.kit import Options, check_choice, check_port, check_range, option


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim galil``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The controller": ("model", "axes", "revision", "sample_time", "echo"),
        "Its axes, in counts": ("travel", "home_at", "index_every", "start"),
        "Ports": ("tcp_port", "udp_port"),
        **Options.HEADINGS,
    }

    model: str = option("4143", "which controller", choices=tuple(MODELS))
    axes: int = option(4, "how many axes it has")
    revision: str = option("", "what it calls itself; that of its model if empty")
    sample_time: int = option(1000, "what it calls the length of a sample, in µs (TM)")
    echo: bool = option(False, "it repeats each command until EO 0")
    travel: int = option(60_000, "limit switches at so many counts on both sides of 0")
    home_at: int = option(20_000, "the home switch is active from there on, in counts")
    index_every: int = option(4000, "counts from one index pulse to the next")
    start: int = option(0, "where the axes are at the start, in counts")
    tcp_port: int = option(0, "TCP port of the commands (23 on hardware); 0: any free one")
    udp_port: int = option(0, "UDP port of the data records; 0: any free one")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS, "controller")
        check_range("axes", self.axes, 1, 8)
        check_range("sample_time", self.sample_time, 62, 20_000)
        check_range("travel", self.travel, 1000, 2**33)
        check_range("home_at", self.home_at, -(2**33), 2**33)
        check_range("index_every", self.index_every, 4, 1_000_000)
        check_range("start", self.start, -self.travel, self.travel)
        for name in ("tcp_port", "udp_port"):
            check_port(name, getattr(self, name))
