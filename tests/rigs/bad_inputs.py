"""The twenty bad inputs, I1 to I20, as a table over a running device of any driver.

    for number, run in BAD_INPUTS.items():
        run(Bench(session, arm, tmp_path))  # the arm ENABLED and at rest, and so it is afterwards

A function of the table sends its inputs to every command that the device offers, and makes sure that each is
refused with its reason, counted and told, and that nothing has changed: no setpoint, no goal, the same state.
It returns how many there were, or raises `NotApplicable` and says why.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_drivers.commands import Command, Direction, Kind, Level, Payload
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, ConfigError, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.motion.move import Outcome
from crtk_drivers.samples import (
    AxisMode,
    CartesianServo,
    JointServo,
    JointState,
    Number,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    joint_state,
    joint_values,
    vector,
)
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.board import Observer
from rigs.waiting import LONG

NOT_FINITE = (math.nan, math.inf, -math.inf)
BREATH = 0.0005
"""Seconds between two inputs, in which the I/O thread has Python's global lock: they are bad, not many."""
_MODES = (AxisMode.POSITION, AxisMode.VELOCITY, AxisMode.EFFORT)
_ZERO = vector(np.zeros(3))
_LEVEL = vector((0.0, 0.0, 0.0, 1.0))


class NotApplicable(Exception):
    """The device has nothing that this input could be sent to."""


@dataclass(frozen=True)
class Bench:
    """A running device: its session, its front, and a folder for files."""

    session: Session
    arm: LocalDevice
    folder: Path

    @property
    def engine(self) -> Engine:
        return self.arm.engine

    @property
    def joints(self) -> tuple[str, ...]:
        return self.engine.capabilities.joints

    def commands(self, *payloads: Payload) -> list[Command]:
        """The motion commands that the device offers; with one of `payloads`, if there are any."""
        found = [
            command
            for command in self.engine.commands.values()
            if command.direction is Direction.COMMANDED
            and command.is_motion
            and (not payloads or command.payload in payloads)
        ]
        if not found:
            raise NotApplicable(f"it offers no motion command of {' or '.join(payloads) or 'any'}")
        return found

    def position(self) -> Vector:
        """Where the joints are set to be."""
        found = self.engine.feedback("setpoint_js")
        assert found is not None
        assert isinstance(found[0], JointState)
        position = found[0].position
        return position if position.size else self.arm.measured_js().position

    def pose(self) -> Pose:
        """Where the tool is set to be."""
        for name in ("setpoint_cp", "measured_cp"):
            found = self.engine.feedback(name) if name in self.engine.commands else None
            if found is not None and isinstance(found[0], Pose) and found[0].position.size:
                return replace(found[0], frame_id="")
        raise NotApplicable("it tells no pose")

    def good(self, command: Command, mode: AxisMode = AxisMode.POSITION) -> Value:
        """Return a value of `command` that asks for nothing to move."""
        size = len(self.joints)
        zeros = vector(np.zeros(size))
        here = self.position() if command.kind is Kind.POSITION else zeros
        match command.payload:
            case Payload.JOINT_STATE:
                return joint_state(command.kind, here)
            case Payload.POSE:
                return Pose(_ZERO, _LEVEL) if command.is_relative else self.pose()
            case Payload.TWIST:
                return Twist(_ZERO, _ZERO)
            case Payload.WRENCH:
                return Wrench(_ZERO, _ZERO)
            case Payload.JOINT_SERVO:
                return JointServo((int(mode),) * size, self.position(), zeros, zeros)
            case Payload.CARTESIAN_SERVO:
                still = Pose(_ZERO, _LEVEL), Twist(_ZERO, _ZERO), Wrench(_ZERO, _ZERO)
                return CartesianServo((int(mode),) * 6, *still, self.pose())
        raise AssertionError(command)

    def refused(
        self,
        command: str,
        value: Value | None,
        *reasons: Reason,
        stamp_ns: int = 0,
        client: Client | None = None,
    ) -> CommandRefused:
        """Send it; it must be refused for one of `reasons`, counted and told."""
        who = {} if client is None else {"client": client}
        return self._expect(
            lambda: self.engine.submit(command, value, stamp_ns, **who), command, reasons, value
        )

    def state_refused(self, text: str, *reasons: Reason, stamp_ns: int = 0) -> CommandRefused:
        """The same for a state command."""
        return self._expect(
            lambda: self.engine.state_command(text, stamp_ns), "state_command", reasons, text
        )

    def _expect(
        self, send: Callable[[], Any], name: str, reasons: tuple[Reason, ...], what: object
    ) -> CommandRefused:
        told = _Told()
        self.engine.add_observer(told)
        try:
            with pytest.raises(CommandRefused) as caught:
                send()
        except pytest.fail.Exception as failure:
            raise AssertionError(f"{name} was not refused: {what}") from failure
        finally:
            self.engine.remove_observer(told)
        time.sleep(BREATH)
        refusal = caught.value
        assert refusal.reason in reasons, f"{refusal}, not {reasons}: {what}"
        assert refusal in told.refusals, f"not told: {refusal}"
        assert self.engine.health().refusals[f"{name}: {refusal.reason}"] > 0
        assert refusal.detail
        assert refusal.where
        assert len(str(refusal)) < 1000, "what was sent is quoted at length"
        return refusal

    def cycles(self, count: int) -> None:
        """Let the I/O thread go round."""
        goal = self.engine.health().cycles + count
        self.until(lambda: self.engine.health().cycles >= goal, f"go on for {count} cycles")

    def until(self, test: Callable[[], object], what: str) -> None:
        deadline = time.monotonic() + LONG
        while not test():
            assert time.monotonic() < deadline, f"it did not {what} in {LONG:g} s"
            time.sleep(0.001)


