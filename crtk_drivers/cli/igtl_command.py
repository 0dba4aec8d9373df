"""``crtk-driver igtl``: devices that run, for 3D Slicer and other programs that speak OpenIGTLink."""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack
from ipaddress import ip_address
from typing import TYPE_CHECKING, Annotated, Final

import typer

from crtk_drivers.cli.help_pages import HelpfulCommand
from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.reaching import FIND_TIMEOUT, Interrupted, Timeout, interruptible, reached
from crtk_drivers.cli.terminal import ERR
from crtk_drivers.errors import ConfigError

if TYPE_CHECKING:
    from crtk_drivers.front.base import DeviceFront

logger = logging.getLogger(__name__)

_PORT: Final = 18944

app = typer.Typer()


@app.command("igtl", cls=HelpfulCommand)
def _igtl(
    devices: Annotated[
        list[str],
        typer.Argument(
            metavar="[NAME=]NAMESPACE...",
            help="/ur5, ptr=/polaris/pointer: its messages are NAME/measured_cp, in 20 letters.",
            show_default=False,
        ),
    ],
    host: Annotated[
        str, typer.Option("--host", help="Address to listen at; 0.0.0.0 for the whole network.")
    ] = "127.0.0.1",
    port: Annotated[
        int, typer.Option("--port", min=0, max=65535, help="Port to listen at; 0: any free one.")
    ] = _PORT,
    connect: Annotated[
        str,
        typer.Option(
            "--connect", metavar="HOST[:PORT]", help="Connect to a server, and listen to nobody."
        ),
    ] = "",
    units: Annotated[
        str,
        typer.Option("--units", metavar="mm|m", help="Of poses: mm for 3D Slicer, m for saw."),
    ] = "mm",
    rate: Annotated[
        float, typer.Option("--rate", min=0.1, max=1000.0, help="How often a second values go out.")
    ] = 60.0,
    tell: Annotated[
        str,
        typer.Option(
            "--tell",
            metavar="NAME,...",
            help="These CRTK names of each device; all that is measured and set without it.",
        ),
    ] = "",
    listen_only: Annotated[
        bool, typer.Option("--tell-only", help="Take no commands from anybody.")
    ] = False,
    version: Annotated[
        int,
        typer.Option(
            "--header", min=1, max=2, help="Version of headers; old programs lose the stream at 2."
        ),
    ] = 1,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Let 3D Slicer, or another program that speaks OpenIGTLink, see and command devices, until Ctrl-C.

    Examples:

        crtk-driver igtl /ur5 ptr=/polaris/pointer
        crtk-driver igtl /ur5 --connect 192.168.1.20 --tell-only
    """
    scale = _scale(units)
    named = _named(devices)
    address = _address(connect) if connect else None
    names = [each.strip() for each in tell.split(",") if each.strip()] or None
    with ExitStack() as stack:
        fronts: dict[str, DeviceFront] = {
            name: stack.enter_context(reached(namespace, timeout))
            for name, namespace in named.items()
        }
        set_up_logging(ERR, "info", LogFormat.TEXT)
        from crtk_drivers.front.openigtlink import Bridge, Caller, Server

        bridge = Bridge(
            fronts, scale=scale, rate=rate, only=names, takes=not listen_only, version=version
        )
        stack.enter_context(bridge)
        if address is not None:
            door: Caller | Server = Caller(bridge, *address)
        else:
            door = server = Server(bridge, host, port)
            _tell_where(host, server.port, takes=not listen_only)
        stack.callback(door.close)
        door.start()
        with interruptible():
            try:
                threading.Event().wait()
            except Interrupted:
                logger.info("it ends; what peers have begun is held")


def _tell_where(host: str, port: int, takes: bool) -> None:
    logger.info("listening at %s:%d; in 3D Slicer: OpenIGTLinkIF, a client of it", host, port)
    try:
        is_near = ip_address(host).is_loopback
    except ValueError:
        is_near = host == "localhost"
    if not is_near:
        may = "see and command the devices" if takes else "see the devices"
        logger.warning("whoever reaches %s:%d can %s, without a password", host, port, may)


def _scale(units: str) -> float:
    from crtk_drivers.front.openigtlink.message_values import METRES, MILLIMETRES

    scales = {"mm": MILLIMETRES, "m": METRES}
    if units not in scales:
        raise ConfigError("is no unit", where=f"--units {units}", remedy="Give mm or m.")
    return scales[units]


def _named(devices: list[str]) -> dict[str, str]:
    """Return the namespaces by the names of their messages."""
    named: dict[str, str] = {}
    for each in devices:
        name, equals, namespace = each.rpartition("=")
        if not equals:
            name = namespace.strip("/").rpartition("/")[2]
        if not name or "/" in name or name in named:
            raise ConfigError(
                f"{name or 'no'} name of messages" + (" is there twice" if name in named else ""),
                where=each,
                remedy="Give each device a name of its own: ptr=/polaris/pointer.",
            )
        named[name] = namespace
    return named


def _address(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not colon:
        return text, _PORT
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise ConfigError("is no port", where=text, remedy="Give 192.168.1.20:18944.")
    return host, int(port)
