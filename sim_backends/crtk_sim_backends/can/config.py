"""Configuration of a virtual CAN bus."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

from typing_extensions import override

from crtk_sim_backends.can.hub import DEFAULT_QUEUE
from crtk_sim_backends.can.medium import STUFFING
from crtk_sim_backends.can.socketcand import PORT
from crtk_sim_backends.options import (
    ConfigError,
    Options,
    check_choice,
    check_file,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.process import AUTO

NONE: Final = "none"
_MOST_TERMINALS: Final = 16


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of a virtual bus; the `help` of each field says what it is for.

    Raises:
        ConfigError: from the constructor, naming the option and what can be given instead.
    """

    bitrate: int = option(0, "bit/s of the bus; 0: as fast as it can, without arbitration")
    stuffing: str = option("exact", "how stuffed bits are counted", tuple(STUFFING))
    socket: str = option(
        AUTO, "path or name of the socket for python-can's interface crtk; 'none': no socket"
    )
    socketcand_port: int = option(PORT, "TCP port of the socketcand server; 0: any free one")
    channel: str = option("can0", "name of the bus for socketcand and in logs")
    terminals: int = option(1, "how many slcan adapters there are")
    link: str = option(
        "", "path of a link to the first slcan terminal; the others get a number after it"
    )
    interface: str = option(
        "", "CAN interface of the kernel to join to the bus, such as vcan0 (Linux)"
    )
    echo: bool = option(False, "give every node its own frames back")
    queue: int = option(DEFAULT_QUEUE, "frames of one node that may wait for the bus")
    log: str = option("", "candump log to write")
    replay: str = option("", "candump log to send from the start")
    replay_speed: float = option(1.0, "pace of the replay; 2: twice as fast, 0: without pauses")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        if self.bitrate != 0 and not 1000 <= self.bitrate <= 1_000_000:
            raise ConfigError(f"bitrate must be 0 or lie in [1000, 1000000], not {self.bitrate}")
        check_choice("stuffing", self.stuffing, STUFFING, "way")
        if not self.socket:
            raise ConfigError("socket must be a path, a name, 'auto' or 'none', not empty")
        check_port("socketcand_port", self.socketcand_port)
        if not re.fullmatch(r"[A-Za-z0-9_.-]{1,15}", self.channel):
            raise ConfigError(
                f"channel must be 1 to 15 letters, digits, '_', '.' or '-', not {self.channel!r}"
            )
        check_range("terminals", self.terminals, 0, _MOST_TERMINALS)
        if self.link and not self.terminals:
            raise ConfigError("link: there is no slcan terminal; set terminals to 1")
        check_range("queue", self.queue, 1, 100_000)
        if not (math.isfinite(self.replay_speed) and self.replay_speed >= 0.0):
            raise ConfigError(f"replay_speed must be at least 0, not {self.replay_speed}")
        check_file("replay", self.replay)
