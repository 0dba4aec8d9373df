"""A simulated NDI tracker, on a serial line and on TCP port 8765.

:data:`SIM` starts it; ``python -m crtk_sim_backends.ndi`` runs it alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final

from typing_extensions import override

from crtk_sim_backends.defects import read_one
from crtk_sim_backends.kit import (
    LoopServer,
    Options,
    Simulator,
    TcpDoor,
    check_choice,
    check_port,
    check_range,
    option,
)
from crtk_sim_backends.ndi import wire
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.ndi.families import FAMILIES
from crtk_sim_backends.ndi.motion import MOTIONS
from crtk_sim_backends.ndi.plugs import sensors_of
from crtk_sim_backends.ndi.tracker import Tracker

FREQUENCIES: Final = {"20": "0", "30": "1", "60": "2"}
"""Values of `Param.Tracking.Track Frequency` by frames a second."""

__all__ = ["SIM", "NdiSimulator", "SimConfig"]


@dataclass(frozen=True, kw_only=True)
class SimConfig(Options):
    """Options of the simulated tracker."""

    family: str = option("vega", "what it is", choices=FAMILIES)
    port: int = option(0, "TCP port, 8765 on hardware; 0: any free one")
    wired: str = option(
        "SIM-POINTER,SIM-REFERENCE",
        "part numbers of its wired tools, with commas, at ports 1, 2, ...; with *2 behind it one has two "
        "channels, and ? is one without memory",
    )
    motion: str = option("circle", "what its tools do", choices=MOTIONS)
    noise: float = option(0.05, "RMS of each coordinate, in mm")
    defects: str = option(
        "",
        "what is wrong with what it tells: scale, missing, tells_covered, play, as in scale=1.01",
    )
    latency: float = option(0.0, "seconds from when a frame is taken until it is told")
    left: int = option(0, "how many wired tools a client that died has left initialised")
    track_frequency: str = option(
        "60",
        "frames a second of 60 that it takes: their numbers rise by 3, 2 or 1",
        choices=FREQUENCIES,
    )
    strays: int = option(0, "how many markers it sees that belong to no tool")

    @override
    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("family", self.family, FAMILIES)
        check_choice("motion", self.motion, MOTIONS)
        check_port("port", self.port)
        check_range("noise", self.noise, 0.0, 10.0)
        check_range("latency", self.latency, 0.0, 0.2)
        check_range("left", self.left, 0, 32)
        check_range("strays", self.strays, 0, 50)
        check_choice("track_frequency", self.track_frequency, FREQUENCIES)
        _ = self.tracker_defects, sensors_of(self.wired)

    @property
    def tracker_defects(self) -> TrackerDefects:
        """What `defects` says."""
        return read_one(TrackerDefects, self.defects)


Later = Callable[[float, "CommandSession", Callable[[], bytes]], object]


class CommandSession:
    """A client: commands that end with a carriage return.

    Args:
        tracker: that carries them out.
        hears: whether what arrives can be understood: a serial line has a rate.
        later: sends what a function returns to this session so many seconds from now.
    """

    ended = False

    def __init__(self, tracker: Tracker, hears: Callable[[], bool], later: Later) -> None:
        self._tracker = tracker
        self._hears = hears
        self._later = later
        self._held_until = 0.0
        self._rest = b""

    def receive(self, data: bytes) -> bytes:
        """Take received bytes and return the replies."""
        if not self._hears():
            self._rest = b""
            return b""
        *lines, self._rest = (self._rest + data).split(b"\r")
        replies = [self._answer(line) for line in lines if line]
        if len(self._rest) > wire.LONGEST:
            self._rest = b""
            replies.append(wire.error(0x02))
        return b"".join(replies)

    def _answer(self, line: bytes) -> bytes:
        """Return what is sent at once; nothing overtakes what is late."""
        obey = partial(self._tracker.obey, line)
        fate = self._tracker.fate(line)
        effect, of_reply = (
            ("", False) if fate is None else (fate["effect"], fate["what"] == "reply")
        )
        now = time.monotonic()
        if effect == "lost":
            if of_reply:
                obey()
            return b""
        if effect == "late" and fate is not None:
            self._held_until = now + fate["seconds"]
        elif effect == "doubled":
            reply = obey()
            return 2 * reply if of_reply else reply + obey()
        wait = self._held_until - now
        if wait <= 0.0:
            return obey()
        if effect == "late" and not of_reply:
            self._later(wait, self, obey)
        else:
            reply = obey()
            self._later(wait, self, lambda: reply)
        return b""

    def close(self) -> None:
        """Forget an unfinished command."""
        self._rest = b""


class NdiSimulator(Simulator[SimConfig, LoopServer]):
    """The tracker as a plug-in."""

    name = "ndi"
    summary = "NDI tracker (Polaris Vicra, Spectra, Vega, Lyra, Aurora) with tools that move"
    Config = SimConfig

    @override
    def serve(self, config: SimConfig, parent_fd: int | None) -> LoopServer:
        """Bind its port and its serial line."""
        tracker = Tracker(
            FAMILIES[config.family],
            sensors_of(config.wired),
            MOTIONS[config.motion],
            config.noise,
            config.left,
            config.tracker_defects,
            time.monotonic,
            time.time_ns,
            config.strays,
            config.latency,
            FREQUENCIES[config.track_frequency],
        )

        def later(name: str) -> Later:
            return lambda seconds, to, make: server.after(
                seconds, lambda: server.send(name, make(), to)
            )

        server = LoopServer(
            config,
            parent_fd,
            tracker,
            title="NDI tracker",
            requests={"put": tracker.put},
            tcp={
                "tcp": TcpDoor(
                    config.port, lambda: CommandSession(tracker, lambda: True, later("tcp"))
                )
            },
            ttys={
                "serial": lambda: CommandSession(
                    tracker, lambda: server.baud("serial") == tracker.baud, later("serial")
                )
            },
        )
        tracker.on_reset = lambda: server.send("serial", wire.words("RESET"))
        return server


SIM: Final = NdiSimulator()
