"""What a device has said of its state, for tests that come to look later than the device goes on."""

from __future__ import annotations

from crtk_drivers.engine import Engine, Observer
from crtk_drivers.samples import Stamp
from crtk_drivers.state import OperatingState, Status
from rigs.waiting import eventually


class ToldStates(Observer):
    """The states that a device was in, with each detail that was told in it.

    A driver whose link is lost tries again soon, and says then why that failed; or it is back before a
    test comes to look that was held up. So a FAULT also counts that has passed, once, until it is enabled.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        status = engine.status
        self._told: list[tuple[OperatingState, tuple[str, ...]]] = [
            (status.state, (status.detail,))
        ]
        self._looked_at = 0
        engine.add_observer(self)

    def status_changed(self, status: Status, stamp: Stamp) -> None:
        state, details = self._told[-1]
        if state is status.state:
            self._told[-1] = state, (*details, status.detail)
            return
        if status.state is OperatingState.ENABLED:
            self._looked_at = len(self._told)
        self._told.append((status.state, (status.detail,)))

    def detail(self, state: OperatingState, words: str = "") -> str:
        """Wait until it is in a state and a detail was told that has these words; return that detail."""

        def reached() -> list[str]:
            last = len(self._told) - 1
            first = self._looked_at if state is OperatingState.FAULT else last
            for number in (last, *range(first, last)):
                told, details = self._told[number]
                found = [each for each in details if told is state and words in each]
                if found:
                    self._looked_at = number + 1
                    return found
            return []

        found: list[str] = eventually(
            reached, lambda: f"{state} ({words}), only {self._told[-5:]}, {self._engine.status}"
        )
        return found[0]
