"""Defects of a simulated tracker, for a bench that must find them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TrackerDefects:
    """What is wrong with what a tracker tells.

    Attributes:
        scale: factor on all positions.
        missing: share of the frames in which a tool is not seen.
        tells_covered: 1: a tool that is hidden is told as if it were seen.
        play: of a marker on what moves it, in mm; see `crtk_sim_backends.ndi.track.Play`.
    """

    scale: float = 1.0
    missing: float = 0.0
    tells_covered: int = 0
    play: float = 0.0
