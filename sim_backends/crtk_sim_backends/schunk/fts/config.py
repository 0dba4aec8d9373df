"""The options of the simulated sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from typing_extensions import override

from crtk_sim_backends.kit import ConfigError, Options, check_port, check_range, option
from crtk_sim_backends.kit.loads import LoadError, parse_load


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """The options of ``crtk-driver sim schunk-fts``."""

    HEADINGS: ClassVar[Mapping[str, tuple[str, ...]]] = {
        "The sensor": ("load", "rated_force", "rated_torque", "old_firmware"),
        "Ports": ("tcp_port", "udp_port"),
        **Options.HEADINGS,
    }

    load: str = option("noise", "what acts on it, as for the simulated ati-netft")
    rated_force: float = option(500.0, "force beyond which it reports overrange, in N")
    rated_torque: float = option(20.0, "torque beyond which it does, in N.m")
    old_firmware: bool = option(False, "it knows no other UDP port, and no other output rate")
    tcp_port: int = option(8082, "port of its commands (82 on hardware); 0: any free one")
    udp_port: int = option(54843, "UDP port of this machine that it sends to, until it is told")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_range("rated_force", self.rated_force, 1.0, 1e6)
        check_range("rated_torque", self.rated_torque, 0.1, 1e6)
        for name in ("tcp_port", "udp_port"):
            check_port(name, getattr(self, name))
        try:
            parse_load(self.load)
        except LoadError as error:
            raise ConfigError(f"load: {error}") from error
