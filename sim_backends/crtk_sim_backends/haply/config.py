"""The options of the simulated service."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Final

from typing_extensions import override

from crtk_sim_backends.kit import (
    ConfigError,
    Options,
    check_choice,
    check_port,
    check_range,
    option,
)

VERSIONS: Final = ("3.5", "3.0")
GRIPS: Final = ("wireless", "wired", "custom", "none")


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim haply``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The service": ("version", "port", "idle_after"),
        "Its devices": ("device_id", "grip", "grip_id"),
        "The handle": ("mass", "damping", "radius"),
        **Options.HEADINGS,
    }

    version: str = option("3.5", "which messages it speaks", choices=VERSIONS)
    port: int = option(0, "its simulation channel (10001 on hardware); 0: any free one")
    idle_after: float = option(
        0.1, "seconds without a command after which no force is exerted; 0: the last one goes on"
    )
    device_id: str = option("049D", "of the Inverse3")
    grip: str = option("wireless", "which VerseGrip there is", choices=GRIPS)
    grip_id: str = option("61548", "of the VerseGrip")
    mass: float = option(0.15, "of what a force moves, in kg")
    damping: float = option(0.8, "of its motion, in N·s/m")
    radius: float = option(0.12, "of the ball in which the handle moves, in m")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("version", self.version, VERSIONS, "version")
        check_choice("grip", self.grip, GRIPS, "VerseGrip")
        check_port("port", self.port)
        check_range("idle_after", self.idle_after, 0.0, 60.0)
        check_range("mass", self.mass, 0.01, 10.0)
        check_range("damping", self.damping, 0.0, 100.0)
        check_range("radius", self.radius, 0.01, 1.0)
        for name in ("device_id", "grip_id"):
            if not getattr(self, name):
                raise ConfigError(f"{name} is empty")
