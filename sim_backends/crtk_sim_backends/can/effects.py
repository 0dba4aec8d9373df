"""What the faults of :mod:`crtk_sim_backends.can.injection` do to a hub."""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final

from crtk_sim_backends import wire
from crtk_sim_backends.can import frames
from crtk_sim_backends.can.injection import (
    ERROR_FRAMES,
    HOOKS,
    STATES,
    FrameHook,
    selecting,
)
from crtk_sim_backends.can.port import State
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.kit import Ticker

if TYPE_CHECKING:
    from crtk_sim_backends.can.hub import Hub
    from crtk_sim_backends.can.node import Node

_PASSIVE: Final = frames.PASSIVE_RECEIVE | frames.PASSIVE_TRANSMIT


def _status_data(bits: int) -> bytes:
    return bytes((0, bits, 0, 0, 0, 0, 0, 0))


_ENTERED: Final = {
    State.BUS_OFF: (frames.ERROR_BUS_OFF, bytes(8)),
    State.PASSIVE: (frames.ERROR_CONTROLLER, _status_data(_PASSIVE)),
}
"""Error frame that a node gets as it enters a state."""

_LEFT: Final = {
    State.BUS_OFF: (frames.ERROR_RESTARTED, bytes(8)),
    State.PASSIVE: (frames.ERROR_CONTROLLER, _status_data(frames.ACTIVE_AGAIN)),
}
"""Error frame that it gets as it leaves it."""


class BusEffects:
    """Begins and ends the faults of a bus; `begin` and `end` are for a `FaultPlayer`."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._hooks: dict[int, FrameHook] = {}  # by identity of the fault, in order
        self._states: dict[int, tuple[str, State]] = {}
        self._talkers: dict[int, tuple[Ticker, Node | None]] = {}
        hub.state_of = self.state_of

    def state_of(self, name: str) -> State:
        """State that a node of this name has now."""
        state = State(0)
        for pattern, flag in self._states.values():
            if fnmatchcase(name, pattern):
                state |= flag
        return state

    def begin(self, fault: Fault) -> None:
        """Let a fault begin."""
        parameters = fault.parameters
        if fault.kind in HOOKS:
            self._hooks[id(fault)] = selecting(HOOKS[fault.kind](parameters), parameters)
            self._hub.hook = wire.chain(self._hooks.values())
        elif fault.kind in STATES:
            self._states[id(fault)] = parameters["node"], STATES[fault.kind]
            self._apply_states()
        elif fault.kind == "babbling":
            node = self._hub.attach(lambda can_id, data: None, "babbling")
            data = bytes(parameters["length"])
            talk = self._talker(parameters["rate"], lambda: node.send(parameters["id"], data))
            self._talkers[id(fault)] = talk, node
        else:
            classes = ERROR_FRAMES[parameters["what"]]
            talk = self._talker(parameters["rate"], lambda: self._hub.error(classes))
            self._talkers[id(fault)] = talk, None

    def _talker(self, rate: float, talk: Callable[[], object]) -> Ticker:
        return Ticker(self._hub.loop, 1.0 / rate, talk)

    def end(self, fault: Fault) -> None:
        """Let it end."""
        if self._hooks.pop(id(fault), None) is not None:
            self._hub.hook = wire.chain(self._hooks.values())
        if self._states.pop(id(fault), None) is not None:
            self._apply_states()
        talker = self._talkers.pop(id(fault), None)
        if talker is not None:
            talker[0].stop()
            if talker[1] is not None:
                talker[1].detach()

    def _apply_states(self) -> None:
        for node in self._hub.nodes:
            before, after = node.state, self.state_of(node.name)
            for flag in _ENTERED:
                if after & flag and not before & flag:
                    self._hub.error(*_ENTERED[flag], node)
            self._hub.set_state(node, after)
            for flag in _LEFT:
                if before & flag and not after & flag:
                    self._hub.error(*_LEFT[flag], node)
