"""Judges of the operating state of a device that nobody commands."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from itertools import pairwise
from types import MappingProxyType
from typing import Final

from crtk_drivers.client.conformance.data_judges import of_all, place
from crtk_drivers.client.conformance.findings import (
    Finding,
    conforms,
    diverges,
    not_offered,
    undetermined,
)
from crtk_drivers.client.conformance.observed import Observation, StateHeard

SILENCE: Final = 5.0
"""Seconds without an operating state after which there is no heartbeat."""
LONGEST_GAP: Final = 1.25
"""Seconds between two operating states: one, and what a busy machine adds."""


def heartbeat(seen: Observation) -> Finding:
    """QOS-3."""
    states = seen.trace.states
    if "operating_state" not in seen.graph.offered():
        return not_offered("no operating_state")
    repeated = [b for a, b in pairwise(states) if _status(a) == _status(b)]
    if repeated:
        return conforms(f"{len(states)} in {seen.trace.seconds:.1f} s, without a change")
    if seen.trace.seconds < SILENCE:
        return undetermined(f"{seen.trace.seconds:.1f} s are too short to tell")
    return diverges(f"nothing in {seen.trace.seconds:.1f} s but what had changed")


def _status(heard: StateHeard) -> tuple[str, bool, bool]:
    return heard.state, heard.is_homed, heard.is_busy


def state_words(seen: Observation) -> Finding:
    """STA-1."""
    words = Counter(each.state for each in seen.trace.states)
    if not words:
        return _no_state(seen)
    wrong = set(words) - {"DISABLED", "ENABLED", "PAUSED", "FAULT"}
    return diverges(f"it says {sorted(wrong)}") if wrong else conforms(", ".join(sorted(words)))


def _no_state(seen: Observation) -> Finding:
    if "operating_state" not in seen.graph.offered():
        return not_offered("no operating_state")
    return undetermined("no operating state was heard")


def state_stamps(seen: Observation) -> Finding:
    """STA-2."""
    states = seen.trace.states
    if len(states) < 2:
        return _no_state(seen)
    faults = [
        f"{place('operating_state', b)} after {a.stamp_ns / 1e9:.6f}"
        for a, b in pairwise(states)
        if b.stamp_ns <= a.stamp_ns
    ]
    return of_all(faults, len(states), "")


def state_gaps(seen: Observation) -> Finding:
    """STA-3."""
    states = seen.trace.states
    if len(states) < 2:
        found = _no_state(seen)
        return found if not states else undetermined("heard only once: see QOS-3")
    longest = max(b.at - a.at for a, b in pairwise(states))
    told = f"longest gap {longest:.2f} s"
    if longest <= LONGEST_GAP:
        return conforms(told)
    return diverges(told) if seen.own_lateness < LONGEST_GAP - 1.0 else undetermined(told)


def state_service(seen: Observation) -> Finding:
    """STA-4."""
    if "operating_state" not in seen.graph.services:
        return not_offered("no service operating_state")
    usable = [
        (topic, answer)
        for before, answer, after in seen.answers.states
        if (topic := after or before) is not None
        and (before is None or after is None or _status(before) == _status(after))
    ]
    if not usable:
        return undetermined("no answer came while the topic was heard")
    faults = [
        f"the service says {_status(answer)}, the topic {_status(topic)}"
        for topic, answer in usable
        if _status(answer) != _status(topic)
    ]
    if faults:
        return diverges(f"{len(faults)} of {len(usable)} answers", faults)
    return conforms(f"{len(usable)} answers")


def homed(seen: Observation) -> Finding:
    """HOM-1."""
    states = seen.trace.states
    if not states:
        return _no_state(seen)
    if states[-1].is_homed:
        return conforms("is_homed")
    if seen.manifest.get("homing") is False:
        return diverges("not homed, and its manifest says that homing is not needed")
    return undetermined("not homed; whether `home` changes that is not tried")


def busy_at_rest(seen: Observation) -> Finding:
    """BSY-1."""
    states = seen.trace.states
    if not states:
        return _no_state(seen)
    without = [each for each in states if each.state in ("DISABLED", "FAULT")]
    if not without:
        return undetermined("it was never DISABLED or in FAULT meanwhile")
    busy = [place("operating_state", each) for each in without if each.is_busy]
    return diverges(f"busy while {without[-1].state}", busy) if busy else conforms("not busy")


STATE_JUDGES: Final[Mapping[str, Callable[[Observation], Finding]]] = MappingProxyType(
    {
        "QOS-3": heartbeat,
        "STA-1": state_words,
        "STA-2": state_stamps,
        "STA-3": state_gaps,
        "STA-4": state_service,
        "HOM-1": homed,
        "BSY-1": busy_at_rest,
    }
)
