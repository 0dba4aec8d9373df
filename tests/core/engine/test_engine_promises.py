"""Random sequences of commands, losses and faults against the promises of the engine.

1. Nothing reaches the hardware unless ENABLED, validated and limited.
3. Nothing moves because of connect, enable, reconnect or restart.
4. Stale data is never stamped fresh.
"""

import math

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from crtk_drivers.commands import COMMANDS
from crtk_drivers.device import Condition, Mode, Setpoint
from crtk_drivers.errors import CommandRefused, ConnectionLost, DeviceFault, StopUnconfirmed
from crtk_drivers.motion.move import Move
from crtk_drivers.samples import Twist, vector
from crtk_drivers.state import OperatingState, StateCommand
from rigs.examples import examples
from rigs.scripted_engine import LIMIT, PERIOD, Rig, jf, jp, jv, pose, two_joints

number = st.floats(-1.5, 1.5) | st.sampled_from([math.nan, math.inf, 0.0, 0.01, -0.01])
small = st.floats(-0.05, 0.05)


SMOOTH = frozenset({name for name in COMMANDS if name.startswith("interpolate_")} | {"servo_cv"})


class Promises(RuleBasedStateMachine):
    capabilities = two_joints()

    def __init__(self) -> None:
        super().__init__()
        self.rig = Rig(capabilities=self.capabilities)
        self.moves: list[Move] = []
        self.commanded = False
        self.smooth = ""
        device = self.rig.device
        record = device.write

        def write(setpoint: Setpoint) -> None:
            self.judge(setpoint)
            record(setpoint)

        device.write = write  # type: ignore[method-assign]

    def judge(self, setpoint: Setpoint) -> None:
        assert self.rig.state is OperatingState.ENABLED
        assert self.rig.engine.connected
        assert self.commanded, "written without a command since the device was enabled"
        values = setpoint.values
        assert np.isfinite(values).all()
        self.judge_smooth(setpoint)
        if setpoint.mode is Mode.JOINT_POSITION:
            assert np.abs(values).max() <= 1.0 + 1e-12
            assert np.abs(values - self.rig.device.position).max() <= 0.1 + 1e-9
        elif setpoint.mode is Mode.JOINT_VELOCITY:
            assert np.abs(values).max() <= 1.0
        else:
            assert np.abs(values).max() <= 5.0

    def judge_smooth(self, setpoint: Setpoint) -> None:
        """A motion that the core makes itself does not step: at most two cycles' worth."""
        going_on = self.rig.engine.health().stream
        is_move = any(not _ended(move) for move in self.moves) and not going_on
        if setpoint.mode is Mode.JOINT_POSITION and (is_move or going_on in SMOOTH):
            step = np.abs(setpoint.values - self.rig.device.position).max()
            assert step <= 2.0 * PERIOD * LIMIT.velocity * 1.01 + 1e-9
        if self.smooth == going_on != "":
            change = np.abs(setpoint.values - self.rig.written[-1].values).max()
            most = {
                "interpolate_jv": LIMIT.acceleration,
                "interpolate_jf": LIMIT.effort / 0.1,
                "interpolate_cv": 5.0,
            }
            assert change <= 2.0 * PERIOD * most.get(going_on, math.inf) + 1e-9
        self.smooth = going_on if self.rig.state is OperatingState.ENABLED else ""

    def submit(self, name: str, value: object) -> None:
        try:
            move = self.rig.engine.submit(name, value)  # type: ignore[arg-type]
        except CommandRefused:
            return
        self.commanded = True
        if move is not None:
            self.moves.append(move)

    @rule(a=number, b=number, name=st.sampled_from(["servo_jp", "servo_jr", "move_jp", "move_jr"]))
    def any_position(self, a: float, b: float, name: str) -> None:
        self.submit(name, jp(a, b))

    @rule(a=small, b=small)
    def near_position(self, a: float, b: float) -> None:
        place = self.rig.device.position
        self.submit("servo_jp", jp(place[0] + a, place[1] + b))

    @rule(a=small, b=small)
    def near_pose(self, a: float, b: float) -> None:
        self.submit("servo_cr", pose(a, b))

    @rule(a=number, b=number)
    def velocity(self, a: float, b: float) -> None:
        self.submit("servo_jv", jv(a, b))

    @rule(a=number, b=number)
    def effort(self, a: float, b: float) -> None:
        self.submit("servo_jf", jf(a, b))

    @rule(
        a=st.floats(-1.5, 1.5), name=st.sampled_from(["servo_cp", "move_cp", "servo_cr", "move_cr"])
    )
    def cartesian(self, a: float, name: str) -> None:
        self.submit(name, pose(a))

    @rule(a=number, b=number, name=st.sampled_from(["interpolate_jp", "interpolate_jr"]))
    def slow_position(self, a: float, b: float, name: str) -> None:
        self.submit(name, jp(a, b))

    @rule(a=number, b=number)
    def slow_velocity(self, a: float, b: float) -> None:
        self.submit("interpolate_jv", jv(a, b))

    @rule(a=number, b=number)
    def slow_effort(self, a: float, b: float) -> None:
        self.submit("interpolate_jf", jf(a, b))

    @rule(a=number, b=number, name=st.sampled_from(["interpolate_cp", "interpolate_cr"]))
    def slow_pose(self, a: float, b: float, name: str) -> None:
        if math.isfinite(a + b):
            self.submit(name, pose(a, b))

    @rule(a=number, name=st.sampled_from(["servo_cv", "interpolate_cv"]))
    def twist(self, a: float, name: str) -> None:
        self.submit(name, Twist(vector((a, 0, 0)), vector((0, 0, a))))

    @rule(name=st.sampled_from(["hold", "free"]))
    def plain(self, name: str) -> None:
        self.submit(name, None)

    @rule(command=st.sampled_from([*StateCommand, StateCommand.ENABLE, StateCommand.ENABLE]))
    def state_command(self, command: StateCommand) -> None:
        before = self.rig.state
        try:
            self.rig.engine.state_command(command)
        except CommandRefused:
            assert self.rig.state is before

    @rule(count=st.integers(1, 30))
    def cycle(self, count: int) -> None:
        for _ in range(count):
            before = self.rig.state
            if self.rig.engine.connected:
                try:
                    self.rig.cycle()
                except ConnectionLost as error:
                    self.rig.disconnect(str(error))
            if self.rig.state is OperatingState.ENABLED is not before:
                self.commanded = False

    @rule()
    def late_cycle(self) -> None:
        if self.rig.engine.connected and not self.rig.device.silent:
            writes = len(self.rig.written)
            self.rig.cycle(period=20 * PERIOD)
            assert len(self.rig.written) <= writes + 1

    @rule(moved=st.booleans())
    def lose_the_link(self, moved: bool) -> None:
        if self.rig.engine.connected:
            self.rig.disconnect("cable pulled")
            assert self.rig.state is OperatingState.FAULT
            if moved:
                self.rig.device.position = np.array([0.5, -0.5])

    @precondition(lambda self: not self.rig.engine.connected)
    @rule()
    def reconnect(self) -> None:
        writes = len(self.rig.written)
        self.rig.engine.connect(self.rig.clock() + 1.0)
        assert self.rig.state is OperatingState.DISABLED
        assert len(self.rig.written) == writes

    @rule(silent=st.booleans())
    def fall_silent(self, silent: bool) -> None:
        self.rig.device.silent = silent

    @rule(state=st.sampled_from([OperatingState.ENABLED, *OperatingState]))
    def condition(self, state: OperatingState) -> None:
        self.rig.device.reported = Condition(state, f"says {state}")

    @rule(broken=st.booleans())
    def break_writing(self, broken: bool) -> None:
        if broken:
            self.rig.device.fail["write"] = DeviceFault("overload")
        else:
            self.rig.device.fail.pop("write", None)

    @rule()
    def alarm(self) -> None:
        self.rig.engine.alarm("stuck")
        assert self.rig.state is OperatingState.FAULT

    @invariant()
    def moves_end(self) -> None:
        running = [move for move in self.moves if not _ended(move)]
        assert len(running) <= 1
        idle = self.rig.engine.transition_ended
        if self.rig.state is not OperatingState.ENABLED and idle:
            assert not running
            assert not self.rig.engine.status.is_busy
        if running:
            assert self.rig.engine.status.is_busy

    @invariant()
    def stale_data_is_never_fresh(self) -> None:
        for name in ("measured_js", "measured_cp", "setpoint_js", "setpoint_cp"):
            found = self.rig.engine.feedback(name)
            if found is not None and found[1].wall_ns:
                assert self.rig.clock() - found[1].monotonic <= 0.05 + 1e-9
                assert self.rig.engine.connected

    @invariant()
    def stamps_increase(self) -> None:
        stamps = [stamp.wall_ns for _, stamp in self.rig.told.statuses]
        assert stamps == sorted(set(stamps))

    def teardown(self) -> None:
        try:
            self.rig.engine.shut_down()
        except StopUnconfirmed:
            assert self.rig.device.silent, "it was seen to stand"
        assert all(_ended(move) for move in self.moves)
        assert self.rig.device.calls[-1] == "close"


def _ended(move: Move) -> bool:
    return move.outcome != "running"


class PositionsOnly(Promises):
    """Twists are carried out by joints, which takes positions."""

    capabilities = two_joints(modes=frozenset({Mode.JOINT_POSITION}))


class VelocitiesOnly(Promises):
    """Twists are carried out by joints, which takes velocities."""

    capabilities = two_joints(modes=frozenset({Mode.JOINT_VELOCITY}))


TestPromises = Promises.TestCase
TestPromises.settings = settings(max_examples=examples(60), stateful_step_count=40, deadline=None)

TestPositionsOnly = PositionsOnly.TestCase
TestPositionsOnly.settings = settings(
    max_examples=examples(30), stateful_step_count=40, deadline=None
)
TestVelocitiesOnly = VelocitiesOnly.TestCase
TestVelocitiesOnly.settings = settings(
    max_examples=examples(30), stateful_step_count=40, deadline=None
)
