"""What an arm can be told beyond CRTK: payload, tool, outputs of control box and tool, programs, ...

A value is checked and kept by whoever gives it, and sent by the I/O thread: of each input the newest, one
request at a time (and one of the dashboard, which may take long). What the controller reports afterwards is
compared with it, for it tells nobody when it does not take a value.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

from crtk_driver_ur.control_link import ControlLink
from crtk_driver_ur.robot import Robot
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.commands import Payload
from crtk_drivers.device import Input, Note, Severity, Steps
from crtk_drivers.errors import CommandRefused, DeviceError, Reason

__all__ = ["FLANGE", "Setting", "UrInputs"]

TAKEN_WITHIN: Final = 1.0
"""Seconds after which the controller must report what it was told."""

FLANGE: Final = "flange"
"""The frame in which the tool centre point is given."""

VALUES: Final[Mapping[Payload, Callable[[Any], Any]]] = {
    Payload.NUMBER: lambda given: float(given.value),
    Payload.FLAG: lambda given: float(given.value),
    Payload.NUMBERS: lambda given: tuple(map(float, given.values)),
    Payload.TEXT: lambda given: given.value,
    Payload.POSE: lambda given: (*given.position.tolist(), *given.orientation.tolist()),
}
"""What is kept of a payload."""

logger = logging.getLogger(__name__)


def _is_reported(state: StateSample, value: Any) -> bool:
    return True


def _no_problem(value: Any) -> str:
    return ""


@dataclass(frozen=True)
class Setting:
    """One input.

    Attributes:
        summary: one line for people.
        payload: a key of `VALUES`.
        allowed: says whether a value may be sent.
        range: in words.
        request: for a value: name and arguments (see `ControlLink.ask`).
        reported: whether a state of the controller agrees with a value; also if it does not tell.
        hint: what to do if it never does.
        by_program: it is set by the control program, which must run; the value is kept for the next one.
        by_dashboard: it is set by the dashboard.
        hands_off: it is refused while the driver has control.
        at_rest: see `crtk_drivers.device.Input`.
        problem: says what is wrong with a value that is allowed; empty: nothing.
    """

    summary: str
    payload: Payload
    allowed: Callable[[Any], bool]
    range: str
    request: Callable[[Any], tuple[str, dict[str, Any]]]
    reported: Callable[[StateSample, Any], bool] = _is_reported
    hint: str = ""
    by_program: bool = False
    by_dashboard: bool = False
    hands_off: bool = False
    at_rest: bool = False
    problem: Callable[[Any], str] = _no_problem


class UrInputs:
    """The inputs of one arm. `table` may be used from any thread, the rest belongs to the I/O thread.

    Args:
        robot, link: of the arm.
        settings: by name.
        keep: is told each value that counts for later control programs too; from any thread.
        in_control: whether the control program runs.
        where: the device, for messages.
    """

    def __init__(
        self,
        robot: Robot,
        link: ControlLink,
        settings: Iterable[tuple[str, Setting]],
        keep: Callable[[str, Any], None],
        in_control: Callable[[], bool],
        where: str,
    ) -> None:
        self._robot = robot
        self._link = link
        self._settings = dict(settings)
        self._keep = keep
        self._in_control = in_control
        self._where = where
        self._lock = threading.Lock()
        self._given: dict[str, Any] = {}
        self._sending: dict[bool, Steps] = {}  # by whether the dashboard does it
        self._underway: dict[str, Any] = {}
        self._checking: dict[str, tuple[Any, float]] = {}  # value, until when it may take
        self._problems: dict[str, str] = {}
        self.table: Mapping[str, Input] = {
            name: Input(
                setting.summary, setting.payload, partial(self._take, name), setting.at_rest
            )
            for name, setting in self._settings.items()
        }

    def reset(self) -> None:
        """Forget what was not sent yet: it was meant for a connection that is gone."""
        with self._lock:
            self._given.clear()
        self._sending.clear()
        self._underway.clear()
        self._checking.clear()
        self._problems.clear()

    def is_changing(self, name: str) -> bool:
        """Whether a value was given that the controller has not been seen to have."""
        return name in self._given or name in self._underway or name in self._checking

    def step(self) -> None:
        """Send what was given, and compare what the controller reports. Once a cycle."""
        if self._given:
            for by_dashboard in {self._settings[name].by_dashboard for name in list(self._given)}:
                if by_dashboard not in self._sending:
                    self._sending[by_dashboard] = self._send(by_dashboard)
        for by_dashboard, steps in list(self._sending.items()):
            try:
                next(steps)
            except StopIteration:
                del self._sending[by_dashboard]
        if self._checking:
            self._check()

    def notes(self) -> Iterator[Note]:
        """Yield what could not be set. From any thread."""
        for name, problem in list(self._problems.items()):
            yield Note(Severity.WARNING, name, problem)

    # -------------------------------------------------------------------------------------- inside

    def _take(self, name: str, given: Any) -> None:
        """Check and keep one value."""
        setting = self._settings[name]
        if getattr(given, "frame_id", "") not in ("", FLANGE):
            raise CommandRefused(
                name,
                Reason.WRONG_FRAME,
                f"it is given in {given.frame_id!r}",
                remedy=f"Give it in {FLANGE!r}, or leave the frame empty.",
            )
        value = VALUES[setting.payload](given)
        if not all(map(math.isfinite, _numbers(value))):
            raise CommandRefused(
                name, Reason.NOT_FINITE, "not finite", remedy=f"Send {setting.range}."
            )
        if not setting.allowed(value):
            raise CommandRefused(
                name,
                Reason.OUT_OF_RANGE,
                f"{_text(value)} is not allowed",
                remedy=f"Send {setting.range}.",
            )
        if problem := setting.problem(value):
            raise CommandRefused(
                name,
                Reason.OUT_OF_RANGE,
                problem,
                where=self._where,
                remedy=f"Send {setting.range}.",
            )
        if self._robot.state is None:
            raise CommandRefused(
                name, Reason.NOT_CONNECTED, "not connected", remedy="Send it again later."
            )
        if setting.hands_off:
            self._robot.require_hands_off(name)
        with self._lock:
            self._given[name] = value
            if setting.by_program:
                self._keep(name, value)

    def _send(self, by_dashboard: bool) -> Steps:
        with self._lock:
            ready = [
                name
                for name in self._given
                if self._settings[name].by_dashboard is by_dashboard
                and (self._in_control() or not self._settings[name].by_program)
            ]
            batch = {name: self._given[name] for name in ready}
            self._underway |= batch
            for name in ready:
                del self._given[name]
        for name, value in batch.items():
            request, arguments = self._settings[name].request(value)
            try:
                yield from self._link.ask(request, **arguments)
            except DeviceError as error:
                self._checking.pop(name, None)
                self._problem(name, f"{error.message}. {error.remedy}")
            else:
                self._checking[name] = value, time.monotonic() + TAKEN_WITHIN
                if by_dashboard:
                    self._link.program_may_differ()
            del self._underway[name]

    def _check(self) -> None:
        """By when the state was received: a thread that was held up has one from before it was told."""
        state = self._robot.state
        if state is None:
            return
        for name, (value, until) in list(self._checking.items()):
            setting = self._settings[name]
            if setting.reported(state, value):
                del self._checking[name]
                self._problems.pop(name, None)
            elif state.received > until:
                del self._checking[name]
                text = f"set to {_text(value)}, but the controller does not report it. "
                self._problem(name, text + setting.hint)

    def _problem(self, name: str, text: str) -> None:
        self._problems[name] = text
        logger.warning("%s: %s: %s", self._where, name, text)


def _numbers(value: Any) -> tuple[float, ...]:
    if isinstance(value, str):
        return ()
    return value if isinstance(value, tuple) else (value,)


def _text(value: Any) -> str:
    return repr(value) if isinstance(value, str) else ", ".join(f"{x:g}" for x in _numbers(value))
