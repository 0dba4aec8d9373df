"""State commands while they are carried out: a device's procedure, stepped once a cycle, with a bound.

`accept` judges in the client's thread; `step` works in the I/O thread. What a procedure raises decides
where it ends: `CommandRefused` leaves the state as it was, anything else is FAULT with the reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from crtk_drivers.board import StatusBoard
from crtk_drivers.device import Device, Steps
from crtk_drivers.errors import CommandRefused, CrtkError, Reason
from crtk_drivers.state import OperatingState, StateCommand, target_of

_HOMING = frozenset({StateCommand.HOME, StateCommand.UNHOME})


@dataclass(slots=True)
class _Running:
    command: StateCommand
    target: OperatingState
    steps: Steps | None = None
    deadline: float = 0.0


class Transitions:
    """Carries out the state commands of one device.

    Args:
        device: whose procedures are run.
        where: the device, for messages.
        board: where the reached state is announced.
        end_motion: called before a procedure begins.
        seed: called when ENABLED is reached: the setpoint becomes the measured position.
    """

    def __init__(
        self,
        device: Device,
        where: str,
        board: StatusBoard,
        end_motion: Callable[[str], None],
        seed: Callable[[], None],
    ) -> None:
        self._device = device
        self._needs_homing = device.capabilities.needs_homing
        self._timeout = device.capabilities.transition_timeout
        self._where = where
        self._board = board
        self._end_motion = end_motion
        self._seed = seed
        self._running: _Running | None = None
        self._procedures: dict[StateCommand, Callable[[], Steps]] = {
            StateCommand.ENABLE: device.enable,
            StateCommand.DISABLE: device.disable,
            StateCommand.PAUSE: device.pause,
            StateCommand.RESUME: device.resume,
            StateCommand.HOME: device.home,
            StateCommand.UNHOME: device.unhome,
        }

    @property
    def running(self) -> StateCommand | None:
        """The command that is being carried out."""
        running = self._running
        return None if running is None else running.command

    def accept(self, command: StateCommand) -> None:
        """Begin with the next cycle, or announce the state at once if it is reached already.

        Raises:
            CommandRefused: invalid in this state, or another one is running (`disable` replaces it).
        """
        with self._board.lock:
            running = self._running
            if running is not None and command is not StateCommand.DISABLE:
                raise CommandRefused(
                    "state_command",
                    Reason.TRANSITION_RUNNING,
                    f"{command}: {running.command} is running",
                    where=self._where,
                    remedy="Wait for it, or send disable.",
                )
            state = self._board.status.state
            target = target_of(state, command)
            if target is state and command not in _HOMING and running is None:
                self._board.announce()
                return
            self._running = _Running(command, target)

    def cancel(self) -> None:
        """Forget the running command. From any thread; its procedure is not resumed again."""
        self._running = None

    def step(self, now: float) -> None:
        """Resume the running procedure, if there is one."""
        running = self._running
        if running is None:
            return
        try:
            if running.steps is None:
                self._end_motion(str(running.command))
                running.steps = self._procedures[running.command]()
                running.deadline = now + self._timeout
                if running.command is StateCommand.HOME:
                    self._board.update(busy=True)
            next(running.steps)
        except StopIteration:
            self._reached(running)
        except CommandRefused as refusal:
            self._running = None
            self._board.update(busy=False)
            self._board.refused(refusal)
            self._board.announce()
        except CrtkError as error:
            self._failed(f"{running.command}: {error}")
        else:
            if now > running.deadline:
                running.steps.close()
                self._failed(f"{running.command} did not finish in {self._timeout:g} s")

    def _failed(self, reason: str) -> None:
        self._running = None
        self._board.update(OperatingState.FAULT, reason, busy=False)

    def _reached(self, running: _Running) -> None:
        with self._board.lock:
            if self._running is not running:
                return
            self._running = None
            if running.target is OperatingState.ENABLED and running.command not in _HOMING:
                self._seed()
            before = self._board.status
            homed = self._device.is_homed if self._needs_homing else True
            self._board.update(running.target, homed=homed, busy=False)
            if self._board.status is before:
                self._board.announce()
