"""Slow requests to a controller, their replies, and what a failed one means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

HINTS = (
    (
        "already in use",
        "Another RTDE client (a second driver, a fieldbus, an I/O program) has claimed the input "
        "registers: close it, or set upper_range_registers.",
    ),
    (
        "remote control",
        "Switch the robot to remote control on the teach pendant (top right corner) and enable again.",
    ),
    (
        "before timeout",
        "The control program did not start: see that the arm is powered, its brakes released, no "
        "stop active and the robot in remote control, then enable again.",
    ),
    ("could not connect", "Check the address, and that the controller has finished starting."),
    ("refused", "Check the address, and that the controller has finished starting."),
    ("imeout", "The controller does not answer: check the network and the controller."),
    ("canceled", "The controller does not answer: check the network and the controller."),
    ("not connected", "The connection was lost: the control process has to be replaced."),
)
"""Words in the library's error texts, and what to do about them."""


class Request(NamedTuple):
    """A slow request, answered by a `Reply` with the same sequence number."""

    sequence: int
    name: str
    arguments: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CallError:
    """A library call that failed: which, what it said, and what to do."""

    call: str
    text: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Reply:
    """The end of a request; `error` is None if it succeeded."""

    sequence: int
    name: str
    value: Any = None
    error: CallError | None = None


def explain(call: str, error: BaseException) -> CallError:
    """Describe an exception of the library, with what to do if that is known."""
    text = str(error) or type(error).__name__
    hint = next((hint for words, hint in HINTS if words in text.lower()), "")
    return CallError(call, text, hint)
