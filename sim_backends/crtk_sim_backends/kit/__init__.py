"""What simulators have in common, for those of this distribution and for those of plugins.

A simulator is a `Simulator` (its options, its process, its command line) that serves a `LoopServer`: a
thread with TCP and UDP ports and serial lines, a control door by which faults are injected, a fault player,
a clock and a page. Behind it is a device of your own (`Device`), which knows of none of these.
"""

from crtk_sim_backends.faults import Fault, FaultKind, KindTable, Parameter
from crtk_sim_backends.kit.device import Device
from crtk_sim_backends.kit.fault_desk import FaultDesk
from crtk_sim_backends.kit.loop import Loop, Ticker
from crtk_sim_backends.kit.ports import Client, LineSession, Port, Session
from crtk_sim_backends.kit.server import LoopServer, TcpDoor, UdpDoor
from crtk_sim_backends.kit.tcp_server import TcpServer, control_door
from crtk_sim_backends.kit.tty import Tty
from crtk_sim_backends.kit.tty_server import TtyServer
from crtk_sim_backends.kit.udp_server import UdpServer
from crtk_sim_backends.kit.wire_faults import ALL_PORTS, HOOKS, wire_kinds
from crtk_sim_backends.options import (
    ConfigError,
    Options,
    check_choice,
    check_file,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator

__all__ = [
    "ALL_PORTS",
    "HOOKS",
    "Client",
    "ConfigError",
    "Device",
    "Fault",
    "FaultDesk",
    "FaultKind",
    "KindTable",
    "LineSession",
    "Loop",
    "LoopServer",
    "Options",
    "Parameter",
    "Port",
    "RunningSim",
    "Session",
    "SimStartError",
    "Simulator",
    "TcpDoor",
    "TcpServer",
    "Ticker",
    "Tty",
    "TtyServer",
    "UdpDoor",
    "UdpServer",
    "check_choice",
    "check_file",
    "check_port",
    "check_range",
    "control_door",
    "option",
    "wire_kinds",
]
