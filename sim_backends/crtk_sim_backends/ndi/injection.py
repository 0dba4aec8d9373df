"""The faults of a simulated tracker, beside those of its wires."""

from __future__ import annotations

from typing import Final

from crtk_sim_backends.faults import FaultKind, KindTable, Parameter

HIDDEN: Final = {
    "missing": 0,
    "out": 6,
    "partly": 7,
    "algorithm": 8,
    "interference": 9,
    "exception": 12,
}
"""Bits of the port status, by how the fault `hide` calls them."""

_COMMAND: Final = Parameter(str, "")
_TOOL: Final = Parameter(int, 0, minimum=-1, maximum=63)

_LASTING: Final[tuple[FaultKind, ...]] = tuple(
    FaultKind(name, summary, parameters, lasting=True)
    for name, summary, parameters in (
        (
            "hide",
            "a tool (-1: all) is not seen, or badly",
            {
                "tool": _TOOL,
                "how": Parameter(
                    str,
                    "missing",
                    choices=tuple(HIDDEN),
                ),
            },
        ),
        (
            "press",
            "a button of a tool is pressed",
            {"tool": _TOOL, "button": Parameter(int, 1, minimum=1, maximum=3)},
        ),
        ("unplug", "a wired tool is unplugged", {"tool": _TOOL}),
        (
            "error",
            "a command (all, if empty) is answered with an error",
            {"command": _COMMAND, "code": Parameter(int, 0x1A, minimum=1, maximum=255)},
        ),
        ("warning", "a command is answered with WARNING06", {"command": Parameter(str, "INIT")}),
        ("swallow", "a command (all, if empty) is not answered", {"command": _COMMAND}),
        (
            "message",
            "the n-th command of a name (any, if empty) from now on, or its reply, is lost, doubled or late",
            {
                "command": _COMMAND,
                "what": Parameter(str, "reply", choices=("command", "reply")),
                "effect": Parameter(str, "lost", choices=("lost", "doubled", "late")),
                "number": Parameter(int, 1, minimum=1),
                "seconds": Parameter(float, 0.2, minimum=0.001, maximum=60.0),
            },
        ),
        (
            "damage",
            "a byte of every n-th reply is changed",
            {"every": Parameter(int, 3, minimum=1)},
        ),
        (
            "hostile_length",
            "binary replies say that they are this long",
            {"size": Parameter(int, 0xFFFFFFFF, minimum=0, maximum=0xFFFFFFFF)},
        ),
        ("frozen", "frames are those from before", {}),
        ("strange", "BX2 replies have a component of an unknown type", {}),
        (
            "system",
            "bits of the system status are set",
            {"bits": Parameter(int, 2, minimum=0, maximum=0xFFFF)},
        ),
    )
)

KINDS: Final[KindTable] = {
    **{kind.name: kind for kind in _LASTING},
    "reset": FaultKind("reset", "it is reset, as by its power: cold, at 9600 bit/s"),
    "stop_tracking": FaultKind("stop_tracking", "another client stops tracking"),
}
