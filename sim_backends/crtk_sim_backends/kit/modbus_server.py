"""A simulated Modbus device behind its ports: a serial line, a robot's tool line, and Modbus TCP."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Protocol

from typing_extensions import override

from crtk_sim_backends.faults import Fault, KindTable
from crtk_sim_backends.kit.device import Device
from crtk_sim_backends.kit.modbus_line import (
    KINDS,
    After,
    Beyond,
    Distortion,
    ModbusUnit,
    RtuLine,
    RtuSession,
    TcpSession,
)
from crtk_sim_backends.kit.ports import Session
from crtk_sim_backends.kit.server import LoopServer, TcpDoor
from crtk_sim_backends.options import Options, check_port, check_range, option
from crtk_sim_backends.page import Gauges

PERIOD: Final = 0.002
"""Seconds from one step of the mechanics to the next."""

Later = Callable[[float, Session, bytes], object]


class Mechanism(ModbusUnit, Device, Protocol):
    """A device, with registers and mechanics."""

    def advance(self, seconds: float) -> None:
        """Let time pass."""

    def gauges(self) -> Sequence[Gauges]:
        """What the page shows."""


@dataclass(frozen=True, kw_only=True)
class ModbusOptions(Options):
    """The options of its ports. A simulator gives `unit` and `baud` as its device has them."""

    PORTS: ClassVar[tuple[str, ...]] = ("tool_port", "modbus_port", "baud", "turnaround")
    """For `HEADINGS`."""

    unit: int = option(1, "its Modbus address")
    tool_port: int = option(54321, "TCP port of the robot's tool line; 0: any free one")
    modbus_port: int = option(1502, "port of Modbus TCP (502 on hardware); 0: any free one")
    baud: int = option(115200, "bits a second of its serial lines; 0: as fast as it goes")
    turnaround: float = option(0.0014, "seconds between a request and its answer on these")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("unit", self.unit, 1, 247)
        check_range("baud", self.baud, 0, 10_000_000)
        check_range("turnaround", self.turnaround, 0.0, 1.0)
        check_port("tool_port", self.tool_port)
        check_port("modbus_port", self.modbus_port)


class _Whole:
    """The device and what distorts its answers, as one."""

    def __init__(self, device: Mechanism, after: After) -> None:
        self._device = device
        self.distortion = Distortion(after)
        self.kinds: KindTable = {**device.kinds, **KINDS}
        self.status = device.status

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        self._whose(fault).begin(fault)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        self._whose(fault).end(fault)

    def _whose(self, fault: Fault) -> Mechanism | Distortion:
        return self._device if fault.kind in self._device.kinds else self.distortion


def nobody(unit: int, request: bytes) -> bytes | None:
    """Answer for no other unit: see `Beyond`."""
    return None


def serve_modbus(
    config: ModbusOptions,
    parent_fd: int | None,
    device: Mechanism,
    title: str,
    more: Callable[[Distortion, Callable[[str], Later]], Mapping[str, TcpDoor]] | None = None,
    beyond: Beyond = nobody,
    make_line: Callable[..., RtuLine] = RtuLine,
) -> LoopServer:
    """Bind the ports of a simulated device, and let its time pass.

    Args:
        config: options.
        parent_fd: as for `LoopServer`.
        device: that answers.
        title: of its page.
        more: returns other TCP ports to it. It is given what distorts answers, and what returns a function
            that sends bytes to a session of a port so many seconds from now.
        beyond: answers in Modbus TCP for other units, and for a device without power.
        make_line: makes its serial lines, with the arguments of `RtuLine`.
    """
    whole = _Whole(device, lambda seconds, function: server.after(seconds, function))

    def line(name: str, client_baud: Callable[[], int] | None = None) -> RtuLine:
        return make_line(
            device,
            whole.distortion,
            config.unit,
            config.baud,
            config.turnaround,
            after=lambda seconds, function: server.after(seconds, function),
            deliver=lambda session, data: server.send(name, data, session),
            client_baud=client_baud,
        )

    def later(name: str) -> Later:
        return lambda seconds, session, data: server.after(
            seconds, lambda: server.send(name, data, session)
        )

    def session() -> TcpSession:
        return TcpSession(device, whole.distortion, config.unit, beyond, later("modbus"))

    tool, serial = line("tool"), line("serial", lambda: server.baud("serial"))
    doors = {
        "tool": TcpDoor(config.tool_port, lambda: RtuSession(tool)),
        "modbus": TcpDoor(config.modbus_port, session),
        **(more(whole.distortion, later) if more else {}),
    }
    server = LoopServer(
        config,
        parent_fd,
        whole,
        title=title,
        tcp=doors,
        ttys={"serial": lambda: RtuSession(serial)},
        gauges=device.gauges,
    )
    server.every(PERIOD, lambda: device.advance(PERIOD))
    return server
