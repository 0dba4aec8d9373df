"""A virtual CAN bus that needs no kernel support.

:data:`SIM` starts it; ``python -m crtk_sim_backends.can`` runs it alone and tells how to connect. How
programs connect, and how a simulator embeds the bus, is described in
:mod:`crtk_sim_backends.can.hub`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, Final

from crtk_sim_backends import process
from crtk_sim_backends.can.config import ConfigError, SimConfig, make_config
from crtk_sim_backends.command_line import flags, stopped_by_signals
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError

if TYPE_CHECKING:
    from crtk_sim_backends.can.server import HubServer

__all__ = ["SIM", "CanSimulator", "ConfigError", "RunningSim", "SimConfig", "SimStartError"]

log = logging.getLogger(__name__)


class CanSimulator:
    """The bus as a plug-in: what it is called, its options, and how to start it."""

    name: Final = "can"
    summary: Final = "CAN bus without kernel support, for python-can, socketcand and slcan clients"
    Config: Final = SimConfig

    def spawn(self, config: SimConfig | None = None, **options: Any) -> RunningSim:
        """Start it in its own process and return when all its doors are open.

        `paths` of what is returned has the socket of python-can's interface crtk (as "crtk"),
        `ttys` the slcan terminals ("slcan", "slcan-2", ...), `ports` "socketcand" and "control".

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
        """Run it in this thread until SIGINT or SIGTERM, and return the exit code.

        Args:
            config: options; the defaults when left out.
            report: gets a short banner, line by line.
            readiness: pipes to the parent process when there is one.

        Raises:
            SimStartError: when something cannot be bound or a file is wrong.
        """
        from crtk_sim_backends.can.server import HubServer

        ready = readiness or Readiness(None, None)
        server = HubServer(config or SimConfig(), ready.parent_fd)
        try:
            with stopped_by_signals(server.stop):
                ready.tell(
                    host=server.host,
                    ports=server.ports,
                    ttys=server.ttys,
                    paths=server.paths,
                    hints=list(hints(server)),
                )
                for line in _banner(server):
                    report(line)
                server.run()
        finally:
            server.close()
        return 0


def _banner(server: HubServer) -> Iterator[str]:
    config = server.config
    pace = f"{config.bitrate} bit/s" if config.bitrate else "no bit rate"
    yield f"virtual CAN bus {config.channel}, {pace}"
    yield from hints(server)
    yield f"control socket at {server.host}:{server.ports['control']}"
    if config.faults:
        yield f"faults from {config.faults}"
    yield "stop it with Ctrl-C"


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
