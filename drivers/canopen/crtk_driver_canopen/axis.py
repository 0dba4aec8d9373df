"""One joint on the bus: its drive's power, mode and homing, stepped once for each SYNC. No I/O."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from crtk_driver_canopen.commissioning import Prepared
from crtk_driver_canopen.homing import Homing
from crtk_driver_canopen.joint_config import JointConfig
from crtk_driver_canopen.modes import WAYS, ModeBits, ModeChange, OpMode, SetpointHandshake, Way
from crtk_driver_canopen.safeguards import PositionLimits, position_limits, write_position_limits
from crtk_driver_canopen.sdo import Sdo
from crtk_driver_canopen.statemachine import POWERED, Drive402, State, Status
from crtk_driver_canopen.units import home_counts
from crtk_drivers.kit.axes import is_astray

_MIRRORED: Final = 0.2
"""Part of the home position within which a joint is believed to stand at the negative of it."""


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
        handshake: of the set-points of profile position.
        mode: of operation that is wanted.
        limits: of position that its drive holds itself (607D); None: none of ours.
        notes: what is not as it should be, in words.
        homed: whether its position is that of the machine: since homing, or from the start.
    """

    def __init__(self, name: str, config: JointConfig, facts: Prepared) -> None:
        self.name = name
        self.config = config
        self.facts = facts
        self.drive = Drive402(stays_in_quick_stop=facts.stays_in_quick_stop)
        self.handshake = SetpointHandshake()
        self.mode = config.op_modes[0]
        self.limits = facts.limits
        self.notes = list(facts.notes)
        self.homed = not self._must_be_homed
        self._halted = False
        self._remote = False
        self._change = ModeChange()
        self._homing: Homing | None = None

    @property
    def place(self) -> str:
        """For messages: ``joint elbow (node 3)``."""
        axis = f" axis {self.config.axis}" if self.config.axis else ""
        return f"joint {self.name} (node {self.config.node}{axis})"

    def mode_for(self, way: Way) -> OpMode:
        """Return the mode of operation for what it is to follow; one of `JointConfig.ways`."""
        return next(mode for mode in WAYS[way] if mode in self.config.op_modes)

    @property
    def changes_modes(self) -> bool:
        """Whether the mode is a part of the PDOs."""
        return len(self.config.modes) > 1 or self.config.homing is not None

    def use(self, mode: OpMode) -> None:
        """Want a mode of operation."""
        self.handshake.cancel()
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
    def is_powered(self) -> bool:
        """Whether its motor has current, as far as it told."""
        return self.drive.state in POWERED

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

    @property
    def _must_be_homed(self) -> bool:
        return self.config.homing is not None and self.config.homing.required

    def forget_home(self) -> None:
        """Its position does not count any more until it has been homed, where it can be."""
        self.homed = self.config.homing is None

    def note_home_lost(self) -> None:
        """What its drive counts from is not known any more, where homing is required: it has started anew,
        or says so.
        """
        self.homed = not self._must_be_homed

    def found_mirrored(self, position: int) -> bool:
        """Whether it stands where it would if the drive took the home offset (607C) the other way.

        Args:
            position: (6064) after homing, in counts.
        """
        homing = self.config.homing
        if homing is None or homing.position is None:
            return False
        wanted = home_counts(homing.position, self.facts.units)
        return abs(position + wanted) < _MIRRORED * abs(wanted)

    def is_astray(self, position: float) -> bool:
        """Whether it cannot stand there, in rad (m); one that can be homed may count from anywhere."""
        joint = self.config
        is_believed = joint.homing is None or (joint.homing.required and self.homed)
        return is_believed and is_astray(
            position, joint.lower, joint.upper, self.facts.units.position
        )

    def end_homing(self) -> None:
        """Forget the homing, and leave its mode."""
        self._homing = None
        self.drive.mode_bits = 0

    def limits_here(self, position: int) -> PositionLimits:
        """Return the limits (607D) for the drive of a joint that stands at a position, in counts."""
        return position_limits(self.config, self.facts.units).widened(position)

    def give_limits(self, sdo: Sdo, limits: PositionLimits) -> None:
        """Have the drive hold limits of position, if it has them.

        Raises:
            SdoSilent, ProtocolError, BusLost: it does not answer as it should.
        """
        told: list[str] = []
        self.limits = limits if write_position_limits(sdo, self.config, limits, told) else None
        self.notes += [text for text in told if text not in self.notes]

    def halt(self) -> None:
        """Stop a move of its own. It stays halted until the next one is handed over, or in another mode.

        Without halt a drive would go on to the set-point that it has (CiA 402-2, profile position).
        """
        self.handshake.cancel()
        self._halted = True

    def step(self, feedback: Feedback, now: float) -> int:
        """Return the controlword to send."""
        shown = int(self.mode) if feedback.mode is None else feedback.mode
        self._change.step(shown, now)
        bits = 0
        if self._homing is not None:
            bits = self._homing.step(feedback.statusword, shown, now)
        elif self.mode is OpMode.PP:
            bits = self.handshake.step(feedback.statusword, now)
        elif self.mode is OpMode.IP:
            bits = int(ModeBits.IP_ENABLE)
        self._halted &= shown == OpMode.PP and not self.handshake.handed_over
        self.drive.halt = self._halted
        self.drive.mode_bits = bits
        word = self.drive.step(feedback.statusword, now)
        self._remote = self.is_enabled and (self._remote or self.takes_controlwords)
        return word

    @property
    def takes_controlwords(self) -> bool:
        """Whether the drive says that it does (remote, bit 9); some never say so."""
        return bool(self.drive.statusword & Status.REMOTE)

    @property
    def failure(self) -> str:
        """Why it cannot be used, in words; empty if it can."""
        if self.drive.failure is not None:
            return self.drive.failure.text
        if self._remote and not self.takes_controlwords:
            return "remote (bit 9) has gone to 0: somebody else controls it"
        return self._change.failure
