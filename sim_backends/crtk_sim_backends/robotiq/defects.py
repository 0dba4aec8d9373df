"""Defects of a simulated gripper, for a bench that must find them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class GripperDefects:
    """What is wrong with a gripper.

    Attributes:
        short: m of the stroke before its end at which the fingers stop as they close.
        blind: 1: it never says that something has stopped the fingers.
        imagines: 1: it says so whenever they have closed.
        gives_way: m by which the fingers open, a second after they have begun to hold something.
        force_scale: factor on the force of its grip.
    """

    short: float = 0.0
    blind: int = 0
    imagines: int = 0
    gives_way: float = 0.0
    force_scale: float = 1.0
