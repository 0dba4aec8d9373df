"""What the controller manager says and is asked: lists of controllers and hardware, switches. I/O thread."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from typing import Any, Final, Protocol, TypeVar

from crtk_driver_ros2_control.asking import Asked, Told
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.controllers import (
    ACTIVE,
    FORWARD,
    Component,
    Controller,
    Role,
    Switch,
    misfit,
)
from crtk_driver_ros2_control.foreign import messages
from crtk_drivers.device import Steps
from crtk_drivers.errors import DeviceFault, TransitionFailed, raise_first

LOOK: Final = 0.2
"""Seconds between two looks at controllers and hardware."""
SILENT: Final = 3
"""Looks in a row without an answer after which the controller manager counts as gone."""

AGAIN: Final = 0.5
"""Seconds after which what changes nothing is asked again, then twice as many: the first answer to a client
that the other side has not found yet is lost."""

T = TypeVar("T")


class Asking(Protocol):
    """What asks; see `crtk_driver_ros2_control.foreign.node.ForeignNode`."""

    def ask(
        self, service: str, kind: type, fields: Mapping[str, Any], read: Callable[[Any], T]
    ) -> Asked[T]:
        """Ask a service."""

    def forget(self, asked: Asked[Any]) -> None:
        """Wait for an answer no longer."""


class Supervision:
    """Asks the controller manager of one robot. It waits for nothing; procedures are stepped.

    Args:
        config: of the robot.
        roles: names of our controllers.
        joints: in the order of the device.
        node: that asks.

    Attributes:
        controllers: as listed last, by name; None before.
        components: hardware as listed last, by name; None before, or if it is not looked at.
        listed_at: when (monotonic s) that list was asked for.
        unanswered: looks that were not answered.
    """

    def __init__(
        self,
        config: Ros2ControlConfig,
        roles: Mapping[Role, str],
        joints: tuple[str, ...],
        node: Asking,
    ) -> None:
        self._manager = config.controller_manager
        self._timeout = config.service_timeout
        self._hardware = config.hardware
        self._roles = roles
        self._joints = joints
        self._node = node
        self._looks: list[tuple[Asked[Any], Callable[[Any], None]]] = []
        self._next_look = 0.0
        self.controllers: Mapping[str, Controller] | None = None
        self.components: Mapping[str, Component] | None = None
        self.listed_at = 0.0
        self.unanswered = 0
        self._switching: Asked[Told] | None = None
        self._silent: dict[str, str] = {}
        self._in_a_row: Counter[str] = Counter()
        self._answered_at: dict[str, float] = {}

    @property
    def asks(self) -> Mapping[str, type]:
        """The services that it asks, whatever for, by full name."""
        manager, namespace = self._manager, self._manager.rpartition("/")[0]
        kinds: dict[str, type] = {
            f"{manager}/list_controllers": messages.LIST_CONTROLLERS,
            f"{manager}/switch_controller": messages.SWITCH,
        }
        if self._hardware:
            kinds[f"{manager}/list_hardware_components"] = messages.LIST_HARDWARE
            kinds[f"{manager}/set_hardware_component_state"] = messages.SET_HARDWARE
        for role in FORWARD & self._roles.keys():
            kinds[f"{namespace}/{self._roles[role]}/get_parameters"] = messages.PARAMETERS
        return kinds

    # ------------------------------------------------------------------------------------ watching

    def look(self, now: float) -> None:
        """Ask for the lists again where it is time, and take what was answered. Once a cycle."""
        for asked, take in self._looks:
            if asked.answer is not None:
                take(asked)
                self._heard(asked.service, now)
        unanswered = [
            (asked, take)
            for asked, take in self._looks
            if asked.error or (asked.answer is None and now - asked.at > self._timeout)
        ]
        for asked, _ in unanswered:
            self.unanswered += 1
            self._in_a_row[asked.service] += 1
            self._node.forget(asked)
            if self._answered_at.get(asked.service, -math.inf) > asked.at:
                continue  # it has spoken since
            if self._in_a_row[asked.service] >= SILENT or not asked.error:
                why = asked.error or f"no answer in {self._timeout:g} s"
                self._silent.setdefault(asked.service, f"{asked.service}: {why}")
        self._looks = [
            pair for pair in self._looks if pair not in unanswered and pair[0].answer is None
        ]
        if not self._looks and now >= self._next_look:
            self._next_look = now + LOOK
            self._looks.append((self._ask_controllers(), self._take_controllers))
            if self._hardware:
                self._looks.append((self._ask_components(), self._take_components))

    @property
    def silence(self) -> str:
        """Which service does not answer, so that the manager counts as gone; empty if all do."""
        return next(iter(self._silent.values()), "")

    def _heard(self, service: str, now: float) -> None:
        """The manager has answered. That says nothing of its other services."""
        self._in_a_row.pop(service, None)
        self._silent.pop(service, None)
        self._answered_at[service] = now

    def _ask_controllers(self) -> Asked[Mapping[str, Controller]]:
        return self._ask("list_controllers", messages.LIST_CONTROLLERS, {}, messages.controllers)

    def _ask_components(self) -> Asked[Mapping[str, Component]]:
        return self._ask(
            "list_hardware_components", messages.LIST_HARDWARE, {}, messages.components
        )

    def _ask(
        self, service: str, kind: type, fields: Mapping[str, Any], read: Callable[[Any], T]
    ) -> Asked[T]:
        return self._node.ask(f"{self._manager}/{service}", kind, fields, read)

    def _take_controllers(self, asked: Asked[Mapping[str, Controller]]) -> None:
        if asked.at >= self.listed_at:
            self.controllers, self.listed_at = asked.answer, asked.at

    def _take_components(self, asked: Asked[Mapping[str, Component]]) -> None:
        self.components = asked.answer

    def is_active(self, name: str) -> bool:
        """Whether a controller was active when it was listed last."""
        listed = self.controllers or {}
        return name in listed and listed[name].state == ACTIVE

    def broken_hardware(self) -> str:
        """Say which hardware component is not active, in words; empty if all are."""
        return self._not_active(self.components or {})

    def lost_hardware(self) -> str:
        """Say which hardware component is finalized, for which there is no way back; empty if none."""
        components = self.components or {}
        lost = [name for name in self._hardware if _state(components, name) == "finalized"]
        return f"hardware {', '.join(lost)} is finalized: an error ended it" if lost else ""

    def _not_active(self, components: Mapping[str, Component]) -> str:
        states = {name: _state(components, name) for name in self._hardware}
        told = [f"{name} is {state}" for name, state in states.items() if state != ACTIVE]
        return f"hardware {', '.join(told)}" if told else ""

    # --------------------------------------------------------------------------------- procedures

    def answer(self, asked: Asked[T]) -> Generator[None, None, T]:
        """Wait for an answer, as a part of a procedure.

        Raises:
            TransitionFailed: there is none in time.
        """
        while not asked.has_ended:
            if time.monotonic() - asked.at > self._timeout:
                self._node.forget(asked)
                raise TransitionFailed(
                    f"{asked.service} did not answer in {self._timeout:g} s",
                    where=self._manager,
                    remedy="Look at the log of ros2_control_node; a longer service_timeout waits longer.",
                )
            yield
        if asked.answer is None:
            raise TransitionFailed(
                f"{asked.service}: {asked.error}",
                where=self._manager,
                remedy="Is the controller manager running, in this ROS domain?",
            )
        self._heard(asked.service, time.monotonic())
        return asked.answer

    def _answered(self, ask: Callable[[], Asked[T]]) -> Generator[None, None, Asked[T]]:
        """Ask what changes nothing, again where no answer comes; return what was answered, as `answer`."""
        sent, wait = [ask()], AGAIN
        while not any(asked.has_ended for asked in sent):
            now = time.monotonic()
            if now - sent[0].at > self._timeout:
                break
            if now - sent[-1].at > wait:
                sent.append(ask())
                wait *= 2.0
            yield
        first = next((asked for asked in sent if asked.has_ended), sent[0])
        for asked in sent:
            if asked is not first:
                self._node.forget(asked)
        yield from self.answer(first)
        return first

    def listed(self) -> Generator[None, None, Mapping[str, Controller]]:
        """Ask what controllers there are, as a part of a procedure.

        A switch that was given up meanwhile is waited for: what is listed before its end does not stay.
        """
        switching = self._switching
        while switching is not None and not switching.has_ended:
            if time.monotonic() - switching.at > self._timeout:
                break
            yield
        asked = yield from self._answered(self._ask_controllers)
        self._take_controllers(asked)
        assert asked.answer is not None
        return asked.answer

    def joints_of(self, role: Role) -> Generator[None, None, Sequence[int]]:
        """Ask a forward controller for its joints; return the place of each in the order of the device.

        Raises:
            TransitionFailed: it does not tell them, or they are others than ours.
        """
        name = self._roles[role]
        namespace = self._manager.rpartition("/")[0]
        asked = yield from self._answered(
            lambda: self._node.ask(
                f"{namespace}/{name}/get_parameters",
                messages.PARAMETERS,
                {"names": ["joints"]},
                messages.texts,
            )
        )
        names = asked.answer
        assert names is not None
        if sorted(names) != sorted(self._joints):
            raise TransitionFailed(
                f"{name} has the joints {', '.join(names) or 'none'}, not {', '.join(self._joints)}",
                where=self._manager,
                remedy="Give the joints of the robot in the configuration, or another controller.",
            )
        return [self._joints.index(joint) for joint in names]

    def check(self, listed: Mapping[str, Controller]) -> str:
        """Say which of our controllers is not there, or is another one than its role wants."""
        for role, name in self._roles.items():
            if name not in listed:
                return f"there is no controller {name}; there are {', '.join(listed) or 'none'}"
            wrong = misfit(role, listed[name], self._joints)
            if wrong:
                return f"{name} cannot be {role}_controller: {wrong}"
        return ""

    def orders(self) -> Generator[None, None, dict[Role, Sequence[int]]]:
        """Return the orders of all our forward controllers; see `joints_of`."""
        found: dict[Role, Sequence[int]] = {}
        for role in self._roles:
            if role in FORWARD:
                found[role] = yield from self.joints_of(role)
        return found

    def switch(self, switch: Switch) -> Steps:
        """Activate and deactivate in one STRICT call.

        Raises:
            DeviceFault: it was refused, with what the controller manager said.
            TransitionFailed: no answer.
        """
        if switch.is_empty:
            return
        fields = messages.switching(switch.activate, switch.deactivate, self._timeout)
        asked = self._ask("switch_controller", messages.SWITCH, fields, messages.told_of_switch)
        self._switching = asked
        told: Told = yield from self.answer(asked)
        if not told.ok:
            raise DeviceFault(
                f"the controller manager did not switch to {', '.join(switch.activate) or 'none'}: "
                f"{told.text or 'no reason given'}",
                where=self._manager,
                remedy="Its log says more; `ros2 control list_controllers` shows what is active.",
            )

    def end_goals(self) -> Steps:
        """Have the trajectory controller give up all goals that it follows.

        Raises:
            TransitionFailed: no answer.
        """
        namespace = self._manager.rpartition("/")[0]
        action = f"{namespace}/{self._roles[Role.TRAJECTORY]}/follow_joint_trajectory"
        yield from self._answered(
            lambda: self._node.ask(
                f"{action}/_action/cancel_goal", messages.CANCEL, {}, messages.told_of_cancel
            )
        )

    def bring_hardware(self, state: str) -> Steps:
        """Bring all hardware components into a state, those that are not in it.

        Raises:
            DeviceFault: one does not come there.
        """
        if not self._hardware:
            return
        asked = yield from self._answered(self._ask_components)
        components = asked.answer
        assert components is not None
        self._take_components(asked)
        raise_first(self.without_hardware(components))
        for name in self._hardware:
            if components[name].state != state:
                yield from self._bring(name, state)
        self._take_components((yield from self._answered(self._ask_components)))

    def without_hardware(self, components: Mapping[str, Component]) -> Iterator[TransitionFailed]:
        """Yield which hardware components are not among these."""
        missing = [name for name in self._hardware if name not in components]
        if missing:
            yield TransitionFailed(
                f"there is no hardware component {', '.join(missing)}",
                where=self._manager,
                remedy=f"There are: {', '.join(components) or 'none'}.",
            )

    def _bring(self, name: str, state: str) -> Steps:
        fields = messages.bringing(name, state)
        told: Told = yield from self.answer(
            self._ask(
                "set_hardware_component_state",
                messages.SET_HARDWARE,
                fields,
                messages.told_of_hardware,
            )
        )
        if not told.ok:
            raise DeviceFault(
                f"hardware {name} did not become {state}: it is {told.text}",
                where=self._manager,
                remedy="Look at the robot and at the log of ros2_control_node, then enable again.",
            )


def _state(components: Mapping[str, Component], name: str) -> str:
    return components[name].state if name in components else "not there"
