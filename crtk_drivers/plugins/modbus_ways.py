"""The ways to a Modbus device: what its plugin says of them, and the transports that they are.

The links are those of `ModbusConfig`; a driver may have more, in TCP, for which it makes the transport.
Simulators have a serial line `serial`, and a TCP port of the name of each other link.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar

from crtk_drivers.errors import ConfigError
from crtk_drivers.kit import TcpTransport, Transport
from crtk_drivers.kit.modbus_frames import Framing, Mbap, Rtu
from crtk_drivers.kit.modbus_settings import ModbusConfig
from crtk_drivers.plugins.declared import DeviceLink, LinkAccess
from crtk_drivers.plugins.sim_plugin import RunningSim

__all__ = ["ADDRESSES", "LINK", "at_sim", "at_tool", "check_real", "framing_of", "transport_of"]

ConfigT = TypeVar("ConfigT", bound=ModbusConfig)

ADDRESSES: Final = ("port", "host", "tcp_port")
"""See `DevicePlugin.addresses`."""


def transport_of(config: ModbusConfig, name: str, aborted: Callable[[], bool]) -> Transport:
    """Return the way to a device; nothing is opened.

    Args:
        config: where it is.
        name: of the device, for messages.
        aborted: whether to give up what waits.
    """
    if config.link == "serial":
        from crtk_drivers.kit.serial_port import SerialPort  # needs pyserial

        return SerialPort(config.port, config.baud, parity=config.PARITY)
    remedy = "Check the address, the network, and that the robot is on."
    title = f"{name} {config.link}"
    return TcpTransport(config.host, config.number, title, remedy, aborted=aborted)


def framing_of(config: ModbusConfig) -> Framing:
    """Return the framing of its link."""
    is_serial = config.link in ("serial", "tool")
    return Rtu(config.address) if is_serial else Mbap(config.address)


def check_real(config: ModbusConfig) -> None:
    """See `DevicePlugin`."""
    key, example = ("port", "/dev/ttyUSB0") if config.link == "serial" else ("host", "192.168.1.10")
    if not getattr(config, key):
        raise ConfigError(
            f"{key}: is required for real hardware with link {config.link}",
            remedy=f"Give its address (--{key} {example}), or use --sim.",
        )


def at_sim(config: ConfigT, sim: RunningSim) -> ConfigT:
    """See `DevicePlugin.sim_config`."""
    if config.link == "serial":
        return config.model_copy(update={"port": sim.ttys["serial"]})
    return config.model_copy(update={"host": sim.host, "tcp_port": sim.ports[config.link]})


def at_tool(config: ConfigT, host: str) -> ConfigT:
    """See `DevicePlugin`: by the tool's line, if it is not said that it is reached elsewhere."""
    if config.port or config.host:
        return config
    link = "tool" if config.link in ("serial", "modbus") else config.link
    return config.model_copy(update={"link": link, "host": host})


def _link(config: ModbusConfig, sim: RunningSim | None) -> DeviceLink | None:
    if config.link == "serial":
        is_url = "://" in config.port
        return None if is_url else DeviceLink(serial={"serial": (config.port, config.baud)})
    return DeviceLink(config.host, {config.link: config.number})


def _at_link(config: Any, link: DeviceLink) -> Any:
    if link.serial:
        port, _ = link.serial["serial"]
        return config.model_copy(update={"port": port})
    return config.model_copy(update={"host": link.host, "tcp_port": link.tcp[config.link]})


LINK: Final = LinkAccess(_link, _at_link)
"""See `DevicePlugin.link`."""