class _Told(Observer):
    def __init__(self) -> None:
        self.refusals: list[CommandRefused] = []

    def command_refused(self, refusal: CommandRefused) -> None:
        self.refusals.append(refusal)


Run = Callable[[Bench], int]
Case = tuple[Command, Value, tuple[Reason, ...]]


def _nothing_happened(run: Run) -> Run:
    """Make sure that `run` changes nothing."""

    def checked(bench: Bench) -> int:
        engine = bench.engine
        before = _state(engine)
        count = run(bench)
        bench.cycles(3)
        bench.until(lambda: not engine.status.is_busy, "be idle again")
        assert _state(engine) == before
        assert count > 0, "nothing was sent"
        return count

    checked.__doc__ = run.__doc__
    return checked


def _state(engine: Engine) -> tuple[Status, int, list[list[float]]]:
    setpoints = engine.health().setpoints
    goals: list[list[float]] = []
    for name in ("goal_js", "goal_cp"):
        found = engine.latched(name) if name in engine.commands else None
        goals.append([] if found is None else found[0].position.tolist())
    return engine.status, setpoints, goals


def _each(cases: Callable[[Bench], Iterator[Case]]) -> Run:
    def run(bench: Bench) -> int:
        count = 0
        for command, value, reasons in cases(bench):
            bench.refused(command.name, value, *reasons)
            count += 1
        if not count:
            raise NotApplicable("none of its commands can be sent this")
        return count

    run.__doc__ = cases.__doc__
    return _nothing_happened(run)


def _spoiled(values: Vector, number: float) -> Iterator[Vector]:
    for index in range(values.size):
        spoiled = values.copy()
        spoiled[index] = number
        yield vector(spoiled)


