"""A simulated ATI NetFT sensor box on the ports of a real one.

:data:`SIM` starts it; ``python -m crtk_sim_backends.netft`` runs it alone.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from typing import Any, Final

from crtk_sim_backends import process
from crtk_sim_backends.command_line import flags, stopped_by_signals
from crtk_sim_backends.netft.config import ConfigError, SimConfig, make_config
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError

__all__ = ["SIM", "ConfigError", "NetFtSimulator", "RunningSim", "SimConfig", "SimStartError"]

log = logging.getLogger(__name__)


class NetFtSimulator:
    """The simulator as a plug-in: what it is called, its options, and how to start it."""

    name: Final = "netft"
    summary: Final = "ATI NetFT sensor box (Net Box, Ethernet Axia, SCHUNK FTN, OnRobot HEX)"
    Config: Final = SimConfig

    def spawn(self, config: SimConfig | None = None, **options: Any) -> RunningSim:
        """Start it in its own process and return when all its ports are bound.

        Args:
            config: options; the defaults when left out.
            options: single options that replace those of `config`.

        Raises:
            ConfigError: for an option that is unknown or has a wrong value.
            SimStartError: when it cannot be started, with the address and port concerned.
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
            SimStartError: when a port cannot be bound or the fault file is wrong.
        """
        from crtk_sim_backends.netft.server import NetFtServer

        ready = readiness or Readiness(None, None)
        server = NetFtServer(config or SimConfig(), ready.parent_fd)
        try:
            with stopped_by_signals(server.stop):
                ready.tell(host=server.host, ports=server.ports)
                for line in _banner(server.config, server.host, server.ports):
                    report(line)
                server.run()
        finally:
            server.close()
        return 0


def _banner(config: SimConfig, host: str, ports: dict[str, int]) -> Iterator[str]:
    yield f"{config.family.product}, sensor {config.sensor.part}, at {host}"
    yield "ports: " + ", ".join(f"{name} {port}" for name, port in ports.items())
    if config.faults:
        yield f"faults from {config.faults}"
    yield "stop it with Ctrl-C"


SIM: Final = NetFtSimulator()
