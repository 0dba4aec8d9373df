"""Faults: a table of kinds, entries checked against it, and a timeline that says when they are due.

A fault file is a YAML list; every entry has a kind, the moment at which it begins, and the
parameters of its kind::

    - {at: 2.0, kind: silence, port: rtde, duration: 1.5}
    - {when: program_started, after: 0.5, kind: protective_stop}

`at` counts seconds from the start of the simulator; `when` names an event of the simulator, each
time the first one after the entry's predecessors; `after` adds seconds to it. A fault with a
`duration` is cleared when that has passed; one without lasts until it is cleared.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import yaml


class FaultError(ValueError):
    """A fault that cannot be injected: unknown kind, unknown or wrong parameter, wrong time."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kind of fault: its type, the value when it is left out, its bounds.

    `default` None means that it must be given. `type` is float, int, bool, str or list (of floats).
    """

    type: type
    default: Any = None
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    length: int | None = None

    def check(self, where: str, name: str, value: Any) -> Any:
        """Return `value` converted to the type, or raise FaultError naming `where` and `name`."""
        if self.type is list:
            if not isinstance(value, list | tuple) or len(value) != self.length:
                raise FaultError(f"{where}: {name} must be a list of {self.length} numbers")
            number = Parameter(float, minimum=self.minimum, maximum=self.maximum)
            return tuple(number.check(where, f"{name}[{i}]", v) for i, v in enumerate(value))
        if self.type in (float, int):
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise FaultError(f"{where}: {name} must be a number, not {value!r}")
            if not (math.isfinite(value) and self.minimum <= value <= self.maximum):
                raise FaultError(
                    f"{where}: {name} must lie in [{self.minimum:g}, {self.maximum:g}], "
                    f"not {value!r}"
                )
            if self.type is int and value != int(value):
                raise FaultError(f"{where}: {name} must be a whole number, not {value!r}")
            return self.type(value)
        if not isinstance(value, self.type):
            raise FaultError(f"{where}: {name} must be {self.type.__name__}, not {value!r}")
        if self.choices and value not in self.choices:
            raise FaultError(f"{where}: {unknown(name, value, self.choices)}")
        return value


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault that a simulator can inject."""

    name: str
    summary: str
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    lasting: bool = False  # can be cleared, and so can have a duration


@dataclass(frozen=True)
class Fault:
    """One fault, checked against its kind, every parameter filled in."""

    kind: str
    parameters: Mapping[str, Any]
    at: float = 0.0
    when: str | None = None
    duration: float | None = None


@dataclass(frozen=True)
class Action:
    """Begin (`begin`) or clear a fault now."""

    fault: Fault
    begin: bool


KindTable = Mapping[str, FaultKind]

_DURATION: Final = Parameter(float, minimum=0.0)
_TIME: Final = Parameter(float, 0.0, minimum=0.0)


def unknown(what: str, name: object, known: Collection[str]) -> str:
    """Say that `name` is not one of `known`, with the nearest of them or all of them."""
    near = difflib.get_close_matches(str(name), known, n=1)
    hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(sorted(known))}"
    return f"unknown {what} {name!r}; {hint}"


def check_fault(kinds: KindTable, kind: str, given: Mapping[str, Any], where: str) -> Fault:
    """Check one fault that begins now: its kind and parameters, `duration` among them.

    Raises:
        FaultError: naming `where`, what is wrong and what is known instead.
    """
    if kind not in kinds:
        raise FaultError(f"{where}: {unknown('kind of fault', kind, kinds)}")
    table = kinds[kind]
    known = [*table.parameters, *(["duration"] if table.lasting else [])]
    for name in given:
        if name not in known:
            raise FaultError(f"{where}: {unknown(f'parameter of {kind}', name, known)}")
    parameters = {}
    for name, parameter in table.parameters.items():
        if name in given:
            parameters[name] = parameter.check(where, name, given[name])
        elif parameter.default is None:
            raise FaultError(f"{where}: {kind} needs the parameter {name!r}")
        else:
            parameters[name] = parameter.default
    duration = given.get("duration")
    if duration is not None:
        duration = _DURATION.check(where, "duration", duration)
    return Fault(kind, parameters, duration=duration)


