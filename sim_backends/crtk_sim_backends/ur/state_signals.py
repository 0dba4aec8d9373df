"""Signals that follow the state of the robot, and inputs that act on it.

Source: URScript manual, chapter "ioconfiguration": `set_runstate_..._to_value` and
`set_..._input_action`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Final

from crtk_sim_backends.ur.registers import boolean_written, read_boolean
from crtk_sim_backends.ur.safety import RobotMode, RuntimeState

if TYPE_CHECKING:
    from crtk_sim_backends.ur.controller import Controller

FREEDRIVE: Final = "freedrive"
ACTIONS: Final = ("default", FREEDRIVE)


class Event(Enum):
    """What outputs follow."""

    STARTED = "a program has started"
    STOPPED = "the program has ended"
    FAILED = "the program has ended by a protective stop, fault, violation or runtime error"
    POWERED = "the arm has power"
    UNPOWERED = "the arm has no power"


RULES: Final[tuple[Mapping[Event, bool], ...]] = (
    {},
    {Event.STOPPED: False},
    {Event.STOPPED: True},
    {Event.STARTED: True, Event.STOPPED: False},
    {Event.FAILED: False},
    {Event.STARTED: True, Event.FAILED: False},
    {Event.POWERED: True, Event.UNPOWERED: False},
    {Event.POWERED: False, Event.UNPOWERED: True},
)
"""To which level each choice of the manual (0 to 7) sets an output, by event."""

POWER_CHOICES: Final = range(8)
CHOICES: Final = range(6)  # of the tool's outputs

_ENDED: Final = (RuntimeState.STOPPED, RuntimeState.STOPPING)


@dataclass(frozen=True, slots=True)
class Output:
    """One output: kind "digital" (bit of RTDE's), "analog" or "register" (boolean)."""

    kind: str
    index: int


class StateSignals:
    """The choices for outputs and actions of inputs of one controller."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._choices: dict[Output, int] = {}
        self._digital_actions = 0  # bits of the inputs that switch freedrive on
        self._register_actions: set[int] = set()
        self._running = False
        self._failed = False
        self._powered = False
        self._freedrive = False

    def set_choice(self, output: Output, choice: int) -> None:
        """Let an output follow the state by one of `RULES`, from now on."""
        self.update()  # a program that ends in the period in which it began is seen, too
        self._choices[output] = choice
        for event in (
            Event.STARTED if self._running else Event.STOPPED,
            Event.POWERED if self._powered else Event.UNPOWERED,
        ):
            self._follow(output, choice, event)

    def set_digital_action(self, bit: int, action: str) -> None:
        """Set the action of a digital input."""
        if action == FREEDRIVE:
            self._digital_actions |= 1 << bit
        else:
            self._digital_actions &= ~(1 << bit)

    def set_register_action(self, register: int, action: str) -> None:
        """Set the action of a boolean input register."""
        if action == FREEDRIVE:
            self._register_actions.add(register)
        else:
            self._register_actions.discard(register)

    def clear_actions(self) -> None:
        """Leave no input an action."""
        self._digital_actions = 0
        self._register_actions.clear()

    def update(self) -> None:
        """Follow the state of this control period."""
        c = self._controller
        running = c.runtime_state not in _ENDED
        powered = c.robot_mode >= RobotMode.POWER_ON
        if running is not self._running:
            self._running = running
            self._tell(Event.STARTED if running else Event.STOPPED)
        failed = c.player.failed
        if failed is not self._failed:
            self._failed = failed
            if failed:
                self._tell(Event.FAILED)
        if powered is not self._powered:
            self._powered = powered
            self._tell(Event.POWERED if powered else Event.UNPOWERED)
        if self._digital_actions or self._register_actions or self._freedrive:
            self._act(running)

    def _tell(self, event: Event) -> None:
        for output, choice in self._choices.items():
            self._follow(output, choice, event)

    def _follow(self, output: Output, choice: int, event: Event) -> None:
        level = RULES[choice].get(event)
        if level is None:
            return
        c = self._controller
        if output.kind == "digital":
            c.signals.set_digital_outputs(1 << output.index, -1 if level else 0)
        elif output.kind == "analog":
            c.signals.set_analog_output(output.index, float(level))
        else:
            c.outputs.update(boolean_written(c.outputs, "output", output.index, level))

    def _act(self, running: bool) -> None:
        """Freedrive while an input asks for it; a running program keeps the arm."""
        c = self._controller
        wanted = bool(c.outputs["actual_digital_input_bits"] & self._digital_actions) or any(
            read_boolean(c.inputs, "input", register) for register in self._register_actions
        )
        active = wanted and not running and c.robot_mode == RobotMode.RUNNING
        if active is not self._freedrive:
            self._freedrive = active
            c.compliance.freedrive_axes = (True,) * 6 if active else None
