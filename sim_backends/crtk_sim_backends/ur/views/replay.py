"""A controller whose outputs come from a recording: for clients that listen; nothing can be commanded."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from enum import IntEnum
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from typing_extensions import override

from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.messages import ErrorMessage, ReportLevel
from crtk_sim_backends.ur.models import RobotModel
from crtk_sim_backends.ur.ports.rtde import InputClaims, RtdeSession
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState, SafetyMode
from crtk_sim_backends.ur.signals.recording import Recording, RecordingError, read_recording
from crtk_sim_backends.ur.versions import Version

REFUSED: Final = "a recording is replayed, and nothing can be commanded"

_NOT_IN_REMOTE: Final = 210
_MODES: Final[Mapping[str, type[IntEnum]]] = {
    "robot_mode": RobotMode,
    "safety_mode": SafetyMode,
    "runtime_state": RuntimeState,
}
_SOON: Final = 1e-6  # s by which a row may be early

log = logging.getLogger(__name__)


def load(path: Path) -> Recording:
    """Return a recording that can be replayed.

    Raises:
        RecordingError: it cannot be read, or a mode in it is none.
    """
    recording = read_recording(path)
    for name in _MODES.keys() & {variable.name for variable in recording.variables}:
        wrong = set(recording.column(name)) - set(map(float, _MODES[name]))
        if wrong:
            raise RecordingError(f"{path}: {name} {min(wrong):g} is none")
    return recording


class NoInputs(InputClaims):
    """Every input is in use."""

    @override
    def free_for(self, name: str, session: RtdeSession) -> bool:
        """Whether `session` may claim `name`: no."""
        log.warning("RTDE input %s refused: %s", name, REFUSED)
        return False


class ReplayedController(Controller):
    """A controller in local control whose outputs are those of a recording.

    Each row stays until the next one is due. `timestamp` begins with that of the first row and goes on
    evenly, also where rows are missing, behind the end, and when the recording begins anew. Outputs that
    were not recorded are those of an arm at rest.

    Args:
        model, version: as of a controller; the recording does not say them.
        recording: what happened, from :func:`load`.
        loop: begin anew at the end.
        begins: whether the recording may begin now; its first row waits until then.
    """

    _row: Mapping[str, Any] = MappingProxyType({})  # none while the arm at rest is made

    def __init__(
        self,
        model: RobotModel,
        version: Version,
        recording: Recording,
        *,
        loop: bool,
        begins: Callable[[], bool],
    ) -> None:
        super().__init__(model, version)
        self.recording = recording
        self.position = 0  # row
        self.ended = False
        self._loop = loop
        self._begins = begins
        self._waiting = True
        self._begun = 0.0  # when the first row was due, in the controller's time, s
        self._round = 0.0  # the same since the recording began anew
        self._show()

    @override
    def tick(self) -> None:
        """Advance one control period."""
        self.clock.advance()
        if self._waiting:
            self._waiting = not self._begins()
            self._begun = self._round = self.time
        recording = self.recording
        since = self.time - self._round
        if self._loop and since > recording.duration + 0.5 * self.dt:
            self._round, since, self.position = self.time, 0.0, 0
            self._show()
        due = recording.times[0] + since + _SOON
        before = self.position
        while self.position + 1 < recording.rows and recording.times[self.position + 1] <= due:
            self.position += 1
        if self.position != before:
            self._show()
        self.outputs["timestamp"] = recording.times[0] + self.time - self._begun
        if not (self.ended or self._loop or self._waiting) and self.position + 1 == recording.rows:
            self.ended = True
            log.info("the recording has ended; its last row stays")

    def _show(self) -> None:
        self._row = self.recording.row(self.position)
        self.outputs.update(self._row)

    @property
    @override
    def remote(self) -> bool:
        """Nobody controls it."""
        return False

    @property
    @override
    def robot_mode(self) -> RobotMode:
        """As recorded."""
        return RobotMode(self._row.get("robot_mode", super().robot_mode))

    @property
    @override
    def safety_mode(self) -> SafetyMode:
        """As recorded."""
        return SafetyMode(self._row.get("safety_mode", super().safety_mode))

    @property
    @override
    def runtime_state(self) -> RuntimeState:
        """As recorded."""
        return RuntimeState(self._row.get("runtime_state", super().runtime_state))

    @property
    def status(self) -> dict[str, Any]:
        """How far it is, ready for JSON."""
        return {
            "row": self.position + 1,
            "rows": self.recording.rows,
            "seconds": self.recording.duration,
            "ended": self.ended,
        }

    @override
    def run_script(self, text: str) -> None:
        """Refuse it."""
        self.post(
            ErrorMessage(_NOT_IN_REMOTE, 0, ReportLevel.WARNING, f"Script refused: {REFUSED}")
        )
        log.warning("script refused: %s", REFUSED)

    @override
    def write_inputs(self, values: Mapping[str, Any]) -> None:
        """Refuse them; no client can have claimed any."""
        log.warning("inputs %s refused: %s", ", ".join(values), REFUSED)
