"""Whether the stamps in a recording are of one clock, as was measured, or as arrivals of messages tell."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from crtk_drivers.commands import device_of
from crtk_drivers.recording import Recording
from crtk_drivers.recording.clock_records import offsets_in
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.samples import CLOCKS_AGREE, ClockOffset, Vector

FAR: Final = 0.5
"""Seconds between stamp and arrival beyond which a stamp is not used, unless its clock is known to agree."""

FEW: Final = 10.0
"""Percent of the messages at each end that may be late for other reasons than the clock."""

_OF_COMMANDS: Final = frozenset({"setpoint_js", "setpoint_cp"})
"""Names whose stamps may be those of commands, by the clock of who sent them."""


@dataclass(frozen=True, slots=True)
class Clocks:
    """What the stamps of a recording can be used for.

    Attributes:
        apart: topics whose messages are placed by their arrival.
        agreed: topics whose messages are placed by their stamps, however old these are.
        note: what is to be known of that; empty if stamps of all devices are of one clock.
    """

    apart: frozenset[str]
    agreed: frozenset[str]
    note: str

    def farthest(self, topic: str) -> float:
        """Return by how much (s) a stamp may lie off its arrival to be used."""
        if topic in self.apart:
            return -1.0
        return math.inf if topic in self.agreed else FAR


def clocks_of(late: Mapping[str, Vector], recording: Recording | Foreign) -> Clocks:
    """Return which stamps can be compared with each other, and with the arrivals of states and commands.

    Args:
        late: arrival less stamp (n,) in s of the valid messages, by topic.
        recording: of these messages.
    """
    metadata = recording.metadata
    if _is_by_its_driver(metadata):
        # Stamps and arrivals are of one process: what lies between them is age, not clocks.
        return Clocks(frozenset(_of_clients(late, {})), frozenset(), "")
    devices: dict[str, list[float]] = {}
    for topic, seconds in late.items():
        if seconds.size and not _is_of_commands(topic):
            devices.setdefault(device_of(topic), []).append(float(np.median(seconds)))
    offsets = offsets_in(metadata)
    # The arrivals are of the recorder's clock, by which states and commands are placed.
    apart = [
        found
        for namespace, medians in sorted(devices.items())
        if (found := _apart(namespace, medians, offsets.get(namespace, ())))
    ]
    if apart:
        return Clocks(frozenset(late), frozenset(), _APART.format(", ".join(apart)))
    ages = {namespace: max(medians) for namespace, medians in devices.items()}
    of_clients = frozenset(_of_clients(late, ages))
    agreed = {topic for topic in late.keys() - of_clients if device_of(topic) in offsets}
    old = [
        f"{namespace} is {age:.3f} s old when it arrives, or its clock is behind"
        for namespace, age in sorted(ages.items())
        if age > CLOCKS_AGREE and namespace not in offsets
    ]
    note = f"{', '.join(old)}; drawn by stamp" if old else ""
    return Clocks(of_clients, frozenset(agreed), note)


_APART: Final = (
    "Not all clocks agree with the recorder's: {}. Compare devices by arrival (log_time), as pictures do, "
    "not by stamp. Synchronise the machines by chrony or PTP"
)


def _is_by_its_driver(metadata: Sequence[tuple[str, Mapping[str, str]]]) -> bool:
    return any(name == "crtk_drivers device" for name, _ in metadata)


def _is_of_commands(topic: str) -> bool:
    return topic.rpartition("/")[2] in _OF_COMMANDS


def _apart(namespace: str, medians: Sequence[float], known: Sequence[ClockOffset]) -> str:
    """Return in words by how much a clock is surely off the recorder's; empty if it may agree.

    Args:
        namespace: of the device.
        medians: of arrival less stamp (s), a topic each.
        known: what was measured of its clock; it may have been set meanwhile.
    """
    if known:
        value = max((each.value for each in known if each.is_apart), key=abs, default=0.0)
        side = "ahead" if value > 0.0 else "behind"
        return f"that of {namespace} is {abs(value):.3f} s {side}" if value else ""
    if min(medians) < -CLOCKS_AGREE:
        return f"what {namespace} sends arrives {-min(medians):.3f} s before its stamp"
    if max(medians) > FAR:
        return f"what {namespace} sends arrives {max(medians):.3f} s after its stamp"
    return ""


def _of_clients(late: Mapping[str, Vector], ages: Mapping[str, float]) -> Iterator[str]:
    """Yield the topics whose stamps are those of commands, by a clock that does not agree.

    Args:
        late: arrival less stamp (n,) in s of the valid messages, by topic.
        ages: of samples by namespace, in s: what carries the stamp of a sample is as old.
    """
    for topic, seconds in late.items():
        if seconds.size and _is_of_commands(topic):
            least, most = np.percentile(seconds, (FEW, 100.0 - FEW))
            age = max(0.0, ages.get(device_of(topic), 0.0))
            if least < -CLOCKS_AGREE or most > age + CLOCKS_AGREE:
                yield topic
