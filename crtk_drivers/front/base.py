"""What the two fronts have in common: a device in this process and one on the far side of ROS."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from types import TracebackType
from typing import Self

from crtk_drivers.state import OperatingState, StateCommand, Status

DEFAULT_AGE = 0.1
"""Seconds that feedback may be old unless `age` says otherwise."""

DEFAULT_WAIT = 1.0
"""Seconds to wait for fresh feedback unless `wait` says otherwise."""


class DeviceFront(ABC):
    """The operating state as methods, and the life cycle. Closed at the end of a ``with`` statement."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Let the device go."""

    @abstractmethod
    def operating_state(self) -> Status:
        """Return state, is_homed and is_busy."""

    @abstractmethod
    def wait_for_status(self, test: Callable[[Status], bool], timeout: float) -> bool:
        """Wait until `test` holds for an announced status; return whether it did in time."""

    @abstractmethod
    def state_command(self, command: str, timeout: float = 30.0) -> None:
        """Send a state command and wait until it is carried out.

        Args:
            command: enable, disable, pause, resume, home or unhome.
            timeout: in seconds; 0 does not wait.

        Raises:
            CommandRefused: invalid in this state, or refused by the device.
            TransitionFailed: it ended in another state, or did not end in time.
        """

    def is_enabled(self) -> bool:
        """Whether the state is ENABLED."""
        return self.operating_state().state is OperatingState.ENABLED

    def is_homed(self) -> bool:
        """Whether positions can be trusted."""
        return self.operating_state().is_homed

    def is_busy(self) -> bool:
        """Whether a move or homing is running."""
        return self.operating_state().is_busy

    def wait_for_busy(self, is_busy: bool = False, timeout: float = 30.0) -> bool:
        """Wait until is_busy is as asked; return whether it was in time."""
        return self.wait_for_status(lambda status: status.is_busy is is_busy, timeout)

    def wait_for_operating_state(self, state: str, timeout: float = 30.0) -> bool:
        """Wait until the state is as asked; return whether it was in time."""
        return self.wait_for_status(lambda status: status.state == state, timeout)

    def enable(self, timeout: float = 30.0) -> None:
        """Power up and accept motion commands. See `state_command`."""
        self.state_command(StateCommand.ENABLE, timeout)

    def disable(self, timeout: float = 30.0) -> None:
        """Power down. See `state_command`."""
        self.state_command(StateCommand.DISABLE, timeout)

    def pause(self, timeout: float = 30.0) -> None:
        """Stop and ignore motion commands, with power on. See `state_command`."""
        self.state_command(StateCommand.PAUSE, timeout)

    def resume(self, timeout: float = 30.0) -> None:
        """Go on after PAUSED. See `state_command`."""
        self.state_command(StateCommand.RESUME, timeout)

    def home(self, timeout: float = 60.0) -> None:
        """Find the reference positions. See `state_command`."""
        self.state_command(StateCommand.HOME, timeout)

    def unhome(self, timeout: float = 30.0) -> None:
        """Forget the reference positions. See `state_command`."""
        self.state_command(StateCommand.UNHOME, timeout)
