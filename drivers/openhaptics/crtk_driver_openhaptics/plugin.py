"""The entry point of the driver."""

from __future__ import annotations

from crtk_driver_openhaptics.config import OpenHapticsConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.plugins import DevicePlugin, RunningSim


def _create(config: OpenHapticsConfig) -> Device:
    from crtk_drivers.device import StopPolicy
    from crtk_drivers.kit.haptics.haptic_device import HapticDevice
    from crtk_drivers.kit.haptics.traits import Traits

    return HapticDevice(
        Traits(
            address=f"openhaptics {config.device or 'default device'}",
            module="crtk_driver_openhaptics.process",
            hand={
                "library": config.library,
                "device": config.device,
                "force_timeout": config.force_timeout,
            },
            loop_rate=config.loop_rate,
            rate=config.rate,
            limits=config.force_limits(config.max_force, 0.0),
            tank=config.tank,
            follow=config.follow.model_dump(),
            driver_timeout=config.driver_timeout,
            buttons={name: bit for bit, name in enumerate(config.buttons)},
            home_timeout=config.home_timeout,
            has_gravity_compensation=False,
            frame_id=config.frame_id,
            stop=StopPolicy(
                config.force_timeout,
                "the callback in its library makes no forces when no new ones come; what the device does "
                "when that process is killed is not documented",
            ),
        )
    )


def _at_sim(config: OpenHapticsConfig, sim: RunningSim) -> OpenHapticsConfig:
    return config.model_copy(update={"library": sim.paths["library"]})


PLUGIN = DevicePlugin(
    name="openhaptics",
    summary="Touch, Omni and other haptic devices of OpenHaptics, with a local force loop",
    config=OpenHapticsConfig,
    kind=DeviceKind.HAPTIC,
    create=_create,
    sim="openhaptics",
    addresses=("library", "device"),
    sim_config=_at_sim,
)
