"""What is particular about these devices, for the kit's haptic device."""

from __future__ import annotations

from crtk_driver_force_dimension.config import WATCHDOG_UNIT, ForceDimensionConfig
from crtk_drivers.device import StopPolicy
from crtk_drivers.kit.haptics.traits import Traits

__all__ = ["traits_of"]


def traits_of(config: ForceDimensionConfig) -> Traits:
    """Return those of a configuration."""
    model = config.has
    return Traits(
        address=f"force-dimension {config.index if config.serial is None else config.serial}",
        module="crtk_driver_force_dimension.process",
        hand={
            "library": config.library,
            "index": config.index,
            "serial": config.serial,
            "model": config.model,
            "types": list(model.types),
            "has": [model.torque > 0.0, model.has_gripper, model.grip > 0.0],
            "watchdog": round(config.watchdog / WATCHDOG_UNIT),
            "gravity_compensation": config.gravity_compensation,
        },
        loop_rate=config.loop_rate,
        rate=config.rate,
        limits=config.force_limits(config.force, config.torque),
        grip=config.grip,
        tank=config.tank,
        follow=config.follow.model_dump(),
        driver_timeout=config.driver_timeout,
        trips=config.watchdog_trips,
        has_gripper=model.has_gripper,
        buttons={name: bit for bit, name in enumerate(model.buttons)},
        home_timeout=config.home_timeout,
        frame_id=config.frame_id,
        stop=StopPolicy(
            config.watchdog, "its watchdog switches its forces off when no new ones come"
        ),
    )