def _variants(
    bench: Bench, command: Command, change: Callable[[Vector], Iterator[Vector]]
) -> Iterator[Value]:
    """Return good values of `command`, each with one vector that counts replaced by what `change` makes."""
    if command.payload is Payload.JOINT_STATE:
        good = bench.good(command)
        assert isinstance(good, JointState)
        for values in change(joint_values(command.kind, good)):
            yield joint_state(command.kind, values)
        return
    for mode in _MODES if command.kind is Kind.STATE else _MODES[:1]:
        good = bench.good(command, mode)
        for path in _counted(command, mode):
            yield from _replaced(good, path, change)


def _counted(command: Command, mode: AxisMode) -> tuple[str, ...]:
    match command.payload:
        case Payload.POSE:
            return ("position", "orientation")
        case Payload.TWIST:
            return ("linear", "angular")
        case Payload.WRENCH:
            return ("force", "torque")
        case Payload.JOINT_SERVO:
            return (mode.name.lower(),)
    parts = {
        AxisMode.POSITION: ("pose.position", "pose.orientation"),
        AxisMode.VELOCITY: ("twist.linear", "twist.angular"),
        AxisMode.EFFORT: ("wrench.force", "wrench.torque"),
    }[mode]
    return (*parts, "task.position", "task.orientation")


def _replaced(
    good: Any, path: str, change: Callable[[Vector], Iterator[Vector]]
) -> Iterator[Value]:
    name, _, rest = path.partition(".")
    if rest:
        for inner in _replaced(getattr(good, name), rest, change):
            yield replace(good, **{name: inner})
        return
    for values in change(getattr(good, name)):
        try:
            yield replace(good, **{name: values})
        except ValueError:
            continue  # not even a value: the front refuses it as it converts


def not_finite(bench: Bench) -> Iterator[Case]:
    """NaN or infinite in any element that counts."""
    for command in bench.commands():
        for number in NOT_FINITE:
            for value in _variants(bench, command, partial(_spoiled, number=number)):
                yield command, value, (Reason.NOT_FINITE,)


def wrong_size(bench: Bench) -> Iterator[Case]:
    """One value too few, or too many."""

    def resized(values: Vector) -> Iterator[Vector]:
        if values.size > 1:
            yield vector(values[:-1])
        yield vector((*values, 0.0))

    for command in bench.commands():
        for value in _variants(bench, command, resized):
            yield command, value, (Reason.WRONG_SIZE,)
    for command in bench.engine.commands.values():
        if command.payload is Payload.JOINT_SERVO:
            values = vector(np.zeros(len(bench.joints) + 1))
            yield command, JointServo((1,) * values.size, values), (Reason.WRONG_SIZE,)
        if command.payload is Payload.CARTESIAN_SERVO:
            good = bench.good(command)
            assert isinstance(good, CartesianServo)
            for modes in (good.modes[1:], (*good.modes, 1)):
                yield command, replace(good, modes=modes), (Reason.WRONG_SIZE,)


def empty(bench: Bench) -> Iterator[Case]:
    """No value in the field that the command takes, whatever else is filled."""
    zeros = vector(np.zeros(len(bench.joints)))
    for command in bench.commands(Payload.JOINT_STATE):
        yield command, JointState(), (Reason.EMPTY,)
        other = Kind.EFFORT if command.kind is not Kind.EFFORT else Kind.POSITION
        yield command, joint_state(other, zeros), (Reason.EMPTY,)


def wrong_names(bench: Bench) -> Iterator[Case]:
    """Names that are unknown, given twice, or not all there."""
    names = bench.joints
    for command in bench.commands(Payload.JOINT_STATE):
        good = bench.good(command)
        assert isinstance(good, JointState)
        for name in ("elsewhere", "e" * 100_000, ""):
            yield command, replace(good, name=(name, *names[1:])), (Reason.WRONG_NAMES,)
        if len(names) > 1:
            yield command, replace(good, name=(names[1], *names[1:])), (Reason.WRONG_NAMES,)
            short = joint_state(command.kind, vector(joint_values(command.kind, good)[1:]))
            yield command, replace(short, name=names[1:]), (Reason.WRONG_SIZE,)


