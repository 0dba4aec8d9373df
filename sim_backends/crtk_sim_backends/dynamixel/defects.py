"""Defects of simulated servos, for a bench that must find them."""

from __future__ import annotations

from dataclasses import dataclass

from crtk_sim_backends.defects import JointDefects


@dataclass(frozen=True, kw_only=True)
class ServoDefects(JointDefects):
    """What is wrong with a servo; angles in rad of its horn, joints by their ids.

    Attributes:
        jump_on_enable: by which it moves when torque goes on, until it has another goal.
        following_offset: by which it rests beside its goal.
        ignores_watchdog: 1: its bus watchdog never trips.
    """

    jump_on_enable: float = 0.0
    following_offset: float = 0.0
    ignores_watchdog: int = 0
