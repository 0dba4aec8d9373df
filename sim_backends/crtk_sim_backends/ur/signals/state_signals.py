"""Signals that follow the state of the robot, and inputs that act on it.

Source: URScript manual, chapter "ioconfiguration": `set_runstate_..._to_value` and
`set_..._input_action`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import Enum
from typing import Final, Protocol, TypeAlias

from crtk_sim_backends.ur.motion.compliance import Compliance
from crtk_sim_backends.ur.safety.modes import RobotMode, RuntimeState
from crtk_sim_backends.ur.safety.power import ArmPower

SetLevel: TypeAlias = Callable[[bool], object]
ReadLevel: TypeAlias = Callable[[], bool]

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


class Player(Protocol):
    """What runs the programs."""

    @property
    def state(self) -> RuntimeState:
        """State of the program."""

    @property
    def failed(self) -> bool:
        """Whether an error or the safety system has ended the last one."""


class StateSignals:
    """The choices for outputs and actions of inputs of one controller; each has a name.

    Args:
        power: of the arm.
        player: runs the programs.
        compliance: gives way in freedrive.
    """

    def __init__(self, power: ArmPower, player: Player, compliance: Compliance) -> None:
        self._power = power
        self._player = player
        self._compliance = compliance
        self._choices: dict[str, tuple[int, SetLevel]] = {}
        self._actions: dict[str, ReadLevel] = {}
        self._running = False
        self._failed = False
        self._powered = False
        self._freedrive = False

    def set_choice(self, name: str, set_level: SetLevel, choice: int) -> None:
        """Let an output follow the state by one of `RULES`, from now on."""
        self.update()  # a program that ends in the period in which it began is seen, too
        self._choices[name] = choice, set_level
        for event in (
            Event.STARTED if self._running else Event.STOPPED,
            Event.POWERED if self._powered else Event.UNPOWERED,
        ):
            _follow(set_level, choice, event)

    def set_action(self, name: str, read_level: ReadLevel, action: str) -> None:
        """Give an input one of `ACTIONS`."""
        if action == FREEDRIVE:
            self._actions[name] = read_level
        else:
            self._actions.pop(name, None)

    def clear_actions(self) -> None:
        """Leave no input an action."""
        self._actions.clear()

    def forget(self, name: str) -> None:
        """Leave a signal that there is no more without choice and action."""
        self._choices.pop(name, None)
        self._actions.pop(name, None)

    def update(self) -> None:
        """Follow the state of this control period."""
        running = self._player.state not in _ENDED
        powered = self._power.mode >= RobotMode.POWER_ON
        if running is not self._running:
            self._running = running
            self._tell(Event.STARTED if running else Event.STOPPED)
        failed = self._player.failed
        if failed is not self._failed:
            self._failed = failed
            if failed:
                self._tell(Event.FAILED)
        if powered is not self._powered:
            self._powered = powered
            self._tell(Event.POWERED if powered else Event.UNPOWERED)
        if self._actions or self._freedrive:
            self._act(running)

    def _tell(self, event: Event) -> None:
        for choice, set_level in self._choices.values():
            _follow(set_level, choice, event)

    def _act(self, running: bool) -> None:
        """Freedrive while an input asks for it; a running program keeps the arm."""
        wanted = any(read_level() for read_level in self._actions.values())
        active = wanted and not running and self._power.mode == RobotMode.RUNNING
        if active is not self._freedrive:
            self._freedrive = active
            self._compliance.freedrive_axes = (True,) * 6 if active else None


def _follow(set_level: SetLevel, choice: int, event: Event) -> None:
    level = RULES[choice].get(event)
    if level is not None:
        set_level(level)
