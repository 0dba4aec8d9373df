"""The faults of any line of a simulator, over TCP, UDP or serial: kinds, and what they do to the data."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import Any, Final

from crtk_sim_backends import wire
from crtk_sim_backends.faults import FaultKind, KindTable, Parameter

ALL_PORTS: Final = "all"

_Parameters = Mapping[str, Any]

_DIRECTION: Final = Parameter(str, "both", choices=("in", "out", "both"))
_SECONDS: Final = Parameter(float, minimum=0.001, maximum=3600.0)
_EVERY: Final = Parameter(int, 1, minimum=1)


def _hook(make: Callable[[_Parameters], wire.WireHook]) -> Callable[[_Parameters], wire.WireHook]:
    def build(parameters: _Parameters) -> wire.WireHook:
        hook = make(parameters)
        if parameters["direction"] == "both":
            return hook
        return wire.one_way(hook, wire.Direction(parameters["direction"]))

    return build


HOOKS: Final[Mapping[str, Callable[[_Parameters], wire.WireHook]]] = {
    "split": _hook(lambda p: wire.split(p["size"], p["spacing"])),
    "coalesce": _hook(lambda p: wire.coalesce(p["seconds"])),
    "delay": _hook(lambda p: wire.delay(p["seconds"])),
    "corrupt": _hook(lambda p: wire.corrupt(p["every"], p["seed"])),
    "drop": _hook(lambda p: wire.drop(p["every"])),
}
"""Kinds that change the data of a port, by name."""

WIRE_KINDS: Final[Mapping[str, tuple[str, Mapping[str, Parameter]]]] = {
    "disconnect": ("connections are closed, and new ones too while it lasts", {}),
    "silence": ("connections stay open (half-open), and nothing is read, sent or accepted", {}),
    "no_answer": ("new connections are accepted and read, but never answered", {}),
    "split": (
        "data arrives in small pieces",
        {
            "size": Parameter(int, 1, minimum=1),
            "spacing": Parameter(float, 0.0, minimum=0.0, maximum=1.0),
            "direction": _DIRECTION,
        },
    ),
    "coalesce": ("data arrives in lumps", {"seconds": _SECONDS, "direction": _DIRECTION}),
    "delay": ("data arrives late", {"seconds": _SECONDS, "direction": _DIRECTION}),
    "corrupt": (
        "a byte of every n-th piece of data is changed",
        {
            "every": Parameter(int, 10, minimum=1),
            "seed": Parameter(int, 0),
            "direction": _DIRECTION,
        },
    ),
    "drop": (
        "every n-th piece of data is lost",
        {"every": _EVERY, "direction": _DIRECTION},
    ),
}
"""What happens to a line, by name: a summary, and parameters. Every kind of line has all of them."""


def wire_kinds(port: Parameter, but: Collection[str] = ()) -> KindTable:
    """Return the kinds that happen to ports, by name.

    Args:
        port: the parameter that says to which.
        but: those that the simulator does not have.
    """
    return {
        name: FaultKind(name, summary, {"port": port, **parameters}, lasting=True)
        for name, (summary, parameters) in WIRE_KINDS.items()
        if name not in but
    }
