"""A virtual CAN bus that needs no kernel support.

:data:`SIM` starts it; ``python -m crtk_sim_backends.can`` runs it alone and tells how to connect. How
programs connect, and how a simulator embeds the bus, is described in
:mod:`crtk_sim_backends.can.hub`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from typing_extensions import override

from crtk_sim_backends.can.config import SimConfig
from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator

if TYPE_CHECKING:
    from crtk_sim_backends.can.server import HubServer

__all__ = ["SIM", "CanSimulator", "ConfigError", "RunningSim", "SimConfig", "SimStartError"]


class CanSimulator(Simulator[SimConfig, "HubServer"]):
    """The bus as a plug-in."""

    name = "can"
    summary = "CAN bus without kernel support, for python-can, socketcand and slcan clients"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> HubServer:
        """Open its doors."""
        from crtk_sim_backends.can.server import HubServer

        return HubServer(config, parent_fd)

    @override
    def places(self, server: HubServer) -> dict[str, Any]:
        """Add `ttys`, `paths` and `hints`.

        `paths` has the socket of python-can's interface crtk (as "crtk"), `ttys` the slcan
        terminals ("slcan", "slcan-2", ...), `ports` "socketcand" and "control".
        """
        places = {"ttys": server.ttys, "paths": server.paths, "hints": list(hints(server))}
        return {**super().places(server), **places}

    @override
    def describe(self, server: HubServer) -> Iterator[str]:
        """Tell the bit rate and how programs connect."""
        yield f"virtual CAN bus {server.config.channel}, {pace(server)}"
        yield from hints(server)
        yield f"control socket at {server.host}:{server.ports['control']}"


def pace(server: HubServer) -> str:
    """Tell the bit rate of a bus."""
    return f"{server.config.bitrate} bit/s" if server.config.bitrate else "no bit rate"


def hints(server: HubServer) -> Iterator[str]:
    """Tell, line by line, how programs connect to a bus."""
    if server.config.interface:
        yield (f"socketcan:   can.Bus(interface='socketcan', channel={server.config.interface!r})")
    for path in server.paths.values():
        yield f"python-can:  can.Bus(interface='crtk', channel={path!r})"
    yield (
        f"socketcand:  can.Bus(interface='socketcand', host={server.host!r}, "
        f"port={server.ports['socketcand']}, channel={server.config.channel!r})"
    )
    for tty in server.ttys.values():
        yield (
            f"slcan:       can.Bus(interface='slcan', channel={tty!r}, sleep_after_open=0), "
            f"or slcand -o -s8 {tty}"
        )


SIM: Final = CanSimulator()
