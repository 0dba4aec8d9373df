"""Lets faults begin and end: on the wire of the ports, or in the controller."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from crtk_sim_backends.faults import Fault, FaultError, Timeline, check_fault, unknown
from crtk_sim_backends.ur.injection import ALL_PORTS, BEGIN, END, KINDS
from crtk_sim_backends.ur.ports import Port

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

log = logging.getLogger(__name__)


class FaultPlayer:
    """Plays a timeline of faults, and those that are injected at run time.

    Args:
        faults: what is to happen, from a fault file.
        controller: what the robot's faults happen to.
        ports: what the wire's faults happen to, by name.
        spared: names of ports that have no faults.
        disconnect: closes all connections of a port.
    """

    def __init__(
        self,
        faults: Iterable[Fault],
        controller: Controller,
        ports: Mapping[str, Port],
        spared: Collection[str],
        disconnect: Callable[[Port], None],
    ) -> None:
        self._timeline = Timeline(faults)
        self._controller = controller
        self._ports = {name: port for name, port in ports.items() if name not in spared}
        self._disconnect = disconnect
        self._active: dict[tuple[object, ...], Fault] = {}
        self.stalled = False  # the whole controller hangs

    @property
    def active(self) -> list[Fault]:
        """Lasting faults that have begun and not ended."""
        return list(self._active.values())

    def event(self, name: str, now: float) -> None:
        """Tell that an event of `injection.EVENTS` happened; `now` is in s since the start."""
        self._timeline.event(name, now)

    def inject(self, kind: str, parameters: Mapping[str, Any], now: float) -> None:
        """Let a fault begin now.

        Raises:
            FaultError: when there is no such kind or a parameter is wrong.
        """
        self._timeline.begin(check_fault(KINDS, kind, parameters, "inject"), now)
        self.play(now)

    def clear(self, kind: str | None = None) -> None:
        """End the lasting faults of a kind, or all of them.

        Raises:
            FaultError: when there is no such kind.
        """
        if kind is not None and kind not in KINDS:
            raise FaultError(unknown("kind of fault", kind, KINDS))
        for fault in self.active:
            if kind in (None, fault.kind):
                self._timeline.forget(fault)
                self._end(fault)

    def play(self, now: float) -> bool:
        """Let faults begin and end that are due; whether there were any."""
        actions = self._timeline.due(now)
        for action in actions:
            if action.begin:
                log.info("fault %s begins: %s", action.fault.kind, dict(action.fault.parameters))
                self._begin(action.fault)
            else:
                log.info("fault %s ends", action.fault.kind)
                self._end(action.fault)
        return bool(actions)

    def _begin(self, fault: Fault) -> None:
        if fault.kind == "stall":
            self.stalled = True
        elif fault.kind in BEGIN:
            BEGIN[fault.kind](self._controller, fault.parameters)
        for port in self._concerned(fault):
            port.begin(fault)
            if fault.kind == "disconnect":
                self._disconnect(port)
        if KINDS[fault.kind].lasting:
            replaced = self._active.get(_place(fault))
            if replaced is not None:
                self._timeline.forget(replaced)
            self._active[_place(fault)] = fault
        if fault.kind == "disconnect" and fault.duration is None:
            self._end(fault)

    def _end(self, fault: Fault) -> None:
        if self._active.get(_place(fault)) is not fault:
            return  # it was cleared, or another one of its kind took its place
        del self._active[_place(fault)]
        if fault.kind == "stall":
            self.stalled = False
        elif fault.kind in END:
            END[fault.kind](self._controller, fault.parameters)
        for port in self._concerned(fault):
            port.end(fault.kind)

    def _concerned(self, fault: Fault) -> list[Port]:
        name = fault.parameters.get("port")
        return [port for port in self._ports.values() if name in (port.name, ALL_PORTS)]


def _place(fault: Fault) -> tuple[object, ...]:
    """Where a fault is: at one place there is at most one of a kind."""
    return fault.kind, fault.parameters.get("port"), fault.parameters.get("joint")
