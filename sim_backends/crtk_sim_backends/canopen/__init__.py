"""Simulated CANopen drives (CiA 301, CiA 402) at the level of frames, on a virtual CAN bus.

:data:`SIM` starts them; ``python -m crtk_sim_backends.canopen`` runs them alone and tells how to
connect. A drive without a bus is :class:`crtk_sim_backends.canopen.drive.Drive`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from typing_extensions import override

from crtk_sim_backends.can import hints, pace
from crtk_sim_backends.canopen.config import SimConfig
from crtk_sim_backends.options import ConfigError
from crtk_sim_backends.process import RunningSim, SimStartError
from crtk_sim_backends.simulator import Simulator

if TYPE_CHECKING:
    from crtk_sim_backends.canopen.server import DrivesServer

__all__ = ["SIM", "CanopenSimulator", "ConfigError", "RunningSim", "SimConfig", "SimStartError"]


class CanopenSimulator(Simulator[SimConfig, "DrivesServer"]):
    """The drives as a plug-in."""

    name = "canopen"
    summary = "CANopen servo drives (CiA 402) on a virtual CAN bus"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> DrivesServer:
        """Open the doors of their bus."""
        from crtk_sim_backends.canopen.server import DrivesServer

        return DrivesServer(config, parent_fd)

    @override
    def places(self, server: DrivesServer) -> dict[str, Any]:
        """Add `ttys`, `paths` and `hints`.

        `paths` has the socket of python-can's interface crtk (as "crtk") and the EDS of the
        drives ("eds"), `ttys` the slcan terminals, `ports` "socketcand" and "control".
        """
        paths = {**server.paths, **({"eds": str(server.eds)} if server.eds else {})}
        places = {"ttys": server.ttys, "paths": paths, "hints": list(_hints(server))}
        return {**super().places(server), **places}

    @override
    def describe(self, server: DrivesServer) -> Iterator[str]:
        """Tell how many there are and how programs connect."""
        bus = f"the virtual bus {server.config.channel}, {pace(server)}"
        yield f"{len(server.drives)} simulated CANopen drives on {bus}"
        yield from _hints(server)
        notes = {
            note: None for each in server.drives.values() if each.like for note in each.like.notes
        }
        yield from (f"note: {note}" for note in notes)
        yield f"control socket at {server.host}:{server.ports['control']}"


def _hints(server: DrivesServer) -> Iterator[str]:
    yield f"node-IDs:    {', '.join(map(str, server.drives))}"
    if server.eds:
        yield f"EDS:         {server.eds}"
    yield from hints(server)


SIM: Final = CanopenSimulator()
