"""From how far the leader's gripper is open to where the follower's jaw is sent. Pure.

After each coupling the jaw stays as it is until the leader's gripper has come to where the jaw is: whoever
presses the pedal with an open hand drops nothing. From there it follows, no faster than its speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from crtk_drivers.motion.teleop.teleop_settings import GripperSettings
from crtk_drivers.samples import JointState

__all__ = ["Jaw", "begun", "led", "opening_of", "share_of"]

LARGEST = 1e9
"""In rad or m: what is beyond is no measurement."""


@dataclass(frozen=True, slots=True)
class Jaw:
    """A jaw that is coupled.

    Attributes:
        at: where it is sent, or is as long as it is sent nothing; rad (m).
        wished: where the leader wanted it in the step before.
        is_led: the leader's gripper has been where the jaw is since they were coupled.
    """

    at: float
    wished: float
    is_led: bool = False


def opening_of(joint: JointState) -> float | None:
    """Return the position of the one joint that a gripper has, rad (m); None if it tells no such thing."""
    if joint.position.size != 1:
        return None
    value = float(joint.position[0])
    return value if abs(value) <= LARGEST else None


def wish_of(settings: GripperSettings, leader: float) -> float:
    """Return where a leader that is so far open wants the jaw: within its two ends, rad (m)."""
    share = (leader - settings.leader_closed) / (settings.leader_open - settings.leader_closed)
    way = settings.follower_open - settings.follower_closed
    return settings.follower_closed + min(max(share, 0.0), 1.0) * way


def share_of(settings: GripperSettings, at: float) -> float:
    """Return how far the leader's gripper is to be opened, 0 to 1, to be where the jaw is."""
    way = settings.follower_open - settings.follower_closed
    return min(max((at - settings.follower_closed) / way, 0.0), 1.0)


def begun(settings: GripperSettings, leader: float, jaw: float) -> Jaw:
    """Return the jaw as they are coupled: where it is, and led by nobody yet."""
    return Jaw(jaw, wish_of(settings, leader))


def led(settings: GripperSettings, before: Jaw, leader: float, dt: float) -> Jaw:
    """Return it `dt` s later; it is led once the leader's gripper was near where it is, or has passed it."""
    wish = wish_of(settings, leader)
    meets = before.is_led or _meets(settings, before, wish)
    if not meets:
        return Jaw(before.at, wish)
    step = settings.speed * dt
    way = wish - before.at
    at = wish if abs(way) <= step else before.at + math.copysign(step, way)
    return Jaw(at, wish, is_led=True)


def _meets(settings: GripperSettings, before: Jaw, wish: float) -> bool:
    way = settings.follower_open - settings.follower_closed
    there = (
        settings.follower_closed + share_of(settings, before.at) * way
    )  # it may be beyond its ends
    has_passed = (before.wished - there) * (wish - there) < 0.0
    return has_passed or abs(wish - there) <= settings.near * abs(way)
