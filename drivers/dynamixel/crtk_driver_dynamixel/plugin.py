"""The entry point of the driver."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from crtk_driver_dynamixel import arms
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.finding import FINDER
from crtk_driver_dynamixel.tools import TOOLS, require_libraries
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.errors import ConfigError
from crtk_drivers.plugins import DeviceLink, DevicePlugin, LinkAccess, RunningSim

DEFAULT_ARM = "arm6"
"""The arm that the simulator has by default."""


def _create(config: DynamixelConfig) -> Device:
    require_libraries()
    from crtk_driver_dynamixel.device import make_device

    return make_device(config)


def _require_chain(config: DynamixelConfig) -> None:
    if not config.joints and config.gripper is None:
        raise ConfigError(
            "no joints are configured",
            where="dynamixel",
            remedy="Name an arm (--arm koch_follower), or a file (--config arm.yaml); "
            "'crtk-driver dynamixel scan' writes one to start from.",
        )
    for name in config.buses:
        if not config.bus(name).port:
            raise ConfigError(
                f"buses.{name}.port: is required for real servos",
                where="dynamixel",
                remedy="Give the serial port (--port /dev/serial/by-id/...), or use --sim.",
            )


def _with_chain(config: DynamixelConfig) -> DynamixelConfig:
    """Return the configuration, with an arm of this package if it has no chain."""
    if config.joints or config.gripper is not None:
        return config
    return DynamixelConfig(**{"arm": DEFAULT_ARM, **config.model_dump(exclude_unset=True)})


def _at_sim(config: DynamixelConfig, sim: RunningSim) -> DynamixelConfig:
    config = _with_chain(config)
    ports = {
        name: config.bus(name).model_copy(update={"port": tty})
        for name, tty in zip(config.buses, sim.ttys.values(), strict=True)
    }
    return config.model_copy(update={"buses": ports, "port": "", "baud": None})


def _sim_options(config: DynamixelConfig) -> Mapping[str, Any]:
    """Return the servos of the configuration; an arm of this package also has the weights of its links."""
    config = _with_chain(config)
    servos = _servos(config)
    if config.arm in arms.names() and servos == _servos(DynamixelConfig(arm=config.arm)):
        servos = config.arm
    bauds = {config.bus(name).baud for name in config.buses}
    if len(bauds) > 1:
        raise ConfigError(
            "the simulated buses are of one rate", remedy="Set baud to one rate for all with --sim."
        )
    return {"servos": servos, "baud": bauds.pop(), "realtime": True}


def _servos(config: DynamixelConfig) -> str:
    """Return the servos of each bus as the simulator takes them: ``1:xm540-w270,2:xm540-w270&1``."""
    return ";".join(
        ",".join(
            text
            for _, servo in config.servos()
            if servo.bus == bus
            for text in (
                f"{servo.id}:{servo.model}",
                *(f"{s.id}:{s.model or servo.model}&{servo.id}" for s in servo.shadows),
            )
        )
        for bus in config.buses
    )


def _link(config: DynamixelConfig, sim: RunningSim | None) -> DeviceLink | None:
    """Return the serial lines of the buses; None if one is at a server, which sets its rate itself."""
    config = config if sim is None else _at_sim(config, sim)
    buses = {name: config.bus(name) for name in config.buses}
    if any("://" in bus.port for bus in buses.values()):
        return None
    return DeviceLink(serial={name: (bus.port, bus.baud) for name, bus in buses.items()})


def _at_link(config: DynamixelConfig, link: DeviceLink) -> DynamixelConfig:
    buses = {
        name: config.bus(name).model_copy(update={"port": port})
        for name, (port, _) in link.serial.items()
    }
    return config.model_copy(update={"buses": buses, "port": "", "baud": None})


PLUGIN = DevicePlugin(
    name="dynamixel",
    summary="DYNAMIXEL servo chains: X, MX, P, AX and RX series on RS-485 or TTL, with a gripper",
    config=DynamixelConfig,
    kind=DeviceKind.ARM,
    create=_create,
    sim="dynamixel",
    extra="dynamixel",
    addresses=("port",),
    check_real=_require_chain,
    sim_config=_at_sim,
    sim_options=_sim_options,
    finder=FINDER,
    tools=TOOLS,
    typical={"arm": DEFAULT_ARM},
    link=LinkAccess(_link, _at_link),
)
