"""What the core knows of simulators: two small protocols, and how to start one.

A simulator comes by the entry point group ``crtk_drivers.sims`` and shares no code with the core:
these are structural types, and nothing has to be imported to satisfy them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

from crtk_drivers.config import Layer, load
from crtk_drivers.errors import ConnectionFailed


class SimControl(Protocol):
    """The line to a running simulator by which faults are injected."""

    def inject(self, kind: str, **parameters: Any) -> None:
        """Begin a fault now."""

    def clear(self, kind: str | None = None) -> None:
        """End a lasting fault, or all of them."""

    def status(self) -> dict[str, Any]:
        """State of the simulated device."""

    def call(self, do: str, **arguments: Any) -> Any:
        """Do any request of this simulator by its name, and return the answer.

        Raises:
            RuntimeError: it was refused, or there is no answer.
        """


class RunningSim(Protocol):
    """A simulator in its own process, with all its ports bound."""

    @property
    def host(self) -> str:
        """Its loopback address; empty if it has none (a serial line, a CAN bus)."""

    @property
    def ports(self) -> Mapping[str, int]:
        """Its ports by name."""

    @property
    def ttys(self) -> Mapping[str, str]:
        """Paths of its serial lines by name; empty if it has none."""

    @property
    def paths(self) -> Mapping[str, str]:
        """Its Unix sockets and files by name; empty if it has none."""

    @property
    def hints(self) -> Sequence[str]:
        """How programs connect to it, in lines for people; empty if ports and paths tell enough."""

    @property
    def pid(self) -> int:
        """Its process id."""

    @property
    def control(self) -> SimControl:
        """By which faults are injected."""

    @property
    def running(self) -> bool:
        """Whether its process lives."""

    def stop(self, timeout: float = 2.0) -> Any:
        """End the process. May be called twice."""


@runtime_checkable
class SimPlugin(Protocol):
    """What an entry point of ``crtk_drivers.sims`` names.

    `Config` is a dataclass: each field is an option, with its text in ``metadata["help"]``.
    """

    @property
    def name(self) -> str:
        """As in ``crtk-driver sim <name>``."""

    @property
    def summary(self) -> str:
        """One line."""

    @property
    def Config(self) -> type:  # noqa: N802 - a class
        """The dataclass of its options."""

    def spawn(self, config: Any) -> RunningSim:
        """Start it in a process of its own; return when every port is bound.

        Raises:
            RuntimeError: it could not be started, with the reason.
        """


def start_sim(plugin: SimPlugin, *layers: Layer) -> RunningSim:
    """Start a simulator with checked options.

    Args:
        plugin: see `crtk_drivers.plugins.simulator`.
        layers: values of its options, later ones over earlier ones.

    Raises:
        ConfigError: an option is unknown or has an impossible value.
        ConnectionFailed: it did not start: address in use, or ended with an error.
    """
    config: Any = load(plugin.Config, *layers)
    try:
        return plugin.spawn(config)
    except RuntimeError as error:
        raise ConnectionFailed(
            f"the simulator did not start: {error}", where=f"{plugin.name} simulator"
        ) from error
