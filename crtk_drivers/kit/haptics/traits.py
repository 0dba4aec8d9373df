"""What a driver tells of a kind of haptic device."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from crtk_drivers.device import StopPolicy
from crtk_drivers.kit.haptics.force_loop import ForceLimits
from crtk_drivers.kit.haptics.passivity import TankLimits

__all__ = ["Traits"]


@dataclass(frozen=True, kw_only=True)
class Traits:
    """What is particular about a kind of device.

    Attributes:
        address: where it is, for messages.
        module: of the process that owns its library; it runs `crtk_drivers.kit.haptics.servo.Servo`.
        hand: options of its `Hand`, ready for JSON.
        loop_rate: Hz of the process.
        rate: Hz of samples.
        limits: of forces.
        grip: N of the gripper at most; 0: it has no motor.
        tank: of the energy that fixtures give; its period is that of the loop.
        follow: ``stiffness``, ``damping``, ``turn_stiffness``, ``turn_damping`` towards a pose of servo_cp.
        driver_timeout: s without a word of this process after which forces are zero.
        trips: see `crtk_drivers.kit.haptics.servo.Timing`.
        has_gripper: a joint that tells an angle.
        gripper_range: rad.
        buttons: the bit of each by name.
        home_timeout: s.
        has_gravity_compensation: it can carry its own weight, or not.
        frame_id: of the base.
        stop: what ends its forces when its process has died.
    """

    address: str
    module: str
    hand: Mapping[str, Any]
    loop_rate: float
    rate: float
    limits: ForceLimits
    grip: float = 0.0
    tank: TankLimits = field(default_factory=TankLimits)
    follow: Mapping[str, float] = field(default_factory=dict)
    driver_timeout: float = 0.1
    trips: int = 0
    has_gripper: bool = False
    gripper_range: tuple[float, float] = (-0.1, 1.0)
    buttons: Mapping[str, int] = field(default_factory=dict)
    home_timeout: float = 30.0
    has_gravity_compensation: bool = True
    frame_id: str = "base"
    stop: StopPolicy = field(default_factory=lambda: StopPolicy(0.0, "its forces end"))
