"""Simulated CANopen drives (CiA 301, CiA 402) at the level of frames, on a virtual CAN bus.

:data:`SIM` starts them; ``python -m crtk_sim_backends.canopen`` runs them alone and tells how to
connect. A drive without a bus is :class:`crtk_sim_backends.canopen.drive.Drive`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends import process
from crtk_sim_backends.can.config import ConfigError
from crtk_sim_backends.canopen.config import SimConfig, drive_configs, make_config
from crtk_sim_backends.canopen.drive import DriveConfig, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.command_line import flags, stopped_by_signals
from crtk_sim_backends.faults import read_faults
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError

if TYPE_CHECKING:
    from crtk_sim_backends.can.hub import Hub
    from crtk_sim_backends.can.server import HubServer
    from crtk_sim_backends.canopen.node import BusDrives

__all__ = ["SIM", "CanopenSimulator", "ConfigError", "RunningSim", "SimConfig", "SimStartError"]

log = logging.getLogger(__name__)


class CanopenSimulator:
    """The drives as a plug-in: what it is called, its options, and how to start it."""

    name: Final = "canopen"
    summary: Final = "CANopen servo drives (CiA 402) on a virtual CAN bus"
    Config: Final = SimConfig

    def spawn(self, config: SimConfig | None = None, **options: Any) -> RunningSim:
        """Start them in a process of their own and return when all doors of the bus are open.

        `paths` of what is returned has the socket of python-can's interface crtk (as "crtk") and
        the EDS of the drives ("eds"), `ttys` the slcan terminals, `ports` "socketcand" and
        "control".

        Args:
            config: options; the defaults when left out.
            options: single options that replace those of `config`.

        Raises:
            ConfigError: for an option that is unknown or has a wrong value.
            SimStartError: when it cannot be started, with the path or port concerned.
        """
        return process.spawn(__name__, flags(make_config(config, **options)))

    def run(
        self,
        config: SimConfig | None = None,
        report: Callable[[str], object] = log.info,
        readiness: Readiness | None = None,
    ) -> int:
        """Run them in this thread until SIGINT or SIGTERM, and return the exit code.

        Args:
            config: options; the defaults when left out.
            report: gets a short banner, line by line.
            readiness: pipes to the parent process when there is one.

        Raises:
            ConfigError: the file with the drives is wrong.
            SimStartError: when something cannot be bound or a file is wrong.
        """
        from crtk_sim_backends.can.server import HubServer
        from crtk_sim_backends.canopen.node import BusDrives

        chosen = config or SimConfig()
        ready = readiness or Readiness(None, None)
        drives = drive_configs(chosen)
        eds = _data_sheet(chosen)

        def devices(hub: Hub) -> BusDrives:
            made = BusDrives(hub, drives)
            _check_faults(chosen, made)
            return made

        server = HubServer(chosen, ready.parent_fd, devices)
        try:
            with stopped_by_signals(server.stop):
                ready.tell(
                    host=server.host,
                    ports=server.ports,
                    ttys=server.ttys,
                    paths={**server.paths, **({"eds": str(eds)} if eds else {})},
                    hints=list(_hints(server, drives, eds)),
                )
                for line in _banner(server, drives, eds):
                    report(line)
                server.run()
        finally:
            server.close()
        return 0


def _data_sheet(config: SimConfig) -> Path | None:
    """Write the EDS where the options want it; the published one when it fits, None if not."""
    if config.eds:
        path = Path(config.eds).absolute()
        try:
            path.write_text(eds_of(config.common))
        except OSError as error:
            raise SimStartError(f"cannot write the EDS {path}: {error.strerror}") from error
        return path
    return PUBLISHED if config.common == DriveConfig() else None


def _check_faults(config: SimConfig, drives: BusDrives) -> None:
    """See that the drives are there for which the fault file has something.

    Raises:
        FaultError: a node or an axis is not.
    """
    if not config.faults:
        return
    from crtk_sim_backends.can import injection as bus

    kinds, events = {**bus.KINDS, **drives.kinds}, (*bus.EVENTS, *drives.events)
    for fault in read_faults(Path(config.faults), kinds, events):
        if fault.kind in drives.kinds:
            drives.chosen(fault)


def _hints(server: HubServer, drives: dict[int, DriveConfig], eds: Path | None) -> Iterator[str]:
    from crtk_sim_backends.can import hints

    yield f"node-IDs:    {', '.join(map(str, drives))}"
    if eds:
        yield f"EDS:         {eds}"
    yield from hints(server)


def _banner(server: HubServer, drives: dict[int, DriveConfig], eds: Path | None) -> Iterator[str]:
    config = server.config
    pace = f"{config.bitrate} bit/s" if config.bitrate else "no bit rate"
    yield f"{len(drives)} simulated CANopen drives on the virtual bus {config.channel}, {pace}"
    yield from _hints(server, drives, eds)
    yield f"control socket at {server.host}:{server.ports['control']}"
    if config.faults:
        yield f"faults from {config.faults}"
    yield "stop it with Ctrl-C"


SIM: Final = CanopenSimulator()
