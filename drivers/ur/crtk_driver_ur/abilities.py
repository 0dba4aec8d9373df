"""What a UR arm offers, from its model and its configuration."""

from __future__ import annotations

import math

from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.frames import BASE_FRAME
from crtk_driver_ur.models import JOINT_NAMES, RobotModel
from crtk_driver_ur.samples import TOOL_FRAME
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Following,
    JointLimits,
    Mode,
    StopPolicy,
)

ACCELERATION_RISE_TIME = 0.1
"""Seconds in which setpoints made here reach the acceleration limit: the controller publishes no jerk
limit."""

STOP_MARGIN = 1.0
"""Seconds of a stop for the way to the controller and back, and for the last of it to die away."""

TRANSPORT = 0.15
"""Seconds at most, beside the smoothing, until a position that was sent is followed."""

FOLLOWING_ERROR = 0.15
"""rad beyond what can be explained by lag: the controller's own protective stop is of this size."""

ARRIVAL = 0.01
"""rad to the end of a move within which a joint is there."""

NATIVE_MOVES = frozenset({"move_jp", "move_cp"})

_MODES = frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.CARTESIAN_VELOCITY})


def capabilities_of(config: UrConfig, model: RobotModel) -> Capabilities:
    """Return what the arm offers; force mode is carried out by the native control only."""
    servo, move = config.servo, config.move
    force = config.force if config.control == "native" else None
    timeout = 1.0 / config.watchdog_frequency
    return Capabilities(
        model=model.name.replace("ur", "UR"),
        joints=JOINT_NAMES,
        limits=_joint_limits(model, servo.joint_acceleration),
        cartesian_limits=CartesianLimits(
            servo.max_linear_velocity,
            servo.max_angular_velocity,
            servo.linear_acceleration,
            servo.joint_acceleration,
            *((force.max_force, force.max_torque) if force else ()),
        ),
        modes=_MODES | {Mode.CARTESIAN_EFFORT} if force else _MODES,
        measured=("measured_js", "measured_cp", "measured_cv", "measured_cf"),
        native_moves=NATIVE_MOVES if move.planned_by == "controller" else frozenset(),
        move_limits=_joint_limits(model, move.joint_acceleration, move.joint_velocity),
        line_limits=CartesianLimits(
            move.linear_velocity,
            servo.max_angular_velocity,
            move.linear_acceleration,
            servo.joint_acceleration,
        ),
        stops_between_modes=True,
        has_free=True,
        rate=config.frequency or model.frequency,
        paced_by_stream=True,
        base_frame=BASE_FRAME,
        tool_frame=TOOL_FRAME,
        transition_timeout=60.0,
        stop=StopPolicy(
            timeout,
            f"holds its position; the controller stops the arm {timeout:g} s after this "
            "process or the link died",
            timeout + STOP_MARGIN + _slowing_time(config, model),
        ),
        following=_following(config, model),
    )


def _slowing_time(config: UrConfig, model: RobotModel) -> float:
    """Return the seconds in which the arm comes to rest from the highest speed that it is given."""
    servo, move = config.servo, config.move
    return max(
        max(model.velocity_limits) / servo.joint_acceleration,
        max(servo.max_linear_velocity, move.linear_velocity) / servo.linear_acceleration,
        servo.max_angular_velocity / servo.joint_acceleration,
    )


def _following(config: UrConfig, model: RobotModel) -> Following:
    """Return how closely joints follow: late by the smoothing, and while they speed up to a stream."""
    lag = config.servo.lookahead + TRANSPORT
    acceleration = max(config.servo.joint_acceleration, config.move.joint_acceleration)
    return Following(
        tuple(
            FOLLOWING_ERROR + max(0.0, speed * speed / (2.0 * acceleration) - speed * lag)
            for speed in model.velocity_limits
        ),
        (ARRIVAL,) * len(JOINT_NAMES),
        lag,
    )


def _joint_limits(
    model: RobotModel, acceleration: float, velocity: float = math.inf
) -> tuple[JointLimits, ...]:
    """Return the limits of the joints, which move with `velocity` at most."""
    return tuple(
        JointLimits(
            lower,
            upper,
            min(velocity, most),
            acceleration,
            acceleration / ACCELERATION_RISE_TIME,
            effort,
        )
        for lower, upper, most, effort in zip(
            model.position_limits.lower,
            model.position_limits.upper,
            model.velocity_limits,
            model.torque_limits,
            strict=True,
        )
    )