def permuted_or_no_names(bench: Bench) -> int:
    """Names in another order, or none: accepted, and put in the declared order."""
    if "move_jp" not in bench.engine.commands:
        raise NotApplicable("it offers no move_jp")
    here, joints = bench.position(), bench.joints
    turned = vector(np.roll(here, 1))
    for value in (
        JointState(position=here),
        JointState(position=turned, name=(joints[-1], *joints[:-1])),
    ):
        move = bench.engine.submit("move_jp", value)
        assert move is not None
        goal = bench.engine.latched("goal_js")
        assert goal is not None
        assert isinstance(goal[0], JointState)
        assert goal[0].position.tolist() == here.tolist()
        move.wait(LONG)
    return 2


def no_quaternion(bench: Bench) -> Iterator[Case]:
    """A quaternion of length zero."""
    yield from _quaternions(bench, 0.0)


def wrong_norm(bench: Bench) -> Iterator[Case]:
    """A quaternion whose length is off by more than 1e-3."""
    for factor in (1.01, 0.99, 1e308, 5e-324):
        yield from _quaternions(bench, factor)


def _quaternions(bench: Bench, factor: float) -> Iterator[Case]:
    reasons = (Reason.BAD_QUATERNION, Reason.OUT_OF_RANGE)  # it may be too large a number besides
    for command in bench.commands(Payload.POSE, Payload.CARTESIAN_SERVO):
        good: Any = bench.good(command)
        if isinstance(good, Pose):
            yield command, _scaled(good, factor), reasons
        else:
            yield command, replace(good, pose=_scaled(good.pose, factor)), reasons
            yield command, replace(good, task=_scaled(good.task, factor)), reasons


def _scaled(pose: Pose, factor: float) -> Pose:
    return replace(pose, orientation=vector([q * factor for q in pose.orientation.tolist()]))


def out_of_range(bench: Bench) -> Iterator[Case]:
    """A goal beyond the range of a joint, a velocity, an effort, a twist or a wrench beyond its limit."""
    capabilities, reasons = bench.engine.capabilities, (Reason.OUT_OF_RANGE,)
    for command in bench.commands(Payload.JOINT_STATE):
        good = bench.good(command)
        assert isinstance(good, JointState)
        values = joint_values(command.kind, good)
        for index, limit in enumerate(capabilities.limits):
            beyond = {
                Kind.POSITION: limit.upper + 0.1 if command.level is Level.MOVE else math.inf,
                Kind.RELATIVE: limit.upper - limit.lower + 0.1,
                Kind.VELOCITY: 1.1 * limit.velocity,
                Kind.EFFORT: 1.1 * limit.effort + 0.1,
            }[command.kind]
            if math.isfinite(beyond):
                changed = values.copy()
                changed[index] = beyond
                yield command, joint_state(command.kind, vector(changed)), reasons
    far = vector((1e308, 1e308, 0.0))
    for command in bench.engine.commands.values():
        if command.direction is not Direction.COMMANDED:
            continue
        if command.payload is Payload.TWIST:
            yield command, Twist(far, _ZERO), reasons
            yield command, Twist(_ZERO, far), reasons
        elif command.payload is Payload.WRENCH:
            yield command, Wrench(far, _ZERO), reasons
        elif command.payload is Payload.POSE:
            yield command, Pose(far, _LEVEL), reasons
            yield command, Pose(vector((1e307, 0.0, 0.0)), _LEVEL), reasons


