"""What is typed as the goal of ``crtk-driver move``: values of joints, by order or by name, or a pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from crtk_drivers.cli.state_view import joint_unit
from crtk_drivers.client import RemoteDevice
from crtk_drivers.errors import ConfigError, CrtkError, DataTimeout
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.geometry.quaternions import quaternion_product, unit
from crtk_drivers.samples import JointState, Pose, vector

_FIND_TIME: Final = 0.1
"""Seconds in which a part of the device is found that its manifest does not list."""
_STEPS: Final = {"degrees": 1.0, "Pa": 1000.0}
"""By unit, how far an example goes; 0.01 rad or m otherwise."""


@dataclass(frozen=True)
class Goal:
    """Where to go, by which command, and how far that is from here."""

    command: str
    value: Any
    to_go: Callable[[], str]


def _here(device: RemoteDevice, kind: str) -> Any:
    """Return the setpoint, or what is measured where there is none now."""
    for name in (f"setpoint_{kind}", f"measured_{kind}"):
        if name in device.crtk_commands:
            try:
                return getattr(device, name)()
            except DataTimeout:
                continue
    raise DataTimeout(
        "tells neither setpoint nor what it measures",
        where=device.namespace,
        remedy=f"See: crtk-driver state {device.namespace}",
    )


def joint_goal(device: RemoteDevice, values: Sequence[str], relative: bool, degrees: bool) -> Goal:
    """Return the goal that values of joints stand for.

    Args:
        device: that is to move.
        values: one number for each joint, or ``joint=number``, as typed.
        relative: they are added to the setpoint.
        degrees: they are degrees, and not rad.

    Raises:
        ConfigError: they are no goal of this device; with a command that it takes.
        DataTimeout: the device does not say where it is.
    """
    here: JointState = _here(device, "js")
    if not here.position.size:
        raise ConfigError(
            "reports no joint positions",
            where=device.namespace,
            remedy=f"What it publishes: crtk-driver echo {device.namespace} measured_js",
        )
    # Another maker's names may be missing or empty; its joints are numbered then.
    given = here.name or ("",) * here.position.size
    names = tuple(name or str(index) for index, name in enumerate(given, 1))
    typed = _Typed(device, here, names, relative, degrees)
    chosen = typed.by_name(values) if _names_joints(values, names) else typed.in_order(values)
    goal = np.array(here.position)
    for index, value in chosen.items():
        value = float(np.radians(value)) if degrees else value
        goal[index] = goal[index] + value if relative else value

    def to_go() -> str:
        try:
            left = np.abs(goal - device.measured_js().position)
        except CrtkError:
            return "position unknown"
        farthest = int(np.argmax(left))
        return f"{left[farthest]:.3f} {joint_unit(device, names[farthest])} to go"

    return Goal("move_jp", goal, to_go)


def _names_joints(values: Sequence[str], names: Sequence[str]) -> bool:
    """Return whether values are given by name, or were meant to be."""
    return any("=" in text or (text in names and _number(text) is None) for text in values)


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


@dataclass(frozen=True)
class _Typed:
    """Reads what was typed as values of joints; raises ConfigError with an example that this device takes."""

    device: RemoteDevice
    here: JointState
    names: Sequence[str]
    relative: bool
    degrees: bool

    def in_order(self, values: Sequence[str]) -> dict[int, float]:
        """Return one value for each joint, by its index: names may be repeated."""
        for index, text in enumerate(values):
            if _number(text) is None:
                joint = self.names[index] if len(values) == len(self.names) else ""
                at = f"value {index + 1}{joint and f', of {joint}'}"
                raise self._wrong(f"{text!r} is not a number", at, joint, near=text)
        if len(values) != len(self.names):
            count = f"{len(values)} value{'' if len(values) == 1 else 's'}"
            raise self._wrong(f"{count} for {len(self.names)} joints", "")
        for joint in self.names:
            self._require_angle(joint)
        return dict(enumerate(map(float, values)))

    def by_name(self, values: Sequence[str]) -> dict[int, float]:
        """Return the values of the joints that are named, by index."""
        found: dict[int, float] = {}
        for place, text in enumerate(values, 1):
            name, equals, value = text.partition("=")
            number = _number(value)
            if equals and not name:
                raise self._wrong(f"{text!r} names no joint", f"value {place}")
            if not equals and _number(text) is not None:
                raise self._wrong(f"{text} is for no joint: some joints were named", "")
            if name not in self.names:
                raise self._no_joint(name)
            if self.names.count(name) > 1:
                raise self._wrong(f"{self.names.count(name)} joints have this name", name)
            self._require_angle(name)
            if not equals or not value:
                raise self._wrong("has no value", name, name)
            if number is None:
                raise self._wrong(f"{value!r} is not a number", name, name)
            index = self.names.index(name)
            if index in found:
                raise self._wrong("was given twice", name, name)
            found[index] = number
        return found

    def _no_joint(self, name: str) -> ConfigError:
        if not _is_part(self.device, name):
            return self._wrong("no such joint", name, near=name)
        where = f"{self.device.namespace} {name}"
        with suppress(CrtkError):  # it may not have been found yet
            offered = self.device.child(name).crtk_commands
            if "move_jp" not in offered:
                return ConfigError(
                    "is a part of the device, and takes no joint values",
                    where=where,
                    remedy=f"It offers: {', '.join(offered) or 'nothing'}.",
                )
        return ConfigError(
            "is a part of the device, not one of its joints",
            where=where,
            remedy=f"crtk-driver move {self.device.namespace} --child {name} {name}=...",
        )

    def _wrong(self, what: str, at: str, joint: str = "", near: str = "") -> ConfigError:
        """Return what is wrong, with the joints, and an example for this joint, a near one, or the last."""
        meant = near_names(near, self.names) if near else []
        hint = f"Did you mean {meant[0]}? " if meant else ""
        return ConfigError(
            what,
            where=f"{self.device.namespace} {at}".rstrip(),
            remedy=f"{hint}{self._how(joint or next(iter(meant), ''))}.",
        )

    def _how(self, joint: str) -> str:
        """Return how to give values, with an example for a joint, or for the last that can be named."""
        named = [name for name in self.names if self.names.count(name) == 1 and self._takes(name)]
        ways = []
        if all(map(self._takes, self.names)):
            ways.append(f"one number for each of {', '.join(self.names)}")
        if named:
            example = self.example(joint if joint in named else named[-1])
            ways.append(f"joint=number for some{example and f': {example}'}")
        if ways:
            return f"Give {'; or '.join(ways)}"
        return f"Leave --degrees out{self._without_degrees(joint)}"

    def _takes(self, joint: str) -> bool:
        return not self.degrees or "rad" in joint_unit(self.device, joint)

    def _require_angle(self, joint: str) -> None:
        if self._takes(joint):
            return
        raise ConfigError(
            f"--degrees is for angles, and this joint is in {joint_unit(self.device, joint)}",
            where=f"{self.device.namespace} {joint}",
            remedy=f"Leave --degrees out{self._without_degrees(joint)}.",
        )

    def _without_degrees(self, joint: str) -> str:
        if self.names.count(joint) != 1:
            return ""
        example = replace(self, degrees=False).example(joint)
        return example and f": {example}"

    def example(self, joint: str) -> str:
        """Return the command for a joint that stays where it is, or goes a bit further; empty if unknown.

        It stays within the limits of the joint, also where those of what is typed are rounded.
        """
        place = float(self.here.position[self.names.index(joint)])
        if not math.isfinite(place):
            return ""
        lower, upper = self._limits(joint)
        unit = "degrees" if self.degrees else joint_unit(self.device, joint)
        if self.relative:
            step = _STEPS.get(unit, 0.01)
            if place + self._in_si(step) > upper and place - lower > upper - place:
                step = -step
            value = self._rounded(step, lower - place, upper - place)
        else:
            typed = float(np.degrees(place)) if self.degrees else place
            value = self._rounded(typed, lower, upper)
        options = f"{'--relative ' if self.relative else ''}{'--degrees ' if self.degrees else ''}"
        where = "further" if self.relative else "where it is"
        return (
            f"crtk-driver move {self.device.namespace} {options}{joint}={value} ({unit}, {where})"
        )

    def _limits(self, joint: str) -> tuple[float, float]:
        for each in self.device.manifest.get("joints", ()):
            if each["name"] == joint:
                lower, upper = each.get("lower"), each.get("upper")
                return -math.inf if lower is None else lower, math.inf if upper is None else upper
        return -math.inf, math.inf

    def _in_si(self, value: float) -> float:
        return float(np.radians(value)) if self.degrees else value

    def _rounded(self, value: float, lower: float, upper: float) -> str:
        """Return a value as it is typed, rounded to what lies within limits; these are in rad, m or Pa."""
        if not lower <= self._in_si(value) <= upper:
            value = min(max(self._in_si(value), lower), upper)
            value = float(np.degrees(value)) if self.degrees else value
        scale = 10.0 if self.degrees else 1000.0
        for rounded in (round(value * scale), math.floor(value * scale), math.ceil(value * scale)):
            if lower <= self._in_si(rounded / scale) <= upper:
                return f"{rounded / scale:.12g}"
        return f"{value!r}"  # a range narrower than a step of rounding


def _is_part(device: RemoteDevice, name: str) -> bool:
    if name in device.manifest.get("children", ()):
        return True  # though its topics may not have been found yet
    try:
        device.child(name, timeout=_FIND_TIME)
    except CrtkError:
        return False
    return True


def pose_goal(device: RemoteDevice, values: Sequence[str], relative: bool, degrees: bool) -> Goal:
    """Return the goal that the numbers of a pose stand for.

    Args:
        device: that is to move.
        values: x y z, and a quaternion x y z w if the tool shall turn, as typed.
        relative: they are added to the setpoint.
        degrees: refused.

    Raises:
        ConfigError: they are no goal of this device; with a command that it takes.
        DataTimeout: the device does not say where it is.
    """
    numbers = [_pose_number(device, index, text) for index, text in enumerate(values)]
    if degrees or len(numbers) not in (3, 7):
        what = "--degrees is for joints" if degrees else f"{len(numbers)} numbers are no pose"
        raise ConfigError(
            what,
            where=f"{device.namespace} --pose",
            remedy="Give x y z in m, and a quaternion x y z w if the tool shall turn.",
        )
    here: Pose = _here(device, "cp")
    position, orientation = vector(numbers[:3]), here.orientation
    if len(numbers) == 7:
        orientation = _unit_quaternion(device, numbers[3:])
        if relative:
            orientation = quaternion_product(orientation, here.orientation)
    if relative:
        position = here.position + position
    goal = Pose(position, orientation, here.frame_id)

    def to_go() -> str:
        try:
            left = float(np.linalg.norm(goal.position - device.measured_cp().position))
        except CrtkError:
            return "position unknown"
        return f"{1e3 * left:.0f} mm to go"

    return Goal("move_cp", goal, to_go)


_POSE_PARTS: Final = ("x", "y", "z", "qx", "qy", "qz", "qw")


def _pose_number(device: RemoteDevice, index: int, text: str) -> float:
    value = _number(text)
    if value is None:
        part = f", {_POSE_PARTS[index]}" if index < len(_POSE_PARTS) else ""
        raise ConfigError(
            f"{text!r} is not a number",
            where=f"{device.namespace} --pose value {index + 1}{part}",
            remedy="Give x y z in m, and a quaternion x y z w if the tool shall turn: "
            f"crtk-driver move {device.namespace} --pose --relative 0 0 0.01",
        )
    return value


def _unit_quaternion(device: RemoteDevice, numbers: list[float]) -> Any:
    quaternion = vector(numbers)
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-2:
        raise ConfigError(
            "the last four numbers are no unit quaternion",
            where=f"{device.namespace} --pose",
            remedy="x y z w, and the sum of their squares is 1; 0 0 0 1 does not turn.",
        )
    return unit(quaternion)
