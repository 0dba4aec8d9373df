"""``crtk-driver move``: take a running device to joint positions or a pose, and hold it at Ctrl-C."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from crtk_drivers.cli.reaching import Interrupted, held_when_interrupted, need
from crtk_drivers.cli.state_view import NEXT, joint_unit, joint_units, print_position
from crtk_drivers.cli.terminal import ERR, OUT, plain
from crtk_drivers.client import RemoteDevice
from crtk_drivers.client.move_handle import START_TIMEOUT
from crtk_drivers.errors import (
    CommandRefused,
    ConfigError,
    CrtkError,
    DataTimeout,
    MotionAborted,
    Reason,
)
from crtk_drivers.errors.near_names import near_names
from crtk_drivers.geometry.quaternions import quaternion_product, unit
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import JointState, Pose, vector
from crtk_drivers.state import OperatingState

LOOK_PERIOD = 0.1
POLL = 0.01
_RATIOS = "trajectory_j"
_STEPS = {"degrees": 1.0, "Pa": 1000.0}
"""By unit, how far an example goes; 0.01 rad or m otherwise."""


@dataclass(frozen=True)
class Goal:
    """Where to go, by which command, and how far that is from here."""

    command: str
    value: Any
    to_go: Callable[[], str]


def move(
    device: RemoteDevice,
    values: Sequence[str],
    *,
    pose: bool,
    relative: bool,
    degrees: bool,
    speed: float | None = None,
) -> int:
    """Move, show the progress on a terminal, print where it ended, and return 0.

    Args:
        device: to move.
        values: numbers, or ``joint=number``.
        pose: they are x y z, and a quaternion x y z w if the tool shall turn.
        relative: they are added to the setpoint.
        degrees: joint values are degrees.
        speed: share of the limits of velocity and acceleration for this move; None: as the device has it.

    Raises:
        CommandRefused: the device is not enabled, or does not accept this.
        ConfigError: the values are no goal for this device.
        MotionAborted, ConnectionLost: it ended elsewhere.
        typer.Exit: after an interrupt; the device holds.
    """
    if speed is not None and not 0.0 < speed <= 1.0:
        raise ConfigError(
            f"{speed:g} is no share of its speed",
            where=f"{device.namespace} --speed",
            remedy="Give a number above 0, up to 1: 0.1 is a tenth.",
        )
    need(device, "move_cp" if pose else "move_jp")
    _require_enabled(device)
    goal = (_pose_goal if pose else _joint_goal)(device, values, relative, degrees)
    try:
        _go(device, goal, speed)
    except CommandRefused as refusal:
        if refusal.reason is not Reason.OUT_OF_RANGE or pose or degrees:
            raise
        units = joint_units(device)
        degrees_too = "; --degrees takes degrees" if "rad" in units else ""
        raise CommandRefused(
            refusal.command,
            refusal.reason,
            refusal.detail,
            where=refusal.where,
            remedy=f"{refusal.remedy} Values are in {' or '.join(units)}{degrees_too}.",
        ) from refusal
    print_position(device)
    return 0


@contextmanager
def _at_speed(
    device: RemoteDevice, speed: float | None, heed: Callable[[], None]
) -> Iterator[Callable[[], bool]]:
    """Set the share of the device's limits for moves within the block, and put the old shares back after it.

    The share and the goal go over two topics, and the goal may come first. So the block begins once the
    device has reported the share. Another client may set the share, too: it is put back only if it is ours.

    Signals must raise `Interrupted` within, as in `held_when_interrupted`.

    Args:
        device: that moves.
        speed: the share; None: leave it as it is.
        heed: raises `Interrupted` if a signal came and its exception was lost.

    Yields:
        A function that returns whether the device still has our share.

    Raises:
        ConfigError: the device knows no such share.
        DataTimeout: it does not report that it has taken the share.
    """
    if speed is None:
        yield lambda: True
        return
    for each in ("set_ratio", "set_ratio_v", "set_ratio_a", "ratio_v", "ratio_a"):
        need(device, f"{_RATIOS}/{each}")
    ratios = device.trajectory_j
    before, ours = (ratios.ratio_v(), ratios.ratio_a()), (speed, speed)

    def is_ours() -> bool:
        return (ratios.ratio_v(), ratios.ratio_a()) == ours

    def restore() -> None:
        ratios.set_ratio(before[0])
        if before[1] != before[0]:
            ratios.set_ratio_a(before[1])

    @contextmanager
    def reported() -> Iterator[None]:
        """Print an error: the interrupt goes on, and what follows it."""
        try:
            yield
        except CrtkError as error:
            ERR.print(
                f"[yellow]warning:[/] {plain(device.namespace)}: the share of its speed was not put back "
                f"to {before[0]:g}: {plain(error.statement)}",
                soft_wrap=True,
            )

    def put_back() -> None:
        is_due = True
        try:
            is_due = is_ours()  # else another client has set it since, and it is that one's
            if is_due:
                restore()
        except Interrupted:  # halfway, perhaps; no signal comes after this one
            if is_due:
                with reported():
                    restore()
            raise

    try:
        ratios.set_ratio(speed)
        deadline = time.monotonic() + START_TIMEOUT
        while not is_ours():
            heed()
            if time.monotonic() > deadline:
                raise DataTimeout(
                    f"did not report within {START_TIMEOUT:g} s that moves take {speed:g} of its speed",
                    where=device.namespace,
                    remedy="Nothing was moved. Does another client set it, too?",
                )
            time.sleep(POLL)
        yield is_ours
    except Interrupted:
        device.hold()  # before anything else
        with reported():
            put_back()
        raise
    except BaseException:
        with suppress(CrtkError):  # what went wrong first is told
            put_back()
        raise
    put_back()


def _go(device: RemoteDevice, goal: Goal, speed: float | None) -> None:
    # Within: of a terminal that is gone the end of what is shown fails, and the hold comes before that.
    with (
        ERR.status(f"{goal.command} ...") as shown,
        held_when_interrupted(device) as heed,
        _at_speed(device, speed, heed) as is_at_speed,
    ):
        began = time.monotonic()
        heed()  # a signal may have been lost in rclpy while the share was set
        handle: Move = getattr(device, goal.command)(goal.value)
        is_seen = False
        while not handle.wait(LOOK_PERIOD if is_seen else POLL):
            heed()
            if not is_seen and handle.wait(0.0, is_busy=True):
                is_seen = True
                if not is_at_speed():
                    device.hold()
                    raise MotionAborted(
                        "another client has changed the share of the speed meanwhile",
                        where=device.namespace,
                        remedy="It was told to hold. Move it by one client at a time.",
                    )
            passed = time.monotonic() - began
            if passed > START_TIMEOUT and not handle.wait(0.0, is_busy=True):
                device.hold()  # else what comes late after all moves it, and nobody looks
                raise MotionAborted(
                    f"{goal.command} was sent {passed:.0f} s ago, and the device was never busy",
                    where=device.namespace,
                    remedy="It was told to hold. Is it ENABLED, and does it accept this command?",
                )
            shown.update(f"{goal.command}  {passed:.1f} s  {plain(goal.to_go())}")
    OUT.print(f"[green]reached[/] in {time.monotonic() - began:.1f} s")


def _require_enabled(device: RemoteDevice) -> None:
    status = device.operating_state()
    if status.state is not OperatingState.ENABLED:
        raise CommandRefused(
            "move",
            Reason.NOT_ENABLED,
            f"the device is {status.state}",
            where=device.namespace,
            remedy=f"Why: crtk-driver state {device.namespace}. Then: "
            f"{NEXT[status.state].format(device.namespace)}",
        )


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


def _joint_goal(device: RemoteDevice, values: Sequence[str], relative: bool, degrees: bool) -> Goal:
    here: JointState = _here(device, "js")
    if not here.position.size:
        raise ConfigError(
            "reports no joint positions",
            where=device.namespace,
            remedy=f"Is that its driver's setup? See: crtk-driver echo {device.namespace} measured_js",
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
        device.child(name, timeout=LOOK_PERIOD)
    except CrtkError:
        return False
    return True


def _pose_goal(device: RemoteDevice, values: Sequence[str], relative: bool, degrees: bool) -> Goal:
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