def jumps(bench: Bench) -> Iterator[Case]:
    """A first servo position that is further away than a step may be."""
    policy = bench.engine.options.limits
    bench.commands(Payload.JOINT_STATE, Payload.POSE)
    position = bench.position()
    for name, relative in (("servo_jp", False), ("servo_jr", True)):
        if name not in bench.engine.commands:
            continue
        for index, limit in enumerate(bench.engine.capabilities.limits):
            up, down = limit.upper - position[index], position[index] - limit.lower
            way = min(0.9 * max(up, down), 1000.0)
            if way <= 1.5 * policy.max_step * limit.velocity:
                continue
            changed = np.zeros(position.size) if relative else position.copy()
            changed[index] += way if up >= down else -way
            value = JointState(position=vector(changed))
            yield bench.engine.commands[name], value, (Reason.STEP_TOO_LARGE,)
    for name in ("servo_cp", "local/servo_cp", "servo_cr", "body/servo_cr", "spatial/servo_cr"):
        if name in bench.engine.commands:
            command = bench.engine.commands[name]
            good = bench.good(command)
            assert isinstance(good, Pose)
            away = vector(good.position + np.array((0.0, 0.0, 50.0)))
            yield command, replace(good, position=away), (Reason.STEP_TOO_LARGE, Reason.UNREACHABLE)


def wrong_frame(bench: Bench) -> Iterator[Case]:
    """A frame_id that is not known here."""
    cartesian = (Payload.POSE, Payload.TWIST, Payload.WRENCH, Payload.CARTESIAN_SERVO)
    for command in bench.commands(*cartesian):
        good: Any = bench.good(command)
        for frame in ("moon", "/", " ", "m" * 100_000):
            yield command, replace(good, frame_id=frame), (Reason.WRONG_FRAME,)


@_nothing_happened
def wrong_age(bench: Bench) -> int:
    """A stamp that is too old, or in the future."""
    oldest = bench.engine.options.limits.max_command_age
    if oldest is None:
        raise NotApplicable("limits.max_command_age is not set")
    count = 0
    for seconds, reason in ((oldest + 60.0, Reason.TOO_OLD), (-60.0, Reason.FROM_FUTURE)):
        stamp_ns = time.time_ns() - int(seconds * 1e9)
        for command in bench.commands() if bench.engine.capabilities.modes else ():
            bench.refused(command.name, bench.good(command), reason, stamp_ns=stamp_ns)
            count += 1
        for text in ("enable", "resume", "home"):
            bench.state_refused(text, reason, stamp_ns=stamp_ns)
            count += 1
    return count


def not_enabled(bench: Bench) -> int:
    """A motion while DISABLED or PAUSED."""
    arm, engine = bench.arm, bench.engine
    commands = bench.commands()
    values = [(command.name, bench.good(command)) for command in commands]
    plain: list[tuple[str, Value | None]] = [*values]
    plain += [(name, None) for name in ("free",) if name in engine.commands]
    for leave, come_back in ((arm.pause, arm.resume), (arm.disable, arm.enable)):
        leave()
        before = _state(engine)
        for name, value in plain:
            bench.refused(name, value, Reason.NOT_ENABLED)
        bench.cycles(3)
        bench.until(lambda: not engine.status.is_busy, "be idle again")
        assert _state(engine) == before
        come_back()
    return 2 * len(plain)


@_nothing_happened
def strange_state_commands(bench: Bench) -> int:
    """A state command that is none, or that the state does not have: what is valid is told."""
    texts = ("Enable", "enable ", " enable", "", "stand up", "ENABLED", "enable\0", "x" * 100_000)
    for text in texts:
        refusal = bench.state_refused(text, Reason.UNKNOWN_COMMAND)
        assert "enable, disable, pause, resume, home, unhome" in refusal.remedy
    refusal = bench.state_refused("resume", Reason.INVALID_TRANSITION)
    assert "pause" in refusal.remedy
    return len(texts) + 1


