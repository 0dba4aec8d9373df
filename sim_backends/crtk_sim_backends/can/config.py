"""Configuration of a virtual CAN bus."""

from __future__ import annotations

import dataclasses
import ipaddress
import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.can.hub import DEFAULT_QUEUE
from crtk_sim_backends.can.medium import STUFFING
from crtk_sim_backends.can.socketcand import PORT
from crtk_sim_backends.faults import unknown
from crtk_sim_backends.process import AUTO

NONE: Final = "none"
_MOST_TERMINALS: Final = 16


class ConfigError(ValueError):
    """A simulator option with a value that cannot be used."""


def _option(default: Any, help_text: str, choices: tuple[str, ...] = ()) -> Any:
    return field(default=default, metadata={"help": help_text, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class SimConfig:
    """Options of a virtual bus; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    bitrate: int = _option(0, "bit/s of the bus; 0: as fast as it can, without arbitration")
    stuffing: str = _option("exact", "how stuffed bits are counted", tuple(STUFFING))
    socket: str = _option(
        AUTO, "path or name of the socket for python-can's interface crtk; 'none': no socket"
    )
    host: str = _option(
        AUTO, "loopback address to listen on; 'auto' finds a free one in 127.0.0.0/8"
    )
    socketcand_port: int = _option(PORT, "TCP port of the socketcand server; 0: any free one")
    channel: str = _option("can0", "name of the bus for socketcand and in logs")
    terminals: int = _option(1, "how many slcan adapters there are")
    link: str = _option(
        "", "path of a link to the first slcan terminal; the others get a number after it"
    )
    interface: str = _option(
        "", "CAN interface of the kernel to join to the bus, such as vcan0 (Linux)"
    )
    echo: bool = _option(False, "give every node its own frames back")
    queue: int = _option(DEFAULT_QUEUE, "frames of one node that may wait for the bus")
    log: str = _option("", "candump log to write")
    replay: str = _option("", "candump log to send from the start")
    replay_speed: float = _option(1.0, "pace of the replay; 2: twice as fast, 0: without pauses")
    faults: str = _option("", "fault file (YAML) to play from the start")
    control_port: int = _option(0, "port of the control socket; 0: any free one")
    realtime: bool = _option(
        False, "run with real-time priority (SCHED_FIFO) when the system permits it"
    )

    def __post_init__(self) -> None:
        if self.bitrate != 0 and not 1000 <= self.bitrate <= 1_000_000:
            raise ConfigError(f"bitrate must be 0 or lie in [1000, 1000000], not {self.bitrate}")
        if self.stuffing not in STUFFING:
            raise ConfigError(f"stuffing: {unknown('way', self.stuffing, STUFFING)}")
        if not self.socket:
            raise ConfigError("socket must be a path, a name, 'auto' or 'none', not empty")
        if self.host != AUTO:
            _check_loopback(self.host)
        for name in ("socketcand_port", "control_port"):
            if not 0 <= getattr(self, name) <= 65535:
                raise ConfigError(f"{name} must lie in [0, 65535], not {getattr(self, name)}")
        if not re.fullmatch(r"[A-Za-z0-9_.-]{1,15}", self.channel):
            raise ConfigError(
                f"channel must be 1 to 15 letters, digits, '_', '.' or '-', not {self.channel!r}"
            )
        if not 0 <= self.terminals <= _MOST_TERMINALS:
            raise ConfigError(f"terminals must lie in [0, {_MOST_TERMINALS}], not {self.terminals}")
        if self.link and not self.terminals:
            raise ConfigError("link: there is no slcan terminal; set terminals to 1")
        if not 1 <= self.queue <= 100_000:
            raise ConfigError(f"queue must lie in [1, 100000], not {self.queue}")
        if not (math.isfinite(self.replay_speed) and self.replay_speed >= 0.0):
            raise ConfigError(f"replay_speed must be at least 0, not {self.replay_speed}")
        for name in ("replay", "faults"):
            path = getattr(self, name)
            if path and not Path(path).is_file():
                raise ConfigError(f"{name}: there is no file {path}")


def make_config(config: SimConfig | None = None, **options: Any) -> SimConfig:
    """Make a configuration from another one and options that replace its values.

    Raises:
        ConfigError: for an unknown option (with a suggestion) or a wrong value.
    """
    names = {entry.name for entry in dataclasses.fields(SimConfig)}
    for name in options:
        if name not in names:
            raise ConfigError(unknown("simulator option", name, names))
    return dataclasses.replace(config or SimConfig(), **options)


def _check_loopback(host: str) -> None:
    try:
        address = ipaddress.IPv4Address(host)
    except ValueError as error:
        raise ConfigError(f"host must be 'auto' or an IPv4 address, not {host!r}") from error
    if not address.is_loopback:
        raise ConfigError(
            f"host must be a loopback address (127.x.y.z), not {host}: socketcand has no "
            "authentication"
        )
