"""The way that commands take to the controller, as the device sees it, whoever carries them out."""

from __future__ import annotations

import logging
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from typing import Any

from crtk_driver_ur.control_requests import Reply
from crtk_driver_ur.dashboard_worker import client_of
from crtk_driver_ur.models import RobotModel
from crtk_driver_ur.request_worker import Controller
from crtk_driver_ur.rtde.state_sample import StateSample
from crtk_drivers.device import MoveProgress, Steps
from crtk_drivers.errors import DeviceFault, MotionAborted, TransitionFailed

__all__ = ["INTERRUPTED", "PROGRAM_STOPPED", "ControlLink"]

REMOTE_CHECK_PERIOD = 0.5
"""Seconds between two questions whether the teach pendant has control."""

PROGRAM_CHECK_PERIOD = 2.0
"""Seconds between two questions which program is loaded."""

PROGRAM_END_PERIOD = 0.2
"""Seconds between two requests to end a paused program."""

INTERRUPTED = "another command took its place"
PROGRAM_STOPPED = "the control program was stopped on the controller"

logger = logging.getLogger(__name__)


class _Recurring:
    """A request that is sent again and again: `period` seconds apart at least, and one at a time.

    Args:
        name: of the request.
        period: seconds.
    """

    def __init__(self, name: str, period: float) -> None:
        self._name = name
        self._period = period
        self._number = 0  # of the one that is not answered yet
        self._sent_at = -math.inf

    def send_if_due(self, send: Callable[[str], int]) -> None:
        """Send it, if it is due; `send` returns the number that the reply will have, 0 if it was not sent."""
        now = time.monotonic()
        if not self._number and now - self._sent_at > self._period:
            self._sent_at = now
            self._number = send(self._name)

    def hurry(self) -> None:
        """Let it be due at once."""
        self._sent_at = -math.inf

    def is_answered_by(self, reply: Reply) -> bool:
        """Whether this is its reply; from then on it may be sent again."""
        if reply.sequence != self._number:
            return False
        self._number = 0
        return True

    def forget(self) -> None:
        """Await no reply any more."""
        self._number = 0


