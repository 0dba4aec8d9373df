"""What all that moves one device shares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from crtk_drivers.commands import Kind
from crtk_drivers.device import Capabilities, Device, Setpoint
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.gates.command import CommandCheck
from crtk_drivers.gates.setpoint import SetpointLimiter
from crtk_drivers.motion.feedback import Feedback
from crtk_drivers.motion.inverse import Reach
from crtk_drivers.motion.stopping import Stopping
from crtk_drivers.motion.told import Told
from crtk_drivers.options import EngineOptions
from crtk_drivers.samples import Value, Vector
from crtk_drivers.status.board import StatusBoard
from crtk_drivers.status.health import HealthRecorder

UNSEEN = 0.1
"""Seconds for which efforts go on without a measurement."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MotionContext:
    """The parts of one device's motion that orders, streams, moves and state commands work with.

    Attributes:
        device: that is commanded.
        where: the device, for messages.
        options: of the user.
        feedback: what is measured and set.
        told: what the fronts tell of it, and what is aimed at.
        check: of what was computed from a command.
        limiter: the last gate before the wire.
        inverse: from poses to what the hardware takes.
        stopping: stops the device, and watches that it stands.
        board: told of states, warnings and refusals.
        health: counts.
    """

    device: Device
    where: str
    options: EngineOptions
    feedback: Feedback
    told: Told
    check: CommandCheck
    limiter: SetpointLimiter
    inverse: Reach
    stopping: Stopping
    board: StatusBoard
    health: HealthRecorder

    @property
    def capabilities(self) -> Capabilities:
        """Those of the device."""
        return self.device.capabilities

    @property
    def cycle(self) -> float:
        """Seconds between two cycles."""
        return 1.0 / self.device.capabilities.rate

    def limit(self, name: str, setpoint: Setpoint, now: float) -> Setpoint:
        """Return the setpoint of a command that may be sent at monotonic seconds; what is clamped is told.

        Raises:
            CommandRefused: it may not be sent; for efforts see `check_driven`, too.
        """
        if setpoint.mode.kind is Kind.EFFORT:
            self.check_driven(name, now)
        before = self.feedback.before(setpoint.mode, now)
        limited = self.limiter.limit(name, setpoint, before, now)
        if limited.warning:
            self._warn_clamped(name, limited.warning)
        return limited.setpoint

    def check_driven(self, name: str, now: float) -> None:
        """Refuse to go on with efforts that drive a joint too fast, out of its range, or unseen.

        An effort does not say where it takes a joint: it is sent as long as joints are measured.

        Args:
            name: of the command.
            now: monotonic seconds.

        Raises:
            CommandRefused: with what is the matter.
        """
        feedback = self.feedback
        age, longest = feedback.joints_age(now), max(feedback.stale_after, UNSEEN)
        if age > longest:
            raise CommandRefused(
                name,
                Reason.NOT_MEASURED,
                f"nothing was measured for {age:.3f} s (at most {longest:g} s)",
                where=self.where,
                remedy="Stopped. Efforts are sent as long as it is seen where they take the joints: "
                "look at the link.",
            )
        joints, _ = feedback.measured_state()
        self.limiter.check_driven(name, replace(joints, position=feedback.moved_on(now)))

    def into_range(self, name: str, positions: Vector, before: Vector) -> Vector:
        """Return joint positions (n,) of a command, clamped to their range; that is told.

        Raises:
            CommandRefused: out of range where the user does not want them clamped.
        """
        clamped, warning = self.limiter.into_range(name, positions, before)
        if warning:
            self._warn_clamped(name, warning)
        return clamped

    def latch(self, values: Mapping[str, Value], stamp_ns: int) -> None:
        """Let the fronts tell new values of ``goal_*`` or of settings, with the stamp of the command."""
        self.told.latch(values, stamp_ns)
        for name in values:
            self.board.latched(name)

    def _warn_clamped(self, name: str, warning: str) -> None:
        self.health.clamped += 1
        self.board.warned(f"{name}: {warning}")
