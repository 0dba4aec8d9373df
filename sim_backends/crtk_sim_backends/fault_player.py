"""Lets faults begin and end: those of a timeline, and those that are injected at run time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeAlias

from crtk_sim_backends.faults import (
    Fault,
    FaultError,
    KindTable,
    Timeline,
    check_fault,
    unknown,
)

log = logging.getLogger(__name__)

Effect: TypeAlias = Callable[[Fault], object]


class FaultPlayer:
    """Plays faults of the kinds that a simulator knows.

    At one place there is at most one of a kind: a new one takes the place of the old one.

    Args:
        kinds: what there is.
        faults: what is to happen, from a fault file.
        begin, end: do it; `end` is called for lasting kinds only.
        places: names of the parameters that say where a fault is.
    """

    def __init__(
        self,
        kinds: KindTable,
        faults: Iterable[Fault],
        begin: Effect,
        end: Effect,
        places: tuple[str, ...] = (),
    ) -> None:
        self._kinds = kinds
        self._timeline = Timeline(faults)
        self._do_begin = begin
        self._do_end = end
        self._places = places
        self._active: dict[tuple[object, ...], Fault] = {}

    @property
    def active(self) -> list[Fault]:
        """Lasting faults that have begun and not ended."""
        return list(self._active.values())

    def event(self, name: str, now: float) -> None:
        """Tell that an event happened; `now` is in s since the start."""
        self._timeline.event(name, now)

    def inject(self, kind: str, parameters: Mapping[str, Any], now: float) -> None:
        """Let a fault begin now.

        Raises:
            FaultError: when there is no such kind or a parameter is wrong.
        """
        self._timeline.begin(check_fault(self._kinds, kind, parameters, "inject"), now)
        self.play(now)

    def clear(self, kind: str | None = None) -> None:
        """End the lasting faults of a kind, or all of them.

        Raises:
            FaultError: when there is no such kind.
        """
        if kind is not None and kind not in self._kinds:
            raise FaultError(unknown("kind of fault", kind, self._kinds))
        for fault in self.active:
            if kind in (None, fault.kind):
                self._timeline.forget(fault)
                self.end(fault)

    def play(self, now: float) -> bool:
        """Let faults begin and end that are due; whether there were any."""
        actions = self._timeline.due(now)
        for action in actions:
            (self._begin if action.begin else self.end)(action.fault)
        return bool(actions)

    def _begin(self, fault: Fault) -> None:
        log.info("fault %s begins: %s", fault.kind, dict(fault.parameters))
        if self._kinds[fault.kind].lasting:
            replaced = self._active.get(self._place(fault))
            if replaced is not None:
                self._timeline.forget(replaced)
                self.end(replaced)
            self._active[self._place(fault)] = fault
        self._do_begin(fault)

    def end(self, fault: Fault) -> None:
        """End a lasting fault, unless that has happened."""
        if self._active.get(self._place(fault)) is not fault:
            return  # cleared, or another one of its kind took its place
        log.info("fault %s ends", fault.kind)
        del self._active[self._place(fault)]
        self._do_end(fault)

    def _place(self, fault: Fault) -> tuple[object, ...]:
        return fault.kind, *(fault.parameters.get(name) for name in self._places)
