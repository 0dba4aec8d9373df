"""A configuration written from what a robot has. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import yaml

from crtk_driver_ros2_control.controllers import (
    FORWARD,
    UNTIMED,
    Controller,
    Role,
    joints_of,
    misfit,
)
from crtk_drivers.kinematics.chain import Chain
from crtk_drivers.kinematics.urdf import ends_of_joints, joint_rates, parse_urdf

_TYPE: Final = "JointTrajectoryController"


def roles_in(
    controllers: Mapping[str, Controller], orders: Mapping[str, tuple[str, ...]]
) -> dict[Role, str]:
    """Return the controllers that move all joints of the robot's largest one, by what they can be for.

    Of several for one role the first counts, a trajectory controller before others of its kind.
    """
    movers = {name: one for name, one in controllers.items() if one.required or one.claimed}
    if not movers:
        return {}
    joints = max((_joints(one) for one in movers.values()), key=len)
    found: dict[Role, str] = {}
    for name, one in movers.items():
        if _TYPE in one.type and _joints(one) == joints:
            found.setdefault(Role.TRAJECTORY, name)
            continue
        for role in FORWARD:
            fits = not misfit(role, one, sorted(joints))
            if fits and sorted(orders.get(name, ())) == sorted(joints):
                found.setdefault(role, name)
    return found


def configuration_of(
    manager: str,
    roles: Mapping[Role, str],
    joints: Sequence[str],
    description: str,
    urdf: str,
) -> dict[str, Any]:
    """Return the values of a configuration file, without controllers that nothing would end (`UNTIMED`).

    Args:
        manager: full name of the controller manager.
        roles: see `roles_in`.
        joints: in the order of a controller.
        description: URDF of the robot; empty if there is none.
        urdf: path by which the configuration names it.

    Raises:
        ConfigError: the description cannot be read.
    """
    values: dict[str, Any] = {"controller_manager": manager}
    timed = {role: name for role, name in roles.items() if role not in UNTIMED}
    values.update((f"{role}_controller", name) for role, name in timed.items())
    if not description:
        return {**values, "joints": [{"name": name} for name in joints]}
    base, tip = ends_of_joints(description, joints)
    chain = parse_urdf(description, base=base, tip=tip)
    if set(chain.names) == set(joints):
        return {**values, "urdf": urdf, "base_link": base, "tip_link": tip}
    return {**values, "joints": _table(joints, chain, description)}


def untimed_in(roles: Mapping[Role, str]) -> dict[str, str]:
    """Return the keys and names of the controllers that `configuration_of` leaves out."""
    return {f"{role}_controller": roles[role] for role in sorted(UNTIMED & roles.keys())}


def text_of(values: Mapping[str, Any], untimed: Mapping[str, str]) -> str:
    """Return the file: the values, and those of controllers without a timeout as comments."""
    told = yaml.safe_dump(dict(values), sort_keys=False)
    if not untimed:
        return told
    has_others = any(key.endswith("_controller") for key in values)
    lines = [
        *(
            []
            if has_others
            else ["As it is, this file is refused at start: it names no controller."]
        ),
        "Left out, since they have no timeout: the joints go on when this driver dies.",
        "With an emergency stop at hand, take away the # of these:",
        "allow_untimed: true",
        *(f"{key}: {name}" for key, name in untimed.items()),
    ]
    return told + "".join(f"# {line}\n" for line in lines)


def _table(joints: Sequence[str], chain: Chain, description: str) -> list[dict[str, Any]]:
    """Return the joints as a table: the way to the tip has others, too, which nobody of ours moves."""
    ranges = {joint.name: joint for joint in chain.joints}
    rates = joint_rates(description, joints)
    rows = []
    for name in joints:
        row: dict[str, Any] = {"name": name}
        if name in ranges and ranges[name].lower > -1e6:
            row.update(lower=ranges[name].lower, upper=ranges[name].upper)
        if name in rates and rates[name].velocity > 0.0:
            row.update(velocity=rates[name].velocity, effort=rates[name].effort)
        rows.append(row)
    return rows


def _joints(one: Controller) -> frozenset[str]:
    return joints_of(one.required or one.claimed)
