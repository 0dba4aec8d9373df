"""A line without connections, serial or of datagrams: what crosses it passes through its faults."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Final

from crtk_sim_backends import wire
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit.loop import Loop
from crtk_sim_backends.kit.wire_faults import HOOKS

_UNDER_WAY: Final = 1 << 18
"""Bytes under way in one direction; what comes beyond that is lost."""


class FaultyLine:
    """The faults of one line: ``silence``, ``no_answer``, and what changes or delays what crosses it.

    Args:
        loop: in which it lives.
        receive: takes what arrives at the simulator.
        transmit: hands over what arrives at the client.
        joins: whether pieces that arrive together become one.

    Attributes:
        answers: whether who comes from now on has a session, and is answered.
    """

    def __init__(
        self,
        loop: Loop,
        receive: Callable[[bytes], object],
        transmit: Callable[[bytes], object],
        *,
        joins: bool = True,
    ) -> None:
        self._loop = loop
        self._ends = {wire.Direction.IN: receive, wire.Direction.OUT: transmit}
        self._joins = joins
        self.answers = True
        self._silent = False
        self._hooks: dict[str, wire.WireHook] = {}
        self._hook: wire.WireHook | None = None
        self._looks_at = math.inf
        self.clear()

    def begin(self, fault: Fault) -> None:
        """Let a fault begin; one that is none of its own does nothing here."""
        if fault.kind == "silence":
            self._silent = True
        elif fault.kind == "no_answer":
            self.answers = False
        elif fault.kind in HOOKS:
            self._hooks[fault.kind] = HOOKS[fault.kind](fault.parameters)
            self._hook = wire.chain(self._hooks.values())

    def end(self, fault: Fault) -> None:
        """Let it end; what is under way arrives when it would have."""
        if fault.kind == "silence":
            self._silent = False
        elif fault.kind == "no_answer":
            self.answers = True
        self._hooks.pop(fault.kind, None)
        self._hook = wire.chain(self._hooks.values())

    def clear(self) -> None:
        """Forget what is under way: there is nobody at the other end any more."""
        self._lanes = {way: wire.Lane(joins=self._joins) for way in wire.Direction}

    def carry(self, way: wire.Direction, data: bytes) -> None:
        """Carry data to the other end."""
        lane = self._lanes[way]
        if self._silent or not data or lane.size > _UNDER_WAY:
            return
        if self._hook is None and not lane:
            self._ends[way](data)
            return
        now = time.monotonic()
        lane.put(self._hook(way, data, now) if self._hook else [(0.0, data)], now)
        self._deliver()

    def _deliver(self) -> None:
        now = time.monotonic()
        for way, lane in self._lanes.items():
            for data in lane.take_due(now) if lane else ():
                if not self._silent:
                    self._ends[way](data)
        due = [lane.next_due for lane in self._lanes.values() if lane]
        if due and min(due) < self._looks_at:
            self._looks_at = min(due)
            self._loop.call_at(self._looks_at, self._look_again)

    def _look_again(self) -> None:
        if time.monotonic() < self._looks_at:
            return  # an earlier look has asked for the next one
        self._looks_at = math.inf
        self._deliver()
