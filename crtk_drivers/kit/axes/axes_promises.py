"""What axes of a controller can do and how they stop, as a device declares it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from crtk_drivers.config import AxisJoint
from crtk_drivers.device import Capabilities, Following, Mode, StopPolicy

__all__ = ["braking_time", "following_of", "promises"]

SLOWED: Final = 0.5
"""Seconds beyond the time of braking in which joints stand after a stop."""


def braking_time(joints: Iterable[AxisJoint]) -> float:
    """Return the seconds in which all of them come to rest within their accelerations."""
    return max((joint.velocity / joint.acceleration for joint in joints), default=0.0)


def following_of(joints: Sequence[AxisJoint], lag: float) -> Following | None:
    """Return how closely such joints follow positions; None: there are none.

    Args:
        joints: in the order of the device.
        lag: see `Following`.
    """
    if not joints:
        return None
    return Following(
        error=tuple(joint.following for joint in joints),
        arrival=tuple(joint.arrives_within for joint in joints),
        lag=lag,
    )


def promises(
    joints: Mapping[str, AxisJoint],
    *,
    rate: float,
    units: Sequence[float],
    lag: float,
    runs_on: float,
    stops: str,
    needs_homing: bool,
    transition_timeout: float,
) -> Capabilities:
    """Return the capabilities of axes that follow positions, and velocities as positions (`StreamGoal`).

    Args:
        joints: by name, in the order of joint vectors.
        rate: samples a second, which the controller's own clock makes.
        units: rad/s (m/s) of one step of each measured velocity.
        lag: see `Following`.
        runs_on: seconds in which axes rest that are sent nothing any more.
        stops: what they do then and at a stop, in words.
        needs_homing: a joint is homed.
        transition_timeout: seconds.
    """
    return Capabilities(
        joints=tuple(joints),
        joint_units=tuple("rad" if each.kind == "revolute" else "m" for each in joints.values()),
        limits=tuple(joint.limits for joint in joints.values()),
        modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}),
        needs_homing=needs_homing,
        rate=rate,
        paced_by_stream=True,
        writes_every_cycle=True,
        transition_timeout=transition_timeout,
        stop=StopPolicy(runs_on, stops, time=braking_time(joints.values()) + SLOWED),
        following=following_of(list(joints.values()), lag),
        velocity_resolution=tuple(units),
    )
