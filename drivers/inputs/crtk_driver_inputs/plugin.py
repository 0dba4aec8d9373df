"""The entry point of the driver."""

from __future__ import annotations

from crtk_driver_inputs.config import InputsConfig
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DevicePlugin, RunningSim


def _create(config: InputsConfig) -> Device:
    from crtk_driver_inputs.device import InputsDevice

    return InputsDevice(config)


def _check_real(config: InputsConfig) -> None:
    if not config.place:
        raise ConfigError(
            "is missing",
            where="path",
            remedy="For example --path /dev/input/by-id/usb-PCsensor_FootSwitch-event-kbd",
        )


def _at_sim(config: InputsConfig, sim: RunningSim) -> InputsConfig:
    return config.model_copy(update={"path": sim.ttys[config.link], "grab": False})


PLUGIN = DevicePlugin(
    name="inputs",
    summary="foot pedals, joysticks, six-axis mice: event and joystick devices of Linux, spacenavd",
    config=InputsConfig,
    kind=DeviceKind.INPUT,
    create=_create,
    sim="inputs",
    addresses=("path",),
    check_real=_check_real,
    sim_config=_at_sim,
)
