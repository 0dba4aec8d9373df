"""A simulated OptoForce unit with one sensor of three or six axes, or four of three.

:data:`SIM` starts it; ``python -m crtk_sim_backends.optoforce`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import (
    LoopServer,
    Options,
    RunningSim,
    Simulator,
    check_choice,
    check_range,
    option,
)
from crtk_sim_backends.optoforce.line import Host, Line
from crtk_sim_backends.optoforce.unit import AXES, PERIOD, Unit

__all__ = ["SIM", "OptoForceSimulator", "RunningSim", "SimConfig"]


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim optoforce``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The sensor": ("sensor", "noise", "mute"),
        **Options.HEADINGS,
    }

    sensor: str = option("3-axis", "what hangs at the unit", AXES)
    noise: float = option(0.02, "standard deviation of each force, in N; a tenth of it in N·m")
    mute: bool = option(False, "it does not tell its serial number")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("sensor", self.sensor, AXES)
        check_range("noise", self.noise, 0.0, 10.0)


class OptoForceSimulator(Simulator[SimConfig, LoopServer]):
    """The unit as a plug-in."""

    name = "optoforce"
    summary = "OptoForce force sensor (3 axes, 6 axes, four times 3 axes) that can be loaded"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Make its serial line."""
        unit = Unit(config.sensor, config.noise)
        line = Line(unit, mute=config.mute)
        server = LoopServer(
            config,
            parent_fd,
            line,
            title=f"OptoForce {config.sensor}",
            ttys={"serial": lambda: Host(line)},
            gauges=unit.gauges,
        )

        def tick() -> None:
            if data := line.advance():
                server.send("serial", data)

        server.every(PERIOD, tick)
        return server


SIM: Final = OptoForceSimulator()
