"""A simulated Touch: a library that stands for OpenHaptics' libHD.

:data:`SIM` starts it; ``python -m crtk_sim_backends.openhaptics`` runs it alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from typing_extensions import override

from crtk_sim_backends.haptics import LibrarySimulator
from crtk_sim_backends.kit import FaultKind, Options, RunningSim, option

__all__ = ["SIM", "OpenHapticsSimulator", "RunningSim", "SimConfig"]

KINDS: Final = {
    kind.name: kind
    for kind in (
        FaultKind("initialized", "the stylus is put into the inkwell, which calibrates it"),
        FaultKind(
            "home_fails", "its calibration needs nobody, and does not come to an end", lasting=True
        ),
        FaultKind("saturated", "a force error, which switches its forces off", lasting=True),
    )
}


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim openhaptics``."""

    initialized: bool = option(True, "it is calibrated")


class OpenHapticsSimulator(LibrarySimulator[SimConfig]):
    """The device as a plug-in."""

    name = "openhaptics"
    summary = "Touch of OpenHaptics: a library in place of libHD"
    Config = SimConfig
    source = Path(__file__).with_name("hd.c")
    library = "libHD.so"
    own_kinds = KINDS

    @override
    def fields(self, config: SimConfig) -> Mapping[str, float]:
        """Return how the device is at the start."""
        return {"initialized": config.initialized}


SIM: Final = OpenHapticsSimulator()