class ControlLink(ABC):
    """Everything but `stop` belongs to the I/O thread. Nothing waits but `close`.

    Args:
        where: the device, for messages.

    Attributes:
        loss: why control was lost, in words; empty if it was not. Cleared by whoever starts anew.
        complaint: what the controller said last against our control program; empty if nothing.
        program_runs: our control program was started and not seen to stop since.
        replaced: another program has been seen to run in the place of ours.
        has_local_control: the controller knows local and remote control, and is asked which it is.
        remote: whether it is in remote control; None if not known.
        arm: what the joints may do, for a control program of ours; None: as in the options.
        lateness: how old the newest state may have been when it came, s; 0 where that is not known.
        loaded_program: name of the program that is loaded; empty if none is, None if that is not known.
    """

    def __init__(self, where: str) -> None:
        self.loss = ""
        self.arm: RobotModel | None = None
        self.complaint = ""
        self.program_runs = False
        self.replaced = False
        self.lateness = 0.0
        self.has_local_control = False
        self.remote: bool | None = None
        self.loaded_program: str | None = None
        self._where = where
        self._awaited: set[int] = set()
        self._replies: dict[int, Reply] = {}
        self._asks_remote = _Recurring("is_in_remote_control", REMOTE_CHECK_PERIOD)
        self._asks_program = _Recurring("loaded_program", PROGRAM_CHECK_PERIOD)
        self._ends_program = _Recurring("stop_program", PROGRAM_END_PERIOD)
        self._was_local = False
        self._trouble = ""  # with what could not be sent last
        self._progress = MoveProgress.DONE
        self._move_failure = ""

    # The connection

    @abstractmethod
    def open(self, version: tuple[int, int], *, has_local_control: bool) -> None:
        """Be ready to connect, with nothing left of an earlier connection.

        Args:
            version: major and minor version of the controller's software.
            has_local_control: it knows local and remote control.

        Raises:
            ConnectionFailed: the operating system refuses to.
        """

    @abstractmethod
    def close(self, *, lost: bool) -> None:
        """Stop the arm, end the program, and release everything; `lost`: the controller is silent."""

    @property
    @abstractmethod
    def _controller(self) -> Controller:
        """Whom requests go to."""

    def request_now(self, name: str) -> None:
        """Have the dashboard carry out a request, and wait for the answer; after `close`.

        Raises:
            ConnectionFailed, ConnectionLost, TransitionFailed: it was not carried out.
        """
        client = client_of(self._controller)
        try:
            client.ask(name)
        finally:
            client.close()

    @property
    @abstractmethod
    def ready(self) -> bool:
        """Whether requests can be sent."""

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether commands can be sent, if the program runs."""

    @property
    @abstractmethod
    def counters(self) -> Mapping[str, float]:
        """Numbers for diagnostics."""

    @abstractmethod
    def follow(self) -> None:
        """Take what has come, and send what is due. Before each sample is awaited."""

    @abstractmethod
    def take(self, state: StateSample) -> None:
        """Take note of a new state of the controller."""

    def give_up_connecting(self) -> None:  # noqa: B027 - needed where connecting keeps requests waiting
        """Let requests be sent at once, though control is just being taken."""

    def control_is(self, remote: bool | None) -> None:
        """Take note of who has control."""
        self.remote = remote
        self._was_local |= remote is False

    def _ask_dashboard(self) -> None:
        """Ask from time to time who has control, and which program is loaded."""
        if self.has_local_control:
            self._asks_remote.send_if_due(self._try_request)
        self._asks_program.send_if_due(self._try_request)

    def program_may_differ(self) -> None:
        """Ask at once which program is loaded."""
        self._asks_program.hurry()

    # Motion. Each raises DeviceFault if it cannot be sent.

    @abstractmethod
    def servo_joint(self, q: Sequence[float]) -> None:
        """Stream a joint position (6, rad). The arm holds the last one when the stream ends."""

    @abstractmethod
    def speed_joint(self, qd: Sequence[float], acceleration: float, valid_for: float) -> None:
        """Stream joint speeds (6, rad/s), reached with `acceleration`, rad/s².

        The arm is stopped when no other speed follows within `valid_for` seconds.
        """

    @abstractmethod
    def speed_cartesian(
        self, twist: Sequence[float], acceleration: float, valid_for: float
    ) -> None:
        """Stream a twist of the tool (m/s, rad/s, base axes), reached with `acceleration`, m/s².

        The arm is stopped when no other twist follows within `valid_for` seconds.
        """

    def force(self, wrench: Sequence[float]) -> None:
        """Press with a wrench (N, N·m, base axes, at the tool) along the axes that give way.

        Raises:
            NotImplementedError: this way has no force mode.
        """
        raise NotImplementedError

    @abstractmethod
    def move_joint(self, q: Sequence[float], speed: float, acceleration: float) -> None:
        """Move to a joint position (6, rad): rad/s and rad/s² of the leading axis."""

    @abstractmethod
    def move_linear(self, pose: Sequence[float], speed: float, acceleration: float) -> None:
        """Move the tool on a straight line to `pose` (m, rotation vector): m/s and m/s²."""

    @abstractmethod
    def freedrive(self) -> None:
        """Let the arm be moved by hand, until `stop` or the next motion."""

    @abstractmethod
    def stop(self) -> None:
        """Stop any motion, smoothly, and hold. From any thread."""

    @property
    @abstractmethod
    def stopping(self) -> bool:
        """Whether the last `stop` has not been seen to be carried out: the program told so, or has ended."""

    def move_progress(self) -> MoveProgress:
        """Say where the last move (or freedrive) stands.

        Raises:
            MotionAborted: it failed, with the reason.
        """
        if self._progress is MoveProgress.FAILED:
            raise MotionAborted(self._move_failure, where=self._where)
        return self._progress

    def _move_failed(self, reason: str) -> None:
        self._progress, self._move_failure = MoveProgress.FAILED, reason

    # The control program

    @abstractmethod
    def start_program(self) -> Steps:
        """Start our control program.

        Raises:
            TransitionFailed: with the reason.
        """

    @abstractmethod
    def stop_program(self) -> Steps:
        """Stop our control program. If that is impossible, the controller's watchdog does."""

    @property
    def left_program(self) -> bool:
        """Whether a program of ours may run unattended, without its watchdog."""
        return False

    def end_left_program(self) -> Steps:
        """Stop the program of which `left_program` speaks.

        Raises:
            TransitionFailed: the controller did not.
        """
        logger.warning("%s: a control program left by an interrupted start is stopped", self._where)
        yield from self.ask("stop_program")

    def end_paused_program(self) -> None:
        """End our program instead of leaving it paused: somebody could continue a motion unasked.

        To be called for as long as it is paused: the controller is asked again when it has not done so.
        """
        self.program_runs = False
        self._ends_program.send_if_due(self._try_request)

    # Requests

    def ask(self, name: str, **arguments: Any) -> Generator[None, None, Any]:
        """Send a slow request and return the value of its answer.

        Control program: ``set_payload(mass, center_of_gravity)``, ``set_tcp(pose)``,
        ``set_gravity(direction)``, ``zero_ft_sensor``; our own has more, see `native.link`. Inputs
        and outputs: ``write_inputs(values)``, ``set_tool_voltage(voltage)``. Dashboard: the names in
        `crtk_driver_ur.dashboard.REQUESTS`.

        Raises:
            TransitionFailed: it was refused, or the connection was replaced meanwhile.
            DeviceFault: it could not be sent.
        """
        return (yield from self._answer(name, self._request(name, arguments)))

    def send(self, name: str) -> None:
        """Send a slow request whose answer nobody waits for, if it can be sent; after all before it."""
        self._try_request(name)

    @property
    @abstractmethod
    def _generation(self) -> int:
        """A number that changes when requests that are not answered yet never will be."""

    @abstractmethod
    def _request(self, name: str, arguments: Mapping[str, Any]) -> int:
        """Send a request and return the number that the reply will have.

        Raises:
            DeviceFault: it could not be sent.
        """

    def _try_request(self, name: str) -> int:
        try:
            sent, trouble = self._request(name, {}), ""
        except DeviceFault as error:
            sent, trouble = 0, str(error)
        if trouble not in (self._trouble, ""):
            logger.warning("%s", trouble)
        self._trouble = trouble
        return sent

    def _take_reply(self, reply: Reply) -> None:
        if self._asks_remote.is_answered_by(reply):
            self.control_is(None if reply.error is not None else bool(reply.value))
        elif self._asks_program.is_answered_by(reply):
            known = None if reply.error is not None else str(reply.value)
            self.loaded_program = None if known is None else known.partition(": ")[2]
        elif self._ends_program.is_answered_by(reply):
            if reply.error is not None:
                logger.warning(
                    "%s: a paused program has not ended: %s", self._where, reply.error.text
                )
        elif reply.sequence in self._awaited:
            self._replies[reply.sequence] = reply

    def _forget_requests(self) -> None:
        for recurring in (self._asks_remote, self._asks_program, self._ends_program):
            recurring.forget()
        self._replies.clear()

    def _answer(self, name: str, sequence: int) -> Generator[None, None, Any]:
        """Wait for the answer to a request and return its value."""
        generation = self._generation
        self._awaited.add(sequence)
        try:
            while sequence not in self._replies:
                if self._generation != generation:
                    raise TransitionFailed(
                        f"{name}: {self.loss or 'the connection was replaced'}",
                        where=self._where,
                        remedy="Send it again.",
                    )
                yield
            reply = self._replies.pop(sequence)
        finally:
            self._awaited.discard(sequence)
            self._replies.pop(sequence, None)
        if reply.error is not None:
            raise TransitionFailed(
                f"{reply.error.call}: {reply.error.text}",
                where=self._where,
                remedy=reply.error.hint,
            )
        return reply.value
