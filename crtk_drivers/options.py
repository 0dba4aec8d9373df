"""The choices of a user that concern motion, and their defaults; `crtk_drivers.config` has them as keys."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

from crtk_drivers.commands import Level

TOO_LATE: Final = 0.5
"""Seconds by which a command of a stream may come later than others of its sender: the network kept it, and
where it leads to may have been stopped meanwhile."""


@dataclass(frozen=True, slots=True)
class LimitPolicy:
    """How commands are limited, see `crtk_drivers.gates`.

    Attributes:
        clamp_servo: a servo position out of range is clamped with a warning; otherwise refused.
        max_step: largest distance in rad (m) between two servo positions of one joint, as a time: a
            joint may be asked to go as far as its velocity limit takes it in this many seconds; with the
            first of a stream no further than its acceleration takes it in twice that time from how it
            moves then. It is also how far a stream may run ahead of its velocity limit before it is refused.
            0.05 s are two and a half periods of a stream at 50 Hz, so that one of its commands may be lost.
        max_linear_step: the same for the tool, in m; it may turn as far as its angular velocity limit takes
            it in `max_step`.
        max_command_age: in seconds; a command whose stamp is older is refused. None: not checked.
        following_error: in rad (m), how far a joint may be from what it was sent; None: as declared.
    """

    clamp_servo: bool = True
    max_step: float = 0.05
    max_linear_step: float = 0.05
    max_command_age: float | None = None
    following_error: float | None = None


@dataclass(frozen=True, slots=True)
class EngineOptions:
    """How streams end, what moves do, and what follows when something stays away. Times in s.

    Attributes:
        stream_timeout: a servo stream that is silent this long has ended.
        interpolate_timeout: the same for an interpolated stream.
        on_stream_timeout: what happens then besides stopping: "hold" stays ENABLED, "pause", "fault".
        sample_timeout: without a sample for this long the link counts as lost.
        mode_switch_dwell: see `crtk_drivers.motion.arbiter`.
        move_cp: "line" moves the tool in a straight line, "joints" the joints all at once.
        on_client_gone: "keep" or "hold": what of free drive and gravity compensation when who asked has gone.
        free_timeout: they end when they are not asked for again for this long; None: they go on.
        limits: of commands.
    """

    stream_timeout: float = 0.1
    interpolate_timeout: float = 0.5
    on_stream_timeout: Literal["hold", "pause", "fault"] = "hold"
    sample_timeout: float = 0.5
    mode_switch_dwell: float = 0.1
    move_cp: Literal["line", "joints"] = "line"
    on_client_gone: Literal["keep", "hold"] = "keep"
    free_timeout: float | None = None
    limits: LimitPolicy = field(default_factory=LimitPolicy)

    def silence(self, level: Level) -> float:
        """Return the seconds without a command after which a stream of `level` has ended."""
        return self.interpolate_timeout if level is Level.INTERPOLATE else self.stream_timeout
