"""State commands while they are carried out: a device's procedure, stepped once a cycle, with a bound.

`accept` judges in the client's thread; `step` works in the I/O thread. What a procedure raises decides
where it ends: `CommandRefused` leaves the state as it was, `ConnectionLost` means that there is nobody to
talk to, and any other error of ours is FAULT with the reason. Before a procedure begins, motion is stopped.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from crtk_drivers.board import StatusBoard
from crtk_drivers.device import Device, Steps
from crtk_drivers.errors import CommandRefused, ConnectionLost, CrtkError, Reason
from crtk_drivers.procedures import close
from crtk_drivers.state import HOMING_COMMANDS, OperatingState, StateCommand, target_of


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
        seed: called when ENABLED is reached: the setpoint becomes the measured position. ENABLED waits
            for as long as it returns False: there is no fresh sample.
    """

    def __init__(
        self,
        device: Device,
        where: str,
        board: StatusBoard,
        end_motion: Callable[[str], None],
        seed: Callable[[float], bool],
    ) -> None:
        self._device = device
        self._needs_homing = device.capabilities.needs_homing
        self._timeout = device.capabilities.transition_timeout
        self._where = where
        self._board = board
        self._end_motion = end_motion
        self._seed = seed
        self._running: _Running | None = None
        self._abandoned: list[_Running] = []
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
        """The command that is being carried out. With it ends its announcement, under the board's lock."""
        with self._board.lock:
            return None if self._running is None else self._running.command

    def accept(self, command: StateCommand) -> None:
        """Begin with the next cycle, or announce the state at once if it is reached already.

        Raises:
            CommandRefused: invalid in this state, or another one is running (`disable` replaces it).
        """
        with self._board.lock:
            running = self._running
            if running is not None:
                if command is not StateCommand.DISABLE:
                    raise CommandRefused(
                        "state_command",
                        Reason.TRANSITION_RUNNING,
                        f"{command}: {running.command} is running",
                        where=self._where,
                        remedy="Wait for it, or send disable.",
                    )
                if running.command is StateCommand.DISABLE:
                    return
            state = self._board.status.state
            target = target_of(state, command)
            if target is state and command not in HOMING_COMMANDS and running is None:
                self._board.announce()
                return
            self.cancel()
            self._running = _Running(command, target)

    def cancel(self) -> None:
        """Forget the running command. From any thread; the next `step` closes its procedure."""
        with self._board.lock:
            if self._running is not None:
                self._abandoned.append(self._running)
                self._running = None

    def step(self, now: float) -> None:
        """Resume the running procedure, if there is one.

        Raises:
            ConnectionLost: by the procedure.
        """
        while self._abandoned:
            close(self._abandoned.pop().steps, self._where)
        running = self._running
        if running is None:
            return
        try:
            if running.steps is None:
                self._begin(running, now)
            assert running.steps is not None
            next(running.steps)
        except StopIteration:
            if self._reached(running, now):
                return
        except ConnectionLost:
            raise
        except CommandRefused as refusal:
            self._refused(running, refusal)
            return
        except CrtkError as error:
            self._failed(running, f"{running.command}: {error}")
            return
        if now > running.deadline:
            close(running.steps, self._where)
            self._failed(running, f"{running.command} did not finish in {self._timeout:g} s")

    def _begin(self, running: _Running, now: float) -> None:
        self._end_motion(str(running.command))
        if self._board.status.state is OperatingState.ENABLED:
            self._device.stop()
        running.steps = self._procedures[running.command]()
        running.deadline = now + self._timeout
        if running.command in HOMING_COMMANDS:
            self._board.update(busy=True)

    def _ended(self, running: _Running) -> bool:
        """Whether `running` was still the command that runs; now none does."""
        if self._running is not running:
            return False
        self._running = None
        return True

    def _refused(self, running: _Running, refusal: CommandRefused) -> None:
        with self._board.lock:
            self._ended(running)
            self._board.update(busy=False)
            self._board.refused(refusal)
            self._board.announce()

    def _failed(self, running: _Running, reason: str) -> None:
        moving = self._board.status.state is OperatingState.ENABLED
        with self._board.lock:
            if self._ended(running):
                self._board.update(OperatingState.FAULT, reason, busy=False)
        if moving:
            self._device.stop()

    def _reached(self, running: _Running, now: float) -> bool:
        """Announce the end, and return True; False if it is not known yet where the device is."""
        homing = running.command in HOMING_COMMANDS
        if running.target is OperatingState.ENABLED and not homing and not self._seed(now):
            return False
        homed = self._device.is_homed if self._needs_homing else True
        with self._board.lock:
            if self._ended(running):
                before = self._board.status
                self._board.update(running.target, homed=homed, busy=False)
                if self._board.status is before:
                    self._board.announce()
        return True
