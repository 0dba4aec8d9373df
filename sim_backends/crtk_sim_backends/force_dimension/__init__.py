"""Simulated Force Dimension devices: a library that stands for the vendor's libdrd.

:data:`SIM` starts it; ``python -m crtk_sim_backends.force_dimension`` runs it alone. Any program that loads
``libdrd.so`` by its path may use it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from typing_extensions import override

from crtk_sim_backends.haptics import LibrarySimulator
from crtk_sim_backends.kit import (
    FaultKind,
    Options,
    RunningSim,
    check_choice,
    check_range,
    option,
)

__all__ = ["MODELS", "SIM", "ForceDimensionSimulator", "RunningSim", "SimConfig"]

MODELS: Final = (
    "omega.3",
    "omega.6",
    "omega.7",
    "delta.3",
    "delta.6",
    "sigma.7",
    "lambda.7",
    "falcon",
)
"""In the order of the table in ``dhd.c``."""

KINDS: Final = {
    kind.name: kind
    for kind in (
        FaultKind("home_fails", "drdAutoInit fails", lasting=True),
        FaultKind("saturated", "forces are told to saturate the motors", lasting=True),
        FaultKind("time_guard", "the same is read again and again", lasting=True),
        FaultKind("keeps_gravity", "gravity compensation stays as it is", lasting=True),
    )
}


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim force-dimension``."""

    model: str = option("omega.7", f"the device: {', '.join(MODELS)}")
    left: bool = option(False, "it is left-handed")
    initialized: bool = option(True, "it knows where it is already; if false, home moves it first")
    home_time: float = option(0.3, "seconds that drdAutoInit takes")
    version: int = option(3, "major version of the SDK that the library says it is")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("model", self.model, MODELS)
        check_range("home_time", self.home_time, 0.0, 60.0)
        check_range("version", self.version, 0, 99)


class ForceDimensionSimulator(LibrarySimulator[SimConfig]):
    """The device as a plug-in."""

    name = "force-dimension"
    summary = (
        "Force Dimension device (omega, delta, sigma, lambda, Falcon): a library in place of libdrd"
    )
    Config = SimConfig
    source = Path(__file__).with_name("dhd.c")
    library = "libdrd.so"
    own_kinds = KINDS

    @override
    def fields(self, config: SimConfig) -> Mapping[str, float]:
        """Return how the device is at the start."""
        return {
            "model": MODELS.index(config.model),
            "is_left": config.left,
            "initialized": config.initialized,
            "home_time": config.home_time,
            "version": config.version,
            "gripper": 0.3,
        }


SIM: Final = ForceDimensionSimulator()