def flood(bench: Bench) -> int:
    """A stream at many times the rate of the I/O cycle: the newest counts, one setpoint a cycle is sent."""
    names = ("servo_jp", "servo_jr", "servo_jv", "servo_cp")
    name = next((name for name in names if name in bench.engine.commands), "")
    if not name:
        raise NotApplicable("it offers no stream")
    engine, value = bench.engine, bench.good(bench.engine.commands[name])
    before, end, count = engine.health(), time.monotonic() + 0.5, 0
    # Longer where this thread was held up, and cycles were not, until it was a flood.
    while time.monotonic() < end or count < engine.health().setpoints - before.setpoints + 200:
        engine.submit(name, value)
        time.sleep(5e-5)  # 20 kHz, where nothing else takes time
        count += 1
    bench.cycles(3)
    setpoints = engine.health().setpoints - before.setpoints
    # Counted later: the I/O thread goes on while one is read after the other.
    assert setpoints <= engine.health().cycles - before.cycles + 1
    assert engine.status.state is OperatingState.ENABLED
    engine.submit("hold")
    bench.cycles(3)
    return count


def flood_of_moves(bench: Bench) -> int:
    """Many moves at once, and two during home: each comes to an end, and busy falls."""
    engine = bench.engine
    if "move_jp" not in engine.commands:
        raise NotApplicable("it offers no move_jp")
    value = JointState(position=bench.position())
    moves = [engine.submit("move_jp", value) for _ in range(100)]
    for move in moves:
        assert move is not None
        bench.until(lambda m=move: m.outcome is not Outcome.RUNNING, "end a move")
        assert move.outcome in (Outcome.REACHED, Outcome.PREEMPTED)
    assert move.outcome is Outcome.REACHED
    bench.until(lambda: not engine.status.is_busy, "end being busy")
    if engine.capabilities.needs_homing:
        bench.arm.unhome()
        bench.arm.home(timeout=0.0)
        moves = [engine.submit("move_jp", value) for _ in range(2)]
        bench.until(lambda: all(m and not m.is_busy() for m in moves), "end the moves that waited")
        outcomes = [m.outcome for m in moves if m]
        assert outcomes == [Outcome.PREEMPTED, Outcome.REACHED], outcomes
        bench.until(lambda: engine.transition_ended, "end homing")
        bench.until(lambda: not engine.status.is_busy, "end being busy")
    return len(moves)


def two_clients(bench: Bench) -> int:
    """A stream of another client, or of another kind, while one is running."""
    engine, names = bench.engine, ("servo_jp", "servo_jv", "servo_cp", "interpolate_jp")
    offered = [name for name in names if name in engine.commands]
    if not offered:
        raise NotApplicable("it offers no stream")
    value, other = bench.good(engine.commands[offered[0]]), Client("the other")

    def refused(name: str, second: Value, reason: Reason, **who: Any) -> None:
        # Between the two this machine may be busy for longer than a stream lasts.
        for _ in range(20):
            try:
                engine.submit(offered[0], value)
                engine.submit(name, second, **who)
            except CommandRefused as refusal:
                assert refusal.reason is reason  # noqa: PT017 - it is awaited
                return
            engine.submit("hold", client=other)
            bench.cycles(2)
            time.sleep(2.0 * engine.options.interpolate_timeout)
        raise AssertionError(f"{name} was never refused")

    refused(offered[0], value, Reason.STREAM_OWNED, client=other)
    for name in offered[1:]:
        refused(name, bench.good(engine.commands[name]), Reason.MODE_SWITCH)
    engine.submit("hold")
    bench.cycles(3)
    return len(offered)


_CONFIGURATIONS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"stream_timeot": 0.1}, "stream_timeout"),
    ({"stream_timeout": "fast"}, "stream_timeout"),
    ({"stream_timeout": -0.1}, "stream_timeout"),
    ({"stream_timeout": math.nan}, "stream_timeout"),
    ({"sample_timeout": math.inf}, "sample_timeout"),
    ({"limits": {"max_step": math.nan}}, "max_step"),
    ({"limits": {"max_step": -1.0}}, "max_step"),
    ({"limits": {"max_command_age": 0.0}}, "max_command_age"),
    ({"limits": 3}, "limits"),
    ({"on_stream_timeout": "explode"}, "on_stream_timeout"),
    ({"free_timeout": math.nan}, "free_timeout"),
)