def parse_faults(
    entries: Any, kinds: KindTable, events: Collection[str], where: Iterable[str] | None = None
) -> list[Fault]:
    """Check a list of fault entries (see the module's description).

    Args:
        entries: list of mappings, as read from YAML.
        kinds: the kinds that the simulator knows.
        events: the events that it can name in `when`.
        where: one label per entry for error messages; "entry 1", "entry 2", ... when left out.

    Raises:
        FaultError: for the first entry that is wrong.
    """
    if not isinstance(entries, list):
        raise FaultError("a fault file is a list of entries, each with 'kind' and 'at' or 'when'")
    labels = list(where) if where is not None else [f"entry {n + 1}" for n in range(len(entries))]
    faults = []
    for label, entry in zip(labels, entries, strict=True):
        if not isinstance(entry, dict) or not isinstance(entry.get("kind"), str):
            raise FaultError(f"{label}: needs a 'kind' (one of {', '.join(sorted(kinds))})")
        if ("at" in entry) == ("when" in entry):
            raise FaultError(f"{label}: needs either 'at' (seconds) or 'when' (an event)")
        given = {k: v for k, v in entry.items() if k not in ("kind", "at", "when", "after")}
        fault = check_fault(kinds, entry["kind"], given, label)
        when = entry.get("when")
        if when is None and "after" in entry:
            raise FaultError(f"{label}: 'after' goes with 'when'; add it to 'at' instead")
        if when is not None and when not in events:
            raise FaultError(f"{label}: {unknown('event', when, events)}")
        at = _TIME.check(label, "at" if when is None else "after", entry.get("at", 0.0))
        if when is not None:
            at = _TIME.check(label, "after", entry.get("after", 0.0))
        faults.append(Fault(fault.kind, fault.parameters, at, when, fault.duration))
    return faults


def read_faults(path: Path, kinds: KindTable, events: Collection[str]) -> list[Fault]:
    """Read a fault file.

    Raises:
        FaultError: with the file and the line of what is wrong, or when it cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
        node = yaml.compose(text, Loader=yaml.SafeLoader)
        entries = yaml.safe_load(text)
    except OSError as error:
        raise FaultError(f"cannot read the fault file {path}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise FaultError(f"{path} is not valid YAML: {error}") from error
    where = None
    if isinstance(node, yaml.SequenceNode):
        where = [f"{path}, line {item.start_mark.line + 1}" for item in node.value]
    elif not isinstance(entries, list):
        raise FaultError(f"{path}: a fault file is a list of entries")
    return parse_faults(entries, kinds, events, where)


class Timeline:
    """Says which faults begin and which end, from the time and from events. No clock of its own."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._waiting = list(faults)
        self._scheduled: list[tuple[float, int, Action]] = []
        self._count = 0
        for fault in [fault for fault in self._waiting if fault.when is None]:
            self._waiting.remove(fault)
            self._schedule(fault.at, Action(fault, begin=True))

    def _schedule(self, at: float, action: Action) -> None:
        self._count += 1
        self._scheduled.append((at, self._count, action))
        self._scheduled.sort(key=lambda entry: entry[:2])

    def event(self, name: str, now: float) -> None:
        """Tell that `name` happened at `now`: schedules the first fault that waits for it."""
        for fault in self._waiting:
            if fault.when == name:
                self._waiting.remove(fault)
                self._schedule(now + fault.at, Action(fault, begin=True))
                return

    def begin(self, fault: Fault, now: float) -> None:
        """Schedule `fault` for now, and its end when it has a duration."""
        self._schedule(now, Action(fault, begin=True))

    def due(self, now: float) -> list[Action]:
        """Actions whose time has come, in order; ends of timed faults are scheduled by it."""
        actions = []
        while self._scheduled and self._scheduled[0][0] <= now:
            at, _, action = self._scheduled.pop(0)
            actions.append(action)
            if action.begin and action.fault.duration is not None:
                self._schedule(at + action.fault.duration, Action(action.fault, begin=False))
        return actions

    def forget(self, fault: Fault) -> None:
        """Drop the scheduled end of `fault`, because something else has ended it."""
        self._scheduled = [
            entry for entry in self._scheduled if entry[2].begin or entry[2].fault is not fault
        ]
