"""The faults that a simulated sensor box can have, as a table for fault files and injection.

Those of `kit.datagrams` happen to the datagrams of the stream, those of `wire_kinds` to a TCP port (or to
"all"), the others to the box.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np

from crtk_sim_backends.faults import FaultKind, Parameter
from crtk_sim_backends.kit import ALL_PORTS, wire_kinds
from crtk_sim_backends.kit.datagrams import EVERY, STREAM_KINDS
from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.hostile import ANSWERS

Parameters = Mapping[str, Any]
_Effect: TypeAlias = Callable[[Box, Parameters, float], object]

EVENTS: Final = (
    "stream_started",
    "stream_stopped",
    "biased",
    "tcp_connected",
    "http_connected",
)
"""What an entry of a fault file can wait for with `when`."""

TCP_PORTS: Final = ("tcp", "http")

_PORT: Final = Parameter(str, ALL_PORTS, choices=(*TCP_PORTS, ALL_PORTS))
_ANY_PORT: Final = Parameter(str, ALL_PORTS, choices=("rdt", *TCP_PORTS, ALL_PORTS))


def _once(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters)


def _lasting(name: str, summary: str, **parameters: Parameter) -> FaultKind:
    return FaultKind(name, summary, parameters, lasting=True)


KINDS: Final[Mapping[str, FaultKind]] = {
    kind.name: kind
    for kind in (
        *STREAM_KINDS.values(),
        FaultKind(
            "foreign",
            "a stranger sends records as well, one for every n of the stream",
            {"every": EVERY},
            lasting=True,
        ),
        _lasting("deaf", "requests to the RDT port are lost"),
        _once(
            "restart",
            "the stream goes on with another rdt_sequence",
            sequence=Parameter(int, 1, minimum=0, maximum=2**32 - 1),
        ),
        _once(
            "takeover",
            "another client asks for the stream",
            count=Parameter(int, 0, minimum=0, maximum=2**32 - 1),
        ),
        _once(
            "reboot",
            "the box loses its power: bias, stream and connections are gone, and it is away for a while",
            seconds=Parameter(float, 1.0, minimum=0.0, maximum=3600.0),
            scale=Parameter(float, 1.0, minimum=0.001, maximum=1000.0),
        ),
        _lasting("stall", "the whole box hangs; afterwards it goes on where it was"),
        _lasting("unplugged", "the cable is out: nothing comes through, and the box measures on"),
        _lasting("frozen", "the transducer stands still: the same measurement again and again"),
        _lasting(
            "status",
            "bits that are set in every status word",
            bits=Parameter(int, minimum=0, maximum=2**32 - 1),
        ),
        _lasting(
            "saturation",
            "the gages of an axis (0 to 5) are at their end",
            axis=Parameter(int, 2, minimum=0, maximum=5),
        ),
        _lasting(
            "push",
            "somebody pushes at the sensor (N, N.m)",
            wrench=Parameter(list, minimum=-1e6, maximum=1e6, length=6),
        ),
        _lasting(
            "drift",
            "the box's clock is fast, in parts per million",
            ppm=Parameter(float, minimum=-100_000.0, maximum=100_000.0),
        ),
        _lasting("settings_ignored", "the web pages take settings and do not keep them"),
        _lasting(
            "web_answer",
            "the web server answers with something else than its XML pages",
            answer=Parameter(str, choices=tuple(ANSWERS)),
        ),
        _lasting(
            "web_tag",
            "a tag of the XML pages says something else, and is added where it is not there",
            tag=Parameter(str),
            text=Parameter(str, ""),
        ),
        FaultKind(
            "closed", "a port is closed: requests are refused", {"port": _ANY_PORT}, lasting=True
        ),
        *wire_kinds(_PORT, but=("coalesce", "corrupt")).values(),
    )
}
"""Every kind of fault, by name."""


def _overload(box: Box, axis: int, begin: bool) -> None:
    others = tuple(a for a in box.sensor.trouble.overloaded if a != axis)
    box.sensor.trouble.overloaded = (*others, axis) if begin else others


def _set(attribute: str, value: Callable[[Parameters], Any]) -> _Effect:
    return lambda box, p, now: setattr(box.sensor.trouble, attribute, value(p))


BEGIN: Final[Mapping[str, _Effect]] = {
    "restart": lambda box, p, now: box.restart_stream(p["sequence"]),
    "frozen": lambda box, p, now: box.sensor.freeze(now),
    "status": _set("status", lambda p: p["bits"]),
    "saturation": lambda box, p, now: _overload(box, p["axis"], True),
    "push": _set("push", lambda p: np.array(p["wrench"])),
    "drift": _set("drift", lambda p: p["ppm"] * 1e-6),
    "settings_ignored": lambda box, p, now: setattr(box, "ignores_settings", True),
}
"""What the kinds that happen to the box do when they begin."""

END: Final[Mapping[str, _Effect]] = {
    "frozen": lambda box, p, now: box.sensor.thaw(),
    "status": _set("status", lambda p: 0),
    "saturation": lambda box, p, now: _overload(box, p["axis"], False),
    "push": _set("push", lambda p: np.zeros(6)),
    "drift": _set("drift", lambda p: 0.0),
    "settings_ignored": lambda box, p, now: setattr(box, "ignores_settings", False),
}
"""What they do when they are cleared."""
