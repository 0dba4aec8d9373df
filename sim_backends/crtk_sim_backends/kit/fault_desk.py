"""The faults of a simulator that lives in a loop: those of its file, and those of its control door."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

from crtk_sim_backends.control import Handlers
from crtk_sim_backends.fault_player import Effect, FaultPlayer
from crtk_sim_backends.faults import KindTable, read_faults
from crtk_sim_backends.kit.loop import Loop

_PERIOD: Final = 0.005  # s between looks at the timeline of a fault file


class FaultDesk:
    """Lets faults begin and end in time. Also keeps the time since the start.

    Args:
        loop: of the simulator.
        kinds, begin, end, places: as those of :class:`FaultPlayer`.
        path: of the fault file; empty for none.
        events: that the file can wait for.

    Raises:
        FaultError: the file is wrong.
    """

    def __init__(
        self,
        loop: Loop,
        kinds: KindTable,
        begin: Effect,
        end: Effect,
        *,
        path: str = "",
        events: Collection[str] = (),
        places: tuple[str, ...] = (),
    ) -> None:
        self._loop = loop
        faults = read_faults(Path(path), kinds, events) if path else []
        self._has_file = bool(faults)
        self._player = FaultPlayer(kinds, faults, begin, end, places)
        self._epoch = time.monotonic()

    @property
    def now(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._epoch

    @property
    def kinds(self) -> list[str]:
        """Of the lasting faults in force."""
        return [fault.kind for fault in self._player.active]

    @property
    def handlers(self) -> Handlers:
        """Requests on the control door."""
        return {"inject": self._inject, "clear": self._player.clear}

    def describe(self) -> list[dict[str, Any]]:
        """Return the lasting faults in force, ready for JSON."""
        return [{"kind": fault.kind, **fault.parameters} for fault in self._player.active]

    def start(self) -> None:
        """Begin to count the time."""
        self._epoch = time.monotonic()
        if self._has_file:
            self._play()

    def event(self, name: str) -> None:
        """Tell the timeline that something has happened."""
        self._player.event(name, self.now)

    def _play(self) -> None:
        self._player.play(self.now)
        self._loop.call_at(time.monotonic() + _PERIOD, self._play)

    def _inject(self, kind: str, parameters: Mapping[str, Any]) -> None:
        now = time.monotonic()
        self._player.inject(kind, parameters, now - self._epoch)
        duration = parameters.get("duration")
        if duration is not None:
            self._loop.call_at(now + duration, lambda: self._player.play(self.now))
