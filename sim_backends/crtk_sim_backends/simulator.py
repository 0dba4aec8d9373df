"""What every simulator is as a plug-in: options, a process of its own, a command line."""

from __future__ import annotations

import logging
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from crtk_sim_backends import command_line, process
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.options import ConfigError, Options
from crtk_sim_backends.page import address_of
from crtk_sim_backends.process import Readiness, RunningSim, SimStartError

__all__ = ["Server", "Simulator"]

log = logging.getLogger(__name__)


class Server(Protocol):
    """A simulator whose ports are bound."""

    @property
    def host(self) -> str:
        """The loopback address."""

    @property
    def ports(self) -> Mapping[str, int]:
        """Ports by name."""

    def run(self) -> None:
        """Run until it is stopped."""

    def stop(self) -> None:
        """Let :meth:`run` return; from any thread or signal handler."""

    def close(self) -> None:
        """Let go of every port."""


ConfigT = TypeVar("ConfigT", bound=Options)
ServerT = TypeVar("ServerT", bound=Server)


class Simulator(ABC, Generic[ConfigT, ServerT]):
    """A simulator as a plug-in: what it is called, its options, and how to start it.

    The package of each simulator has one of these as ``SIM``.
    """

    name: ClassVar[str]
    """As in ``crtk-driver sim <name>``, and of the module that ``python -m`` runs."""
    summary: ClassVar[str]
    """One line."""
    Config: type[ConfigT]
    """The dataclass of its options; see :mod:`crtk_sim_backends.options`."""
    serving: tuple[ServerT, ...] = ()
    """Those of its servers that run in this process, for whoever judges by the simulator's own truth."""

    @abstractmethod
    def serve(self, config: ConfigT, parent_fd: int | None) -> ServerT:
        """Bind every port.

        Args:
            config: what to simulate.
            parent_fd: readable when the process that wants this simulator has died; None for none.

        Raises:
            ConfigError: a file that the options name is wrong.
            SimStartError: when something cannot be bound or the fault file is wrong.
        """

    def describe(self, server: ServerT) -> Iterator[str]:
        """Tell, line by line, what runs and how to reach it."""
        yield f"{self.summary}, at {server.host}"
        yield "ports: " + ", ".join(f"{name} {port}" for name, port in server.ports.items())
        yield from (f"{name}: {path}" for name, path in self.places(server).get("ttys", {}).items())

    def places(self, server: ServerT) -> dict[str, Any]:
        """Where it can be reached, as :class:`RunningSim` has it: `host`, `ports`, `ttys`, perhaps more."""
        found = {name: getattr(server, name, {}) for name in ("ttys", "paths")}
        return {"host": server.host, "ports": server.ports, **found}

    @contextmanager
    def _page(self, config: ConfigT, server: ServerT) -> Iterator[RunningSim | None]:
        """Serve the page from a process of its own, if the options want it."""
        if not config.web:
            yield None
            return
        control = f"{server.host}:{server.ports['control']}"
        module = "crtk_sim_backends.page"
        options = [control, f"--port={config.web_port}"]
        with process.spawn(module, options, called="page") as page:
            yield page

    def spawn(self, config: ConfigT | None = None, **changes: Any) -> RunningSim:
        """Start it in a process of its own and return when it can be reached.

        Args:
            config: options; the defaults when left out.
            changes: single options that replace those of `config`.

        Raises:
            ConfigError: for an option that is unknown or has a wrong value.
            SimStartError: when it cannot be started, with the address, port or path concerned.
        """
        chosen = (config or self.Config()).replace(**changes)
        module, options = type(self).__module__, command_line.flags(chosen)
        return process.spawn(module, options, called=f"{self.name} simulator")

    def run(
        self,
        config: ConfigT | None = None,
        report: Callable[[str], object] = log.info,
        readiness: Readiness | None = None,
    ) -> int:
        """Run it in this thread until SIGINT or SIGTERM, and return the exit code.

        Args:
            config: options; the defaults when left out.
            report: gets a short description, line by line.
            readiness: pipes to the parent process when there is one.

        Raises:
            ConfigError: a file that the options name is wrong.
            SimStartError: when something cannot be bound or the fault file is wrong.
        """
        ready = readiness or Readiness(None, None)
        chosen = config or self.Config()
        server = self.serve(chosen, ready.parent_fd)
        self.serving = (*self.serving, server)
        try:
            with command_line.stopped_by_signals(server.stop), self._page(chosen, server) as page:
                places = self.places(server)
                if page is not None:
                    where = f"page: {address_of(page.host, page.ports['web'])}"
                    places["ports"] = {**places["ports"], **page.ports}
                    places["hints"] = [*places.get("hints", ()), where]
                ready.tell(**places)
                for line in self.describe(server):
                    report(line)
                if page is not None:
                    report(where)
                if chosen.faults:
                    report(f"faults from {chosen.faults}")
                report("stop it with Ctrl-C")
                server.run()
        finally:
            self.serving = tuple(each for each in self.serving if each is not server)
            server.close()
        return 0

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """Run it with options of a command line; 1 when it could not start, else 0."""
        program = f"python -m {type(self).__module__}"
        chosen, readiness = command_line.parse(arguments, program, self.summary, self.Config)
        spawned = readiness.parent_fd is not None
        try:
            config = self.Config(**chosen)
            return self.run(config, log.info if spawned else command_line.tell, readiness)
        except (ConfigError, ControlError, SimStartError) as error:
            readiness.tell(error=str(error))
            if not spawned:
                command_line.tell(error, sys.stderr)
            return 1