def bad_configuration(bench: Bench) -> int:
    """Keys that are unknown, of a wrong type, negative or no number: refused at the start."""
    plugin = bench.session.plugin
    for values, named in _CONFIGURATIONS:
        with pytest.raises(ConfigError, match=named):
            plugin.load_config(None, values)
    return len(_CONFIGURATIONS)


def bad_namespace(bench: Bench) -> int:
    """A namespace that is none."""
    raise NotApplicable("it is the node's, whatever the device: tests/ros/node/test_names.py")


_BOMB = """<?xml version="1.0"?>
<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">
<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>
<robot name="&c;"><link name="base_link"/></robot>
"""


def bad_files(bench: Bench) -> int:
    """A file that is missing, a folder, no XML or a bomb, where one describes the arm."""
    folder, config = bench.folder, bench.session.config
    (folder / "bomb.urdf").write_text(_BOMB)
    (folder / "noise.urdf").write_bytes(bytes(range(256)) * 16)
    (folder / "empty.urdf").write_text("")
    files = ["missing.urdf", ".", "bomb.urdf", "noise.urdf", "empty.urdf"]
    for name in files:
        values = {**config.model_dump(), "kinematics": {"urdf": str(folder / name)}}
        with pytest.raises(ValueError):  # noqa: PT011 - a ConfigError is one
            bench.session.plugin.make(type(config).model_validate(values))
    return len(files)


def bad_requests(bench: Bench) -> int:
    """A ratio that is none; a kinematics query of a wrong size, or not finite."""
    engine, count = bench.engine, 0
    for name, command in engine.commands.items():
        if command.payload is Payload.NUMBER and command.direction is Direction.COMMANDED:
            for number in (0.0, -0.5, 1.0001, 1e308, *NOT_FINITE):
                bench.refused(name, Number(number), Reason.OUT_OF_RANGE)
                count += 1
    size = len(bench.joints)
    wrong = [vector(np.zeros(n)) for n in (size + 1, max(size - 1, 0))]
    broken = [vector(np.full(size, number)) for number in (*NOT_FINITE, 1e308)]
    if "forward_kinematics" in engine.commands:
        for joints in (*wrong, *broken):
            count += _query_refused(engine.forward_kinematics, joints)
    if "inverse_kinematics" in engine.commands:
        here = bench.pose()
        for values in _spoiled(here.position, math.nan):
            pose = replace(here, position=values)
            count += _query_refused(engine.inverse_kinematics, pose)
        for joints in (*[one for one in wrong if one.size], *broken):
            count += _query_refused(engine.inverse_kinematics, here, joints)
        for factor in (0.0, 1.01):
            pose = _scaled(here, factor)
            count += _query_refused(engine.inverse_kinematics, pose)
    if not count:
        raise NotApplicable("it takes no ratio and answers no query")
    return count


def _query_refused(ask: Callable[..., object], *values: object) -> int:
    with pytest.raises(CommandRefused):
        ask(*values)
    return 1


BAD_INPUTS: dict[str, Run] = {
    "I1": _each(not_finite),
    "I2": _each(wrong_size),
    "I3": _each(empty),
    "I4": _each(wrong_names),
    "I5": permuted_or_no_names,
    "I6": _each(no_quaternion),
    "I7": _each(wrong_norm),
    "I8": _each(out_of_range),
    "I9": _each(jumps),
    "I10": _each(wrong_frame),
    "I11": wrong_age,
    "I12": not_enabled,
    "I13": strange_state_commands,
    "I14": flood,
    "I15": flood_of_moves,
    "I16": two_clients,
    "I17": bad_configuration,
    "I18": bad_namespace,
    "I19": bad_files,
    "I20": _nothing_happened(bad_requests),
}
