"""Which controllers a robot has, which of them are ours, and what one switch has to change. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_drivers.device import Mode

ACTIVE: Final = "active"


class Role(StrEnum):
    """What a controller of ours is for."""

    POSITION = "position"
    VELOCITY = "velocity"
    EFFORT = "effort"
    TRAJECTORY = "trajectory"


FORWARD: Final = frozenset({Role.POSITION, Role.VELOCITY, Role.EFFORT})
"""Controllers that hand each command on to the interface of their own name, and keep the last one."""

UNTIMED: Final = frozenset({Role.VELOCITY, Role.EFFORT})
"""Controllers by which joints go on when nobody commands them any more: none has a timeout."""


@dataclass(frozen=True, slots=True)
class Controller:
    """One controller, as ``list_controllers`` tells it; interfaces are ``joint/kind``."""

    name: str
    state: str
    type: str
    claimed: frozenset[str]
    required: frozenset[str]


@dataclass(frozen=True, slots=True)
class Component:
    """One hardware component, as ``list_hardware_components`` tells it."""

    name: str
    state: str


@dataclass(frozen=True, slots=True)
class Switch:
    """What one call of ``switch_controller`` changes."""

    activate: tuple[str, ...]
    deactivate: tuple[str, ...]

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to change."""
        return not (self.activate or self.deactivate)


def roles_of(config: Ros2ControlConfig) -> Mapping[Role, str]:
    """Return the names of the controllers that a configuration has."""
    pairs = zip(Role, config.controllers, strict=True)
    return MappingProxyType({role: name for role, name in pairs if name})


def ways_of(roles: Mapping[Role, str]) -> Mapping[Mode, Role]:
    """Return by which controller setpoints of each mode go out.

    Positions go to a forward controller, or as trajectories of one point to the trajectory controller.
    """
    ways = {
        Mode.JOINT_POSITION: Role.POSITION if Role.POSITION in roles else Role.TRAJECTORY,
        Mode.JOINT_VELOCITY: Role.VELOCITY,
        Mode.JOINT_EFFORT: Role.EFFORT,
    }
    return MappingProxyType({mode: role for mode, role in ways.items() if role in roles})


def misfit(role: Role, controller: Controller, joints: Sequence[str]) -> str:
    """Say why a controller cannot have a role for these joints, in words; empty if it can."""
    needs = controller.required or controller.claimed
    if not needs:  # unconfigured, so that nothing is known
        return ""
    if role in FORWARD:
        wanted = {f"{joint}/{role}" for joint in joints}
        if needs != wanted:
            return f"it takes {_list(needs)}, not {_list(wanted)}"
        return ""
    taken = {interface.rpartition("/")[0] for interface in needs}
    if taken != set(joints):
        return f"it moves {_list(taken)}, not {_list(joints)}"
    return ""


def joints_of(interfaces: Iterable[str]) -> frozenset[str]:
    """Return the joints of interfaces."""
    return frozenset(interface.rpartition("/")[0] for interface in interfaces)


def switch_to(
    name: str, listed: Mapping[str, Controller], ours: Iterable[str], joints: Sequence[str]
) -> tuple[Switch, tuple[str, ...]]:
    """Return what activates a controller, and which active ones of others are in its way.

    Those of others are deactivated by the switch as well; whoever asks decides whether it may be.
    """
    in_the_way = [
        other.name
        for other in listed.values()
        if other.name != name and other.state == ACTIVE and joints_of(other.claimed) & set(joints)
    ]
    foreign = tuple(other for other in in_the_way if other not in set(ours))
    activate = () if listed[name].state == ACTIVE else (name,)
    return Switch(activate, tuple(in_the_way)), foreign


def _list(names: Iterable[str]) -> str:
    return ", ".join(sorted(names))
