"""A simulated Universal Robots controller on the ports of a real one.

:data:`SIM` starts it; ``python -m crtk_sim_backends.ur`` runs it alone.
"""

from __future__ import annotations

import dataclasses
import logging
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final

from crtk_sim_backends import process
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError
from crtk_sim_backends.ur.config import ConfigError, SimConfig, make_config

__all__ = ["SIM", "ConfigError", "RunningSim", "SimConfig", "SimStartError", "UrSimulator"]

log = logging.getLogger(__name__)


class UrSimulator:
    """The simulator as a plug-in: what it is called, its options, and how to start it."""

    name: Final = "ur"
    summary: Final = "Universal Robots controller (CB3, e-Series, PolyScope X) that runs URScript"
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
        chosen = make_config(config, **options)
        return process.spawn(__name__, _arguments(chosen))

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
        from crtk_sim_backends.ur.server import UrServer

        ready = readiness or Readiness(None, None)
        server = UrServer(config or SimConfig(), ready.parent_fd)
        try:
            with _stopped_by_signals(server.stop):
                ready.tell(host=server.host, ports=server.ports)
                for line in _banner(server.config, server.host, server.ports):
                    report(line)
                server.run()
        finally:
            server.close()
        return 0


def _arguments(config: SimConfig) -> list[str]:
    """Command line of ``python -m crtk_sim_backends.ur`` for a configuration."""
    arguments = []
    for entry in dataclasses.fields(config):
        value = getattr(config, entry.name)
        flag = "--" + entry.name.replace("_", "-")
        if isinstance(value, bool):
            arguments.append(flag if value else "--no-" + flag.removeprefix("--"))
        else:
            arguments += [flag, str(value)]
    return arguments


def _banner(config: SimConfig, host: str, ports: dict[str, int]) -> Iterator[str]:
    version = ".".join(map(str, config.software[:3]))
    state = "running" if config.powered_on else "powered off"
    yield f"simulated {config.robot.title}, software {version}, {state}, at {host}"
    yield "ports: " + ", ".join(f"{name} {port}" for name, port in sorted(ports.items()))
    if config.faults:
        yield f"faults from {config.faults}"
    yield "stop it with Ctrl-C"


@contextmanager
def _stopped_by_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Call `stop` on SIGINT and SIGTERM; elsewhere than in the main thread do nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals = (signal.SIGINT, signal.SIGTERM)
    previous = [signal.signal(number, lambda *_: stop()) for number in signals]
    try:
        yield
    finally:
        for number, handler in zip(signals, previous, strict=True):
            signal.signal(number, handler)


SIM: Final = UrSimulator()
