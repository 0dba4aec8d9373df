"""Simulated DYNAMIXEL servos on a serial bus.

:data:`SIM` starts them; ``python -m crtk_sim_backends.dynamixel`` runs them alone and tells the tty to
use.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final

from crtk_sim_backends import process
from crtk_sim_backends.command_line import flags, stopped_by_signals
from crtk_sim_backends.dynamixel.config import ConfigError, SimConfig, make_config
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError

__all__ = ["SIM", "ConfigError", "DynamixelSimulator", "RunningSim", "SimConfig", "SimStartError"]

log = logging.getLogger(__name__)


class DynamixelSimulator:
    """The simulator as a plug-in: what it is called, its options, and how to start it."""

    name: Final = "dynamixel"
    summary: Final = "DYNAMIXEL servos on a serial bus (protocol 2.0 and 1.0), with their timing"
    Config: Final = SimConfig

    def spawn(self, config: SimConfig | None = None, **options: Any) -> RunningSim:
        """Start it in its own process and return when its ttys can be opened.

        Args:
            config: options; the defaults when left out.
            options: single options that replace those of `config`.

        Raises:
            ConfigError: for an option that is unknown or has a wrong value.
            SimStartError: when it cannot be started, with the tty or port concerned.
        """
        chosen = make_config(config, **options)
        return process.spawn(__name__, flags(chosen))

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
            SimStartError: when a tty cannot be made or the fault file is wrong.
        """
        from crtk_sim_backends.dynamixel.server import DynamixelServer

        ready = readiness or Readiness(None, None)
        server = DynamixelServer(config or SimConfig(), ready.parent_fd)
        try:
            with stopped_by_signals(server.stop):
                ready.tell(host=server.host, ports=server.ports, ttys=server.ttys)
                for line in _banner(server.config, server.host, server.ports, server.ttys):
                    report(line)
                server.run()
        finally:
            server.close()
        return 0


def _banner(
    config: SimConfig, host: str, ports: Mapping[str, int], ttys: Mapping[str, str]
) -> Iterator[str]:
    for (name, path), specs in zip(ttys.items(), config.buses, strict=True):
        servos = ", ".join(f"{spec.number} {spec.model.name}" for spec in specs)
        yield f"simulated DYNAMIXEL {name} at {path}, {config.baud} bps: {servos}"
    yield f"control socket at {host}:{ports['control']}"
    if config.faults:
        yield f"faults from {config.faults}"
    yield "stop it with Ctrl-C"


SIM: Final = DynamixelSimulator()
