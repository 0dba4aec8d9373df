"""One joint on the bus: its drive's power, mode and homing, stepped once for each SYNC. No I/O."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from crtk_driver_canopen.commissioning import Prepared
from crtk_driver_canopen.config import JointConfig
from crtk_driver_canopen.homing import Homing
from crtk_driver_canopen.modes import ModeBits, ModeChange, OpMode
from crtk_driver_canopen.statemachine import Drive402, State, Status
from crtk_drivers.commands import Kind

__all__ = ["KINDS", "Axis", "Feedback"]

KINDS: Final[Mapping[Kind, tuple[OpMode, ...]]] = MappingProxyType(
    {
        Kind.POSITION: (OpMode.CSP, OpMode.IP),
        Kind.VELOCITY: (OpMode.CSV, OpMode.PV),
        Kind.EFFORT: (OpMode.CST, OpMode.TQ),
    }
)
"""Modes of operation in which a stream of setpoints of each kind is followed, the better one first."""

TARGETS: Final[Mapping[OpMode, str]] = MappingProxyType(
    {
        OpMode.CSP: "target_position",
        OpMode.IP: "interpolation_position",
        OpMode.CSV: "target_velocity",
        OpMode.PV: "target_velocity",
        OpMode.CST: "target_torque",
        OpMode.TQ: "target_torque",
    }
)
"""Object that takes the setpoint of each mode."""


@dataclass(frozen=True, slots=True)
class Feedback:
    """What an axis told in this cycle.

    Attributes:
        statusword: (6041).
        position: (6064) in counts.
        mode: shown (6061); None where it is not mapped, for there is only one.
    """

    statusword: int
    position: int
    mode: int | None


class Axis:
    """One axis of the arm.

    Args:
        name: of the joint.
        config: of the joint.
        facts: what was found out about it.

    Attributes:
        drive: its power state machine.
        mode: of operation that is wanted.
        homed: whether its position is that of the machine: since homing, or from the start.
    """

    def __init__(self, name: str, config: JointConfig, facts: Prepared) -> None:
        self.name = name
        self.config = config
        self.facts = facts
        self.drive = Drive402(stays_in_quick_stop=facts.stays_in_quick_stop)
        self.mode = next(m for m in config.op_modes)
        self.forget_home()
        self._remote = False
        self._change = ModeChange()
        self._homing: Homing | None = None

    @property
    def place(self) -> str:
        """For messages: ``joint elbow (node 3)``."""
        axis = f" axis {self.config.axis}" if self.config.axis else ""
        return f"joint {self.name} (node {self.config.node}{axis})"

    def mode_for(self, kind: Kind) -> OpMode | None:
        """Return the mode of operation for setpoints of a kind; None if it has none."""
        return next((mode for mode in KINDS[kind] if mode in self.config.op_modes), None)

    @property
    def changes_modes(self) -> bool:
        """Whether the mode is a part of the PDOs."""
        return len(self.config.modes) > 1 or self.config.homing is not None

    def use(self, mode: OpMode) -> None:
        """Want a mode of operation."""
        self.mode = mode
        self._change.request(int(mode))

    @property
    def shows_mode(self) -> bool:
        """Whether the drive shows the mode that is wanted."""
        return not self.changes_modes or self._change.done

    @property
    def is_enabled(self) -> bool:
        """Whether it follows setpoints."""
        return self.drive.state is State.ENABLED

    @property
    def homing(self) -> Homing | None:
        """The homing that runs, or ended last."""
        return self._homing

    def begin_homing(self) -> None:
        """Home it, by the method that is configured."""
        homing = self.config.homing
        assert homing is not None
        self._homing = Homing(homing.method, homing.timeout)
        self.use(OpMode.HM)
        self._homing.start()

    def cancel_homing(self) -> None:
        """Stop a homing that runs."""
        if self._homing is not None:
            self._homing.cancel()

    def forget_home(self) -> None:
        """Its position does not count any more, where homing is required."""
        self.homed = self.config.homing is None or not self.config.homing.required

    def end_homing(self) -> None:
        """Forget the homing, and leave its mode."""
        self._homing = None
        self.drive.mode_bits = 0

    def step(self, feedback: Feedback, now: float) -> int:
        """Return the controlword to send."""
        shown = int(self.mode) if feedback.mode is None else feedback.mode
        self._change.step(shown, now)
        bits = 0
        if self._homing is not None:
            bits = self._homing.step(feedback.statusword, shown, now)
        elif self.mode is OpMode.IP:
            bits = int(ModeBits.IP_ENABLE)
        self.drive.mode_bits = bits
        word = self.drive.step(feedback.statusword, now)
        self._remote = self.is_enabled and (self._remote or self._takes_controlwords)
        return word

    @property
    def _takes_controlwords(self) -> bool:
        return bool(self.drive.statusword & Status.REMOTE)

    @property
    def failure(self) -> str:
        """Why it cannot be used, in words; empty if it can."""
        if self.drive.failure is not None:
            return self.drive.failure.text
        if self._remote and not self._takes_controlwords:
            return "remote (bit 9) has gone to 0: somebody else controls it"
        return self._change.failure
