"""The ways in which drivers meet a fault of their own process, and what rigs without joints share."""

from __future__ import annotations

import signal
from collections.abc import Mapping

import numpy as np
from typing_extensions import override

from bench.reliability import disturbed
from bench.reliability.activities import STREAMS
from bench.reliability.rig import CLOCK, FROZEN, PAUSE, STILL, Rig
from bench.reliability.table import REST, Follows, Way

HOUR = 3600.0
STALL = 1.1
"""Seconds after which an I/O thread is FAULT: `rig.STALL_LIMIT`, two periods, one of the watchdog."""


UNMOVED = (
    Way("F17", "the I/O thread gets no time for 50 ms", Follows.GOES_ON, PAUSE, {"seconds": 0.05}),
    Way("F17", "the I/O thread sticks", kind=disturbed.STUCK, detail="stuck", within=STALL),
    Way("F17", "a defect raises in every cycle", kind=disturbed.DEFECT, detail="a defect"),
    Way("F18", "an hour forward", Follows.GOES_ON, CLOCK, {"seconds": HOUR}),
    Way("F18", "an hour back", Follows.GOES_ON, CLOCK, {"seconds": -HOUR}),
    Way("F19", "closed and started again", Follows.RESTARTED),
)
"""F17, F18 and F19 of a driver without joints."""


def passing(fault: str, name: str, kind: str, **parameters: object) -> Way:
    """Return a way that a driver goes on through."""
    return Way(fault, name, Follows.GOES_ON, kind, parameters)


def by_tcp(port: str, within: float) -> tuple[Way, ...]:
    """Return F1 to F4 of a device at a TCP port, as far as the port is concerned.

    Args:
        port: its name.
        within: declared s after which a device that is silent is FAULT.
    """
    at = {"port": port}
    return (
        Way("F1", "the connection is closed", kind="disconnect", parameters=at),
        Way("F2", "the connection is half open", kind="silence", parameters=at, within=within),
        Way("F3", "nobody accepts", Follows.STARTS_LATER, "disconnect", at, within=3.0),
        passing("F4", "byte by byte", "split", size=1, **at),
        passing("F4", "in lumps of 20 ms", "coalesce", seconds=0.02, **at),
    )


class UnmovedRig(Rig):
    """A device of which nothing moves."""

    activities = (REST,)

    @override
    def joints(self) -> np.ndarray:
        return np.zeros(0)

    @override
    def still(self, seconds: float = STILL) -> bool:
        return True


def own_process(
    *,
    stop: float,
    stream: float,
    stuck: float = STALL,
    pending: Mapping[str, Mapping[str, str]] | None = None,
) -> tuple[Way, ...]:
    """Return F15, F17, F18 and F19 of a driver with joints.

    Args:
        stop: declared s in which joints stand after a stop.
        stream: declared s after which a stream that is silent has ended.
        stuck: declared s after which a thread that does not come back is FAULT.
        pending: why it still fails, by the name of a way, see `Way.pending`.
    """
    streams = tuple(STREAMS)
    known = pending or {}

    def way(fault: str, name: str, follows: Follows, **more: object) -> Way:
        return Way(fault, name, follows, pending=known.get(name, {}), **more)  # type: ignore[arg-type]

    return (
        way(
            "F15",
            "no command for longer than the stream's timeout",
            Follows.HOLDS,
            states=("ENABLED",),
            stands=stream + stop,
            activities=streams,
        ),
        way(
            "F17",
            "the I/O thread gets no time for 50 ms",
            Follows.GOES_ON,
            kind=PAUSE,
            parameters={"seconds": 0.05},
        ),
        way(
            "F17",
            "the I/O thread sticks",
            Follows.STOPS,
            kind=disturbed.STUCK,
            detail="stuck",
            within=stuck,
            stands=stuck + stop,
        ),
        way(
            "F17",
            "a defect raises in every cycle",
            Follows.STOPS,
            kind=disturbed.DEFECT,
            detail="a defect",
            within=0.1,
            stands=0.1 + stop,
        ),
        way(
            "F18",
            "an hour forward",
            Follows.GOES_ON,
            kind=CLOCK,
            parameters={"seconds": HOUR},
        ),
        way(
            "F18",
            "an hour back",
            Follows.GOES_ON,
            kind=CLOCK,
            parameters={"seconds": -HOUR},
        ),
        way("F19", "closed in motion and started again", Follows.RESTARTED, stands=stop),
    )


def frozen(
    *, within: float, stands: float = 0.1, moment: float = 0.3, **more: object
) -> tuple[Way, ...]:
    """Return F2 of hardware whose process stands still, for a moment or until it counts as lost, and goes on.

    Args:
        within: declared s after which hardware that is silent is FAULT.
        stands: declared s, from when it goes on, in which joints stand.
        moment: s that it may stand still without being lost.
        more: of each `Way`.
    """

    def way(name: str, follows: Follows, **parameters: float) -> Way:
        return Way(
            "F2",
            name,
            follows,
            FROZEN,
            parameters,
            within=within,
            stands=stands,
            freezes=True,
            **more,  # type: ignore[arg-type]
        )

    return (
        way(f"it stands still for {moment:g} s and goes on", Follows.GOES_ON, seconds=moment),
        way("it stands still until it is lost, and goes on", Follows.STOPS),
    )


def outlived(*, stands: float, activities: tuple[str, ...], when: str = "") -> tuple[Way, ...]:
    """Return F16 of a driver whose hardware stops by itself.

    Args:
        stands: declared s in which joints stand.
        activities: in which it is met.
        when: of a transition, in words that follow "killed".
    """
    return tuple(
        Way(
            "F16",
            f"{name}{when}",
            Follows.OUTLIVED,
            parameters={"signal": number},
            stands=stands,
            activities=activities,
        )
        for name, number in (("killed", signal.SIGKILL), ("frozen", signal.SIGSTOP))
    )


def of_part(
    fault: str,
    name: str,
    kind: str,
    detail: str,
    *,
    within: float,
    stop: float,
    **parameters: object,
) -> Way:
    """Return the way of a fault of the simulator that one part of an arm has.

    Args:
        fault, name, kind, detail: see `Way`.
        within: declared s in which it is reported.
        stop: declared s in which joints then stand.
        parameters: of the fault; which part it is, too.
    """
    return Way(
        fault,
        name,
        kind=kind,
        parameters=parameters,
        detail=detail,
        within=within,
        stands=within + stop,
    )
