"""How a controller is commanded, by whichever control."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """How motions are carried out.

    Attributes:
        period: control period of the controller in s; also the time that speed commands carry.
        lookahead: of servoJ, 0.03 to 0.2 s; the arm lags behind the target by about this time.
        gain: of servoJ, 100 to 2000.
        joint_deceleration: rad/s², for stops of joint motions.
        linear_deceleration: m/s², for stops of Cartesian motions.
        feed_period: how often the robot-side watchdog is fed, in s.
        joint_speeds: rad/s, of each joint at most on its way to a position of a stream.
    """

    period: float = 0.002
    lookahead: float = 0.1
    gain: float = 300.0
    joint_deceleration: float = 5.0
    linear_deceleration: float = 2.0
    feed_period: float = 0.02
    joint_speeds: tuple[float, ...] = (math.pi,) * 6


@dataclass(frozen=True, slots=True)
class ControlOptions:
    """How the control process connects.

    Attributes:
        watchdog_frequency: the controller stops the control program, and so the arm, when it was not
            fed for one period of this frequency, in Hz.
        upper_range_registers: use the registers from 24 up, where a fieldbus claims the lower ones.
        require_remote_control: whether the controller must be in remote control.
        robot_api_port: of the Robot API, on PolyScope X.
        joint_acceleration: with which a joint speeds up at most when it follows positions, rad/s².
        motion: how motions are carried out.
    """

    watchdog_frequency: float = 5.0
    upper_range_registers: bool = False
    require_remote_control: bool = True
    robot_api_port: int = 80
    joint_acceleration: float = 5.0
    motion: MotionOptions = field(default_factory=MotionOptions)
