"""Whether the stamps in a recording are of one clock, as when the messages arrived tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.recording import Recording
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.samples import CLOCKS_AGREE, Vector

FAR: Final = 0.5
"""Seconds between stamp and arrival of a message beyond which its stamp is not used, whatever others say."""

FEW: Final = 10.0
"""Percent of the messages at each end that may be late for other reasons than the clock."""

_OF_COMMANDS: Final = frozenset({"setpoint_js", "setpoint_cp"})
"""Names whose stamps may be those of commands, by the clock of who sent them."""


def recorded_by_its_driver(recording: Recording | Foreign) -> bool:
    """Whether stamps and arrivals are of one process: what lies between them is age, not clocks."""
    return any(name == "crtk_drivers device" for name, _ in recording.metadata)


@dataclass(frozen=True, slots=True)
class Clocks:
    """What the stamps of a recording can be used for.

    Attributes:
        apart: topics whose messages are placed by their arrival.
        note: what is to be known of that; empty if stamps of all devices are of one clock.
    """

    apart: frozenset[str]
    note: str


def clocks_of(late: Mapping[str, Vector], by_its_driver: bool) -> Clocks:
    """Return which stamps can be compared with each other, and with the arrivals of states and commands.

    Args:
        late: arrival less stamp (n,) in s of the valid messages, by topic.
        by_its_driver: see `recorded_by_its_driver`.
    """
    measured: dict[str, Vector] = {}
    of_commands: dict[str, Vector] = {}
    for topic, seconds in late.items():
        if seconds.size:
            is_of_commands = topic.rpartition("/")[2] in _OF_COMMANDS
            (of_commands if is_of_commands else measured)[topic] = seconds
    medians = {topic: float(np.median(seconds)) for topic, seconds in measured.items()}
    # The arrivals are of the recorder's clock, by which states and commands are placed.
    known = [*medians.values(), *(() if by_its_driver else (0.0,))]
    if not by_its_driver and max(known) - min(known) > CLOCKS_AGREE:
        return Clocks(frozenset(late), _note(medians))
    apart = {
        topic
        for topic, seconds in of_commands.items()
        if np.abs(np.percentile(seconds, (FEW, 100.0 - FEW))).max() > CLOCKS_AGREE
    }
    return Clocks(frozenset(apart), "")


def _note(medians: Mapping[str, float]) -> str:
    """Return what is to be known where stamps and arrivals disagree."""
    devices: dict[str, list[float]] = {}
    for topic, median in medians.items():
        devices.setdefault(topic.rpartition("/")[0] or "/", []).append(median)
    told = ", ".join(
        f"{namespace} {max(values, key=abs):+.3f} s"
        for namespace, values in sorted(devices.items())
    )
    return (
        f"The clocks of the devices and of the recorder disagree, or samples are old: arrival less stamp is "
        f"{told}, more than {1e3 * CLOCKS_AGREE:g} ms apart. Compare devices by arrival (log_time), as "
        f"pictures do, not by stamp. Synchronise the machines by chrony or PTP"
    )
