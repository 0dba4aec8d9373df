"""What an arm of drives can do and how it stops, as its configuration tells before any drive was asked."""

from __future__ import annotations

import math
from typing import Final

from crtk_driver_canopen.braking import braking_time
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.modes import Way
from crtk_driver_canopen.motion import STREAMED
from crtk_drivers.device import Capabilities, Following, JointLimits, StopPolicy

__all__ = ["capabilities_of"]

STOP_TIME: Final = 1.0
"""Seconds beside those of slowing down in which a stop is done: modes change, drives are insisted on."""
LAG: Final = 0.05
"""Seconds by which a joint may be behind its setpoint, beside the cycles that it takes on the bus."""
JERK_TIME: Final = 0.1
"""Seconds in which a joint may reach its greatest acceleration, unless its jerk is configured."""


def capabilities_of(config: CanopenConfig) -> Capabilities:
    """Return what an arm of this configuration declares."""
    joints = config.joints
    modes = {mode for mode, way in STREAMED.items() if way in config.ways}
    timeout = config.heartbeat.ours_timeout
    unasked = [name for name, joint in joints.items() if joint.abort_option in (None, 0)]
    what = "each drive stops by itself when it misses our heartbeat" if timeout else "nothing"
    if timeout and unasked:
        what += f", but what is set in the drive decides for {', '.join(unasked)}"
    return Capabilities(
        joints=tuple(joints),
        joint_units=tuple("rad" if each.kind == "revolute" else "m" for each in joints.values()),
        limits=tuple(map(_limits, joints.values())),
        modes=frozenset(modes),
        native_moves=frozenset({"move_jp"} if config.drives_plan else ()),
        needs_homing=any(joint.homing is not None for joint in joints.values()),
        stops_between_modes=True,
        rate=1.0 / config.period,
        paced_by_stream=config.kernel_sync,
        writes_every_cycle=True,
        stop=StopPolicy(timeout, what, braking_time(config) + STOP_TIME),
        following=_following(config),
        velocity_resolution=tuple(map(_velocity_step, joints.values())),
    )


def _velocity_step(joint: JointConfig) -> float:
    """Return rad/s (m/s) for one unit of velocity, as far as the configuration alone tells; else 0."""
    units = joint.known_units
    step = units.measured_velocity
    if step is None:
        step = units.position if math.isnan(units.velocity) else units.velocity
    return 0.0 if math.isnan(step) else abs(step)


def _following(config: CanopenConfig) -> Following | None:
    joints = config.joints.values()
    if not joints or not {Way.POSITIONS, Way.MOVES}.intersection(config.ways):
        return None
    is_streamed = Way.POSITIONS in config.ways
    return Following(
        # Moves of the drives' own are sent no positions that could be followed; their end is measured.
        error=tuple(joint.following if is_streamed else math.inf for joint in joints),
        arrival=tuple(joint.arrives_within for joint in joints),
        lag=LAG + 3.0 * config.period,
    )


def _limits(joint: JointConfig) -> JointLimits:
    return JointLimits(
        lower=joint.lower,
        upper=joint.upper,
        velocity=joint.velocity,
        acceleration=joint.acceleration,
        jerk=joint.acceleration / JERK_TIME if joint.jerk is None else joint.jerk,
        effort=joint.effort,
    )
