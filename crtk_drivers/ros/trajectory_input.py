"""Trajectories from messages, as the engine takes them. No rclpy here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from crtk_drivers.commands import FOLLOW
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.recording.cdr_trajectories import Malformed
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.samples import CLOCKS_AGREE, JointState, JointTrajectory, Value, vector

APART: Final = 0.5
"""Seconds by which a sender's clock may be off that says when a trajectory begins."""

STREAMED: Final = 0.5
"""Seconds to the only point of a trajectory up to which it belongs to a stream, as of MoveIt Servo."""


def read_trajectory(
    engine: Engine, names: JointNames, data: bytes, decode: Callable[[bytes], JointTrajectory]
) -> JointTrajectory:
    """Return a trajectory of bytes, with the device's own joint names.

    Raises:
        CommandRefused: it is none; counted.
    """
    try:
        asked = decode(data)
    except ValueError as error:
        refusal = CommandRefused(
            FOLLOW.name,
            Reason.WRONG_TYPE if isinstance(error, Malformed) else Reason.WRONG_SIZE,
            str(error),
            where=engine.where,
            remedy="Give each point a position for each joint, and no efforts.",
        )
        engine.report_refusal(refusal)
        raise refusal from error
    return replace(
        asked,
        name=names.incoming(asked.name),
        path=tuple(replace(each, name=names.incoming([each.name])[0]) for each in asked.path),
        goal=tuple(replace(each, name=names.incoming([each.name])[0]) for each in asked.goal),
    )


def require_common_clock(engine: Engine, asked: JointTrajectory, arrival: Arrival) -> None:
    """Refuse a trajectory that begins at a time of another clock than this machine's.

    A difference that moves its beginning a little is told: the network may have kept it for so long.

    Raises:
        CommandRefused: the clock of its sender is off by more than `APART`; counted.
    """
    ahead = 1e-9 * arrival.ahead_ns if asked.start_ns else 0.0
    if abs(ahead) <= CLOCKS_AGREE:
        return
    if ahead > 0.0:
        what = f"the clock of its sender is {ahead:.3f} s ahead of the driver's"
    else:
        what = (
            f"it came {-ahead:.3f} s after it was sent, by the clocks of its sender and the driver"
        )
    if abs(ahead) > APART:
        refusal = CommandRefused(
            FOLLOW.name,
            Reason.FROM_FUTURE if ahead > 0.0 else Reason.TOO_OLD,
            f"{what}, and it begins at a time of the sender's",
            where=engine.where,
            remedy="Synchronise the two machines by chrony or PTP, or set header.stamp to zero for now.",
        )
        engine.report_refusal(refusal)
        raise refusal
    engine.report_warning(
        f"a trajectory begins by its header.stamp, and {what}. "
        "Synchronise the two machines by chrony or PTP."
    )


def command_of(asked: JointTrajectory) -> tuple[str, Value | None]:
    """Return the command that a trajectory on a topic stands for, and its value.

    Without points it ends what goes on. A single point that is near in time belongs to a stream: of
    positions, or of velocities where it has none. Anything else is gone along.
    """
    if not len(asked.times):
        return "hold", None
    if len(asked.times) > 1 or asked.times[0] > STREAMED:
        return FOLLOW.name, asked
    position, velocity = asked.positions[0], asked.velocities[0]
    if np.isnan(position).all() and not np.isnan(velocity).all():
        return "servo_jv", JointState(velocity=vector(velocity), name=asked.name)
    return "interpolate_jp", JointState(position=vector(position), name=asked.name)
