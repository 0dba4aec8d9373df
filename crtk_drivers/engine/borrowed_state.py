"""A device without an operating state of its own: it follows that of the one that it is behind.

As dVRK has it: the jaw of an instrument has no state, a client looks at that of the arm, and waits for that
to be busy and idle again.
"""

from __future__ import annotations

import logging
from collections import deque
from typing import Final

from typing_extensions import override

from crtk_drivers.engine.cycle import Engine
from crtk_drivers.errors import CommandRefused
from crtk_drivers.samples import Stamp, Text, Value
from crtk_drivers.state import STOPS, OperatingState, Status
from crtk_drivers.status.board import Observer

__all__ = ["Follower"]

logger = logging.getLogger(__name__)

_UP = frozenset({OperatingState.ENABLED})
_DOWN: Final = {
    OperatingState.PAUSED: ("pause", _UP),
    OperatingState.FAULT: ("pause", _UP),
    OperatingState.DISABLED: ("disable", _UP | {OperatingState.PAUSED}),
}
"""What is commanded behind, and from which states, while the one in front is in a state."""


_MOST: Final = 16
"""States that are kept for one that is not connected."""


class Follower:
    """Lets one engine follow another.

    What is enabled in front is enabled behind, once for each time: what then is lost, or fails, stays so
    until the one in front is enabled anew. While that is not ENABLED, the one behind is not either: it is
    PAUSED while that is in FAULT, which lets nothing go. A stop in front ends a service behind that moves, in
    any state: a gripper is activated before it is ENABLED.

    Args:
        front: whose operating state counts.
        behind: that has none.
    """

    def __init__(self, front: Engine, behind: Engine) -> None:
        self._front = front
        self._behind = behind
        self._states: deque[OperatingState] = deque(maxlen=_MOST)
        """That the one in front has reached, and the one behind has not been taken through."""
        front.add_observer(_Noting(front, self._states, behind))
        behind.add_observer(_Lending(front))
        front.hearers = (*front.hearers, self._heard)

    def look(self) -> None:
        """Do what there is to do now; called every now and then by one thread."""
        behind, states = self._behind, self._states
        if not behind.connected:
            return
        state = states[0] if states else self._front.status.state
        if states and state is not OperatingState.ENABLED:
            behind.break_off(f"{self._front.name}, which is {state}")
        if not behind.transition_ended:
            return
        if state is not OperatingState.ENABLED:
            command, running = _DOWN[state]
            if behind.status.state in running:
                self._command(command)
                return
        elif len(states) == 1:  # and nothing has followed it
            if not behind.has_sample:
                return
            is_paused = behind.status.state is OperatingState.PAUSED
            self._command("resume" if is_paused else "enable")
        if states:
            states.popleft()

    def _heard(self, name: str, value: Value | None, stamp_ns: int) -> None:
        """A stop was asked for in front, and counts behind even where it is refused."""
        if name == "state_command" and isinstance(value, Text) and value.value in STOPS:
            self._behind.end_service(f"by {value.value} of {self._front.name}")

    def _command(self, text: str) -> None:
        try:
            self._behind.state_command(text)
        except CommandRefused as refusal:
            logger.warning("%s", refusal)


class _Noting(Observer):
    """Notes the states that are reached; one that ends services in front ends them behind."""

    def __init__(self, front: Engine, states: deque[OperatingState], behind: Engine) -> None:
        self._front = front.name
        self._state = front.status.state
        self._states = states
        self._behind = behind

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        if status.state is self._state:
            return
        before, self._state = self._state, status.state
        self._states.append(status.state)
        if before is OperatingState.ENABLED or status.state is OperatingState.FAULT:
            self._behind.end_service(f"{self._front} is {status.state}")


class _Lending(Observer):
    """Lets the one in front be busy as well."""

    def __init__(self, front: Engine) -> None:
        self._front = front

    @override
    def status_changed(self, status: Status, stamp: Stamp) -> None:
        self._front.lend_busy(status.is_busy)
