"""Every error that the core raises, as a tree.

    CrtkError                      everything below; catch this to catch all of it
    ├── ConfigError                a configuration that cannot be used (also ValueError)
    ├── PluginError                a plugin that cannot be found or loaded (also LookupError)
    ├── WrongReading               a reading of a driver returned a value of a wrong class (also TypeError)
    ├── MissingExtra               a library of an extra is not installed (also ImportError)
    ├── DeviceError                the hardware, or the link to it, is at fault
    │   ├── ConnectionFailed       could not be reached in time (also ConnectionError)
    │   ├── ConnectionLost         was reached, and is gone (also ConnectionError)
    │   ├── ProtocolError          the peer sent something that its protocol does not allow
    │   ├── DeviceFault            the hardware reports a fault (protective stop, EMCY, hardware error)
    │   ├── StopUnconfirmed        a stop was asked for, and the hardware has not been seen to stand
    │   └── TransitionFailed       enable, home, ... did not reach their end
    ├── CommandRefused             your command was not accepted, and nothing was sent (also ValueError)
    ├── MotionAborted              an accepted motion ended before its goal
    ├── DataTimeout                no data as fresh as you asked for (also TimeoutError)
    ├── RecordingError             a recording that cannot be written or read (also ValueError)
    ├── CalibrationError           measurements that tell nothing that could be relied on (also ValueError)
    └── KinematicsError            no joint position reaches the pose (also ValueError)

An error says what happened, on which device and address, and what to do next: `message`, `where` and
`remedy` are kept apart so that a log, a topic and a terminal can show them in their own way. Write commands
as ``crtk-driver ...`` and ``pip install ...``. On a terminal, `crtk_drivers.errors.wording` replaces them by
those that work there.

Example: `arm.servo_jp([0.0] * 5)` on a UR raises
`CommandRefused: ur 192.168.1.10:30004: servo_jp refused (wrong_size): 5 values in position for 6 joints.
Send one value for each of shoulder_pan_joint, ...`
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from typing_extensions import override

from crtk_drivers.errors.wording import worded


def with_remedy(text: str, remedy: str) -> str:
    """Return `text` and, as a sentence of its own, what to do next."""
    if not remedy:
        return text
    return f"{text} {remedy}" if text.endswith(("?", "!")) else f"{text.rstrip('.')}. {remedy}"


REPORT = "Please report this."
"""What to do about a mistake in this program, or in a driver."""


def unexpected(error: Exception) -> str:
    """Return an exception that is a mistake in this program, or in a driver, in words."""
    return f"unexpected {type(error).__name__}: {error}"


def without_name(text: str, where: str) -> str:
    """Return what is said of the device `where` without naming it, for those who do that themselves.

    Of ``enable: ur 10.0.0.2:30004: no power``, ``enable: no power`` is left, and of a part of it at the same
    address, ``RTDE 10.0.0.2:30004: refused``, its own name: ``RTDE: refused``.
    """
    address = where.partition(" ")[2]
    text = text.replace(f"{where}: ", "")
    if not address:
        return text
    return text.replace(f": {address}: ", ": ").replace(f" {address}: ", ": ")


class CrtkError(Exception):
    """Base of all errors of this package.

    Args:
        message: what happened.
        where: the device and its address, for example ``ur 192.168.1.10:30004``; may be empty.
        remedy: what to do next; may be empty.
    """

    def __init__(self, message: str, *, where: str = "", remedy: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.where = where
        self.remedy = remedy

    @property
    def statement(self) -> str:
        """What happened and where, without what to do next: for a text that goes on."""
        return f"{self.where}: {self.message}" if self.where else self.message

    @override
    def __str__(self) -> str:
        return with_remedy(self.statement, self.remedy)


class ConfigError(CrtkError, ValueError):
    """A configuration that cannot be used: unknown key, wrong type, impossible value."""


class PluginError(CrtkError, LookupError):
    """A device or simulator plugin that cannot be found or loaded."""


class WrongReading(CrtkError, TypeError):
    """A reading of a driver returned a value of another class than that of its payload."""


class MissingExtra(CrtkError, ImportError):
    """A library that belongs to an extra is not installed.

    Args:
        library: name of its distribution.
        extra: that it belongs to.
        owner: the distribution that has this extra.
        because: why it may be missing.
        remedy: instead of installing the extra.
    """

    def __init__(
        self,
        library: str,
        extra: str,
        owner: str = "crtk-drivers",
        *,
        because: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(
            f"{library} is not installed{because and ', and '}{because}",
            remedy=remedy or f"Install it with: pip install '{owner}[{extra}]'",
        )
        self.extra = extra

    @override
    def __str__(self) -> str:
        """Name the command that works here, as a terminal would: in plain Python it is all that one sees."""
        return worded(super().__str__())


class DeviceError(CrtkError):
    """The hardware, or the link to it, is at fault."""


class ConnectionFailed(DeviceError, ConnectionError):
    """The device could not be reached in the time allowed."""


class ConnectionLost(DeviceError, ConnectionError):
    """The device was connected and the link is gone."""


class ProtocolError(DeviceError):
    """The peer sent something that its protocol does not allow."""


class DeviceFault(DeviceError):
    """The hardware reports a fault that keeps it from moving."""


class StopUnconfirmed(DeviceError):
    """A stop was asked for, and it could not be read back that the hardware stands."""


class TransitionFailed(DeviceError):
    """A change of operating state (enable, home, ...) did not reach its end."""


class Reason(StrEnum):
    """Why a command was refused: the machine-readable half of a refusal."""

    NOT_ENABLED = "not_enabled"
    INVALID_TRANSITION = "invalid_transition"
    TRANSITION_RUNNING = "transition_running"
    UNKNOWN_COMMAND = "unknown_command"
    UNSUPPORTED = "unsupported"
    NOT_FINITE = "not_finite"
    EMPTY = "empty"
    WRONG_SIZE = "wrong_size"
    WRONG_NAMES = "wrong_names"
    WRONG_TYPE = "wrong_type"
    BAD_QUATERNION = "bad_quaternion"
    WRONG_FRAME = "wrong_frame"
    TOO_OLD = "too_old"
    LOST = "lost"
    FROM_FUTURE = "from_future"
    NOT_MEASURED = "not_measured"
    OUT_OF_RANGE = "out_of_range"
    STEP_TOO_LARGE = "step_too_large"
    UNREACHABLE = "unreachable"
    MODE_SWITCH = "mode_switch"
    STREAM_OWNED = "stream_owned"
    STREAM_ENDED = "stream_ended"
    NO_EFFECT = "no_effect"
    FAILED = "failed"
    INTERNAL_ERROR = "internal_error"
    NOT_CONNECTED = "not_connected"
    LOCAL_CONTROL = "local_control"
    SECOND_DRIVER = "second_driver"


class CommandRefused(CrtkError, ValueError):
    """A command that was not accepted; nothing was sent and nothing changed.

    Args:
        command: the CRTK name, for example ``servo_jp``.
        reason: why, for programs.
        message: why, for people.
        remedy: what to send instead.
        stamp_ns: of the command, by its sender; 0 if it had none.
        state_command: what a ``state_command`` asked for, for example ``enable``; empty of other commands.
    """

    def __init__(
        self,
        command: str,
        reason: Reason,
        message: str,
        *,
        where: str = "",
        remedy: str = "",
        stamp_ns: int = 0,
        state_command: str = "",
    ) -> None:
        super().__init__(f"{command} refused ({reason}): {message}", where=where, remedy=remedy)
        self.command = command
        self.reason = reason
        self.detail = message
        self.stamp_ns = stamp_ns
        self.state_command = state_command

    def of(self, stamp_ns: int, where: str = "", state_command: str = "") -> CommandRefused:
        """Return the refusal of the command that has this stamp.

        The device is `where` and what was asked for `state_command`, unless the refusal names its own.
        """
        told = CommandRefused(
            self.command,
            self.reason,
            self.detail,
            where=self.where or where,
            remedy=self.remedy,
            stamp_ns=stamp_ns,
            state_command=self.state_command or state_command,
        )
        return told.with_traceback(self.__traceback__)


def raise_first(errors: Iterable[CrtkError]) -> None:
    """Raise the first of these errors; return if there is none.

    Raises:
        CrtkError: that one.
    """
    for error in errors:
        raise error


class MotionAborted(CrtkError):
    """An accepted motion ended before its goal: pre-empted, held, or stopped by a fault."""


class DataTimeout(CrtkError, TimeoutError):
    """No data as fresh as was asked for arrived in time."""


class RecordingError(CrtkError, ValueError):
    """A recording that cannot be written or read: no space, damaged, or none at all."""


class CalibrationError(CrtkError, ValueError):
    """Measurements that tell nothing that could be relied on: too few, too much alike, or contradictory."""


class KinematicsError(CrtkError, ValueError):
    """No joint position within the limits reaches the pose."""
