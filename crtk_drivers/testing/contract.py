"""What every device must do, as tests over a running one: subclass `DeviceContract` and give it a session.

    class TestMyDevice(DeviceContract):
        @pytest.fixture
        def session(self):
            return open_session("my_device", MyConfig(), sim=True)

and in ``conftest.py``, so that a failure shows the values:

    pytest.register_assert_rewrite("crtk_drivers.testing.contract")

The tests use what the device offers and skip the rest. They move it: by `reach` of the range of each
joint, from where it is. Run them against a simulator; against hardware only when it has room.
"""

# ruff: noqa: D102 - the name of a test says what it demands

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from crtk_drivers.commands import find
from crtk_drivers.device import Capabilities
from crtk_drivers.errors import CommandRefused, MotionAborted, Reason
from crtk_drivers.front import LocalDevice
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.samples import (
    VALUE_TYPES,
    JointState,
    Matrix,
    Pose,
    Poses,
    Stamp,
    Twist,
    Value,
    Vector,
    Wrench,
    vector,
)
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState
from crtk_drivers.status.health import Health


class DeviceContract:
    """Subclass it with a name that begins with ``Test`` and override the fixture `session`.

    Attributes:
        tolerance: rad (m) within which a position counts as reached.
        still: rad (m) within which a device counts as not having moved.
        reach: the share of a joint's range that a test moves through.
        timeout: seconds that any single wait may take.
        child: name of the device behind that of the session which is tested; that of the session if empty.
        sim: the simulator, where it was started by the test and not by the session.
    """

    tolerance = 5e-3
    still = 2e-3
    reach = 0.03
    timeout = 10.0
    child = ""
    sim: Any = None

    # --------------------------------------------------------------------- what a subclass provides

    @pytest.fixture
    def session(self) -> Session:
        """Return a session that is not started, its simulator (if any) running. Override it."""
        raise NotImplementedError("override the fixture `session`")

    def prepare(self, session: Session) -> None:
        """Let a connected device measure, where it takes more: a tracker is enabled for its tools."""

    def break_link(self, session: Session) -> None:
        """Make the device unreachable. Override it together with `mend_link`."""
        pytest.skip("break_link and mend_link are not overridden")

    def mend_link(self, session: Session) -> None:
        """Make the device reachable again."""

    def silence(self, session: Session) -> None:
        """Let the device send nothing, its line as before. Override it where another fault does that."""
        self.inject(session, "silence")

    def damage(self, session: Session) -> None:
        """Damage one in ten of the device's records. Override it where another fault does that."""
        self.inject(session, "corrupt", every=10, direction="out")

    # --------------------------------------------------------------------------------- what they use

    def inject(self, session: Session, kind: str, **parameters: Any) -> None:
        """Let a fault of the simulator begin, and skip the test where there is none such."""
        sim = session.sim or self.sim
        if sim is None:
            pytest.skip("there is no simulator: `session.sim` and `self.sim` are None")
        try:
            sim.control.inject(kind, **parameters)
        except RuntimeError as error:
            pytest.skip(f"its simulator refuses the fault: {error}")

    @pytest.fixture
    def arm(self, session: Session) -> Iterator[LocalDevice]:
        """The device, connected, DISABLED, at rest; closed afterwards, with no thread left."""
        before = set(threading.enumerate())
        arm = LocalDevice(session, self.child)
        try:
            session.start()
            self.until(lambda: all(engine.has_sample for engine in session.engines), "connect")
            self.prepare(session)
            yield arm
        finally:
            arm.close()
        left = set(threading.enumerate()) - before
        assert not left, f"close left threads running: {left}"

    @pytest.fixture
    def enabled(self, arm: LocalDevice) -> LocalDevice:
        """The device, ENABLED, and homed if it needs that."""
        arm.enable()
        if arm.engine.capabilities.needs_homing:
            arm.home()
        return arm

    def until(self, test: Callable[[], Any], what: str) -> Any:
        """Wait until `test` holds and return what it is, and fail if it does not in time."""
        deadline = time.monotonic() + self.timeout
        while not (found := test()):
            assert time.monotonic() < deadline, f"it did not {what} in {self.timeout:g} s"
            time.sleep(0.001)
        return found

    def wait_samples(self, arm: LocalDevice, count: int) -> None:
        """Wait for `count` new samples."""
        goal = arm.health().samples + count
        self.until(lambda: arm.health().samples >= goal, f"bring {count} samples")

    def need(self, arm: LocalDevice, *names: str) -> None:
        """Skip the test unless the device offers all of `names`."""
        missing = [name for name in names if name not in arm.crtk_commands]
        if missing:
            pytest.skip(f"the device does not offer {', '.join(missing)}")

    def measured_by(self, arm: LocalDevice) -> str:
        """Return the first of what the device measures, and skip the test if that is nothing."""
        if not arm.engine.capabilities.measured:
            pytest.skip("the device measures nothing itself")
        return arm.engine.capabilities.measured[0]

    def step_of(self, capabilities: Capabilities) -> Vector:
        """Return by how much each joint moves in a test: `reach` of its range, bounded to 0.1."""
        spans = [limit.upper - limit.lower for limit in capabilities.limits]
        return vector([min(self.reach * span, 0.1) for span in spans])

    def goal_from(self, arm: LocalDevice) -> Vector:
        """Return a joint position near the present one, towards the middle of the range."""
        capabilities = arm.engine.capabilities
        here = arm.setpoint_js().position
        middle = np.array(
            [0.5 * (max(x.lower, -9.0) + min(x.upper, 9.0)) for x in capabilities.limits]
        )
        return vector(here + np.where(middle >= here, 1.0, -1.0) * self.step_of(capabilities))

    def rest(self, arm: LocalDevice) -> Vector:
        """Wait until the joints rest and return where."""
        last: list[Vector] = [arm.measured_js().position]

        def resting() -> bool:
            self.wait_samples(arm, 5)
            before, last[0] = last[0], arm.measured_js().position
            return bool(np.abs(last[0] - before).max() < 0.1 * self.still)

        self.until(resting, "come to rest")
        return last[0]

    def stream(self, arm: LocalDevice, name: str, values: list[Any]) -> None:
        """Send `values` one after the other, each when the one before has been executed.

        One that waits for the hardware for longer than a stream may be silent is dropped, and sent again.
        """
        for value in values:
            before = arm.health()
            getattr(arm, name)(value)
            dropped = [before.stream_timeouts]

            def is_executed(
                value: Any = value, before: Health = before, dropped: list[int] = dropped
            ) -> bool:
                now = arm.health()
                if now.setpoints > before.setpoints:
                    return True
                if now.stream_timeouts > dropped[0]:
                    dropped[0] = now.stream_timeouts
                    getattr(arm, name)(value)
                return False

            self.until(is_executed, "execute a setpoint")

    def path_to(self, arm: LocalDevice, goal: Vector) -> list[Vector]:
        """Return positions to `goal` at a fifth of the velocity limits."""
        capabilities = arm.engine.capabilities
        here = arm.setpoint_js().position
        slowest = max(
            abs(d) / (0.2 * limit.velocity)
            for d, limit in zip(goal - here, capabilities.limits, strict=True)
        )
        count = max(2, math.ceil(slowest * capabilities.rate))
        return [vector(here + (goal - here) * (i + 1) / count) for i in range(count)]

    def is_aborted(self, arm: LocalDevice, end: Callable[[], None]) -> bool:
        """Begin a move and `end` it; whether it was: it is there before where a test is held up."""
        move = arm.move_jp(self.goal_from(arm))
        end()
        try:
            assert move.wait(self.timeout), "it neither ended nor arrived"
        except MotionAborted:
            return True
        return False

    def assert_at(self, arm: LocalDevice, goal: Vector) -> None:
        """Wait until the joints have reached `goal`."""

        def near() -> bool:
            return bool(np.abs(arm.measured_js().position - goal).max() < self.tolerance)

        try:
            self.until(near, "")
        except AssertionError:
            where = arm.measured_js(age=0).position
            raise AssertionError(f"it is at {where}, not at {goal}") from None

    # --------------------------------------------------------------------------------- capabilities

    def test_capabilities_are_constant_and_commands_follow_from_them(
        self, session: Session
    ) -> None:
        engine = session.children[self.child] if self.child else session.engine
        assert engine.device.capabilities == engine.device.capabilities
        assert engine.device.address
        assert {"operating_state", "state_command"} <= set(engine.commands)
        assert set(engine.capabilities.measured) <= set(engine.commands)
        session.close()

    def test_closing_without_opening_and_twice_does_no_harm(self, session: Session) -> None:
        session.engine.device.close()
        session.close()
        session.close()

    # ---------------------------------------------------------------------------- connect and enable

    def test_closing_is_no_fault(self, enabled: LocalDevice) -> None:
        enabled.close()
        status = enabled.engine.status
        assert status.state is not OperatingState.FAULT, status.detail

    def test_connecting_enables_nothing_and_moves_nothing(self, arm: LocalDevice) -> None:
        assert arm.operating_state().state is OperatingState.DISABLED
        if "measured_js" in arm.crtk_commands:
            before = arm.measured_js().position
            self.wait_samples(arm, 20)
            assert np.abs(arm.measured_js().position - before).max() < self.still
        assert arm.operating_state().state is OperatingState.DISABLED
        assert arm.health().setpoints == 0

    def test_enabling_moves_nothing_and_takes_the_measured_position(self, arm: LocalDevice) -> None:
        self.need(arm, "setpoint_js", "measured_js")
        before = arm.measured_js().position
        arm.enable()
        self.wait_samples(arm, 20)
        assert np.abs(arm.measured_js().position - before).max() < self.still
        assert np.abs(arm.setpoint_js().position - before).max() < self.still
        assert arm.health().setpoints == 0

    def test_disable_and_enable_again(self, enabled: LocalDevice) -> None:
        enabled.disable()
        assert enabled.operating_state().state is OperatingState.DISABLED
        assert not enabled.engine.device.obstacles, "`enable` raises these, or they are none"
        enabled.enable()
        enabled.enable()
        enabled.disable()
        enabled.disable()

    def test_pause_and_resume(self, enabled: LocalDevice) -> None:
        enabled.pause()
        assert enabled.operating_state().state is OperatingState.PAUSED
        self.need(enabled, "measured_js")
        before = enabled.measured_js().position
        enabled.resume()
        self.wait_samples(enabled, 10)
        assert np.abs(enabled.measured_js().position - before).max() < self.still

    # -------------------------------------------------------------------------------------- samples

    def test_samples_hold_what_was_declared_and_nothing_that_is_not_finite(
        self, arm: LocalDevice
    ) -> None:
        sample = self._sample(arm)
        for name in arm.engine.capabilities.measured:
            assert name in sample, f"{name} is declared and not in the sample"
            value = sample[name]
            assert isinstance(value, VALUE_TYPES[find(name).payload])
            for part in _parts(value):
                assert np.isfinite(part).all(), f"{name} holds {part}"

    def test_a_joint_state_has_a_value_for_each_joint_or_none(self, arm: LocalDevice) -> None:
        self.need(arm, "measured_js")
        state = arm.measured_js()
        joints = arm.engine.capabilities.joints
        assert state.name in ((), joints)
        assert state.position.size == len(joints)
        assert {state.velocity.size, state.effort.size} <= {0, len(joints)}

    def test_stamps_are_of_now_and_increase(self, arm: LocalDevice) -> None:
        name = self.measured_by(arm)
        stamps: list[Stamp] = []

        def is_enough() -> bool:
            self.wait_samples(arm, 1)
            found = arm.engine.feedback(name)
            assert found is not None
            assert abs(time.monotonic() - found[1].monotonic) < 5.0
            if found[1].wall_ns:  # on a busy machine a sample may be stale when it is looked at
                stamps.append(found[1])
            return len(stamps) == 10

        self.until(is_enough, "bring samples that are of now")
        assert abs(time.time() - stamps[-1].wall_ns / 1e9) < 5.0
        wall = [stamp.wall_ns for stamp in stamps]
        assert wall == sorted(wall)
        assert wall[-1] > wall[0]

    def test_what_is_derived_from_one_sample_has_its_stamp(self, arm: LocalDevice) -> None:
        self.measured_by(arm)
        engine = arm.engine

        def one_stamp() -> bool:
            found = [engine.feedback(name) for name in engine.capabilities.measured]
            return len({value[1].wall_ns for value in found if value is not None}) == 1

        self.until(one_stamp, "give its feedback one stamp")

    def test_frames_are_the_declared_ones(self, arm: LocalDevice) -> None:
        sample, capabilities = self._sample(arm), arm.engine.capabilities
        known = {"", capabilities.base_frame, capabilities.tool_frame}
        for name in ("measured_cp", "measured_cv", "measured_cf"):
            value = sample.get(name)
            if isinstance(value, Pose | Twist | Wrench):
                assert value.frame_id in known, f"{name} is in {value.frame_id!r}"

    def test_readings_return_the_class_of_their_payload(self, arm: LocalDevice) -> None:
        for reading in arm.engine.readings.values():
            reading.tell()  # raises WrongReading, which names the class

    def test_counters_are_numbers(self, arm: LocalDevice) -> None:
        for name, value in arm.health().device.items():
            assert isinstance(value, int | float), f"{name} is {value!r}"

    # --------------------------------------------------------------------------------------- motion

    def test_servo_jp_is_followed_and_reported(self, enabled: LocalDevice) -> None:
        self.need(enabled, "servo_jp")
        goal = self.goal_from(enabled)
        self.stream(enabled, "servo_jp", self.path_to(enabled, goal))
        assert enabled.setpoint_js().position == pytest.approx(goal)
        assert enabled.setpoint_js().velocity.size == 0
        self.assert_at(enabled, goal)

    def test_servo_jr_adds_up(self, enabled: LocalDevice) -> None:
        self.need(enabled, "servo_jr")
        reached = enabled.setpoint_js().position
        path = self.path_to(enabled, self.goal_from(enabled))
        for increment in np.diff(np.vstack([reached, *path]), axis=0):
            streams = enabled.health().stream_timeouts
            self.stream(enabled, "servo_jr", [increment])
            goal = reached + increment

            def is_there(goal: Vector = goal, streams: int = streams) -> bool:
                # On a busy machine a stream may end, and the next begins where the arm is.
                has_ended = enabled.health().stream_timeouts != streams
                return has_ended or bool(np.abs(enabled.setpoint_js().position - goal).max() < 1e-6)

            self.until(is_there, f"add up to {goal}")
            reached = enabled.setpoint_js().position
        self.assert_at(enabled, reached)

    def test_servo_jv_moves_and_ends_with_its_stream(self, enabled: LocalDevice) -> None:
        self.need(enabled, "servo_jv")
        start = enabled.measured_js().position
        capabilities = enabled.engine.capabilities
        away = np.sign(self.goal_from(enabled) - start)
        velocity = away * [min(0.1 * x.velocity, 0.1) for x in capabilities.limits]
        samples = max(10, int(0.3 * capabilities.rate))
        self.stream(enabled, "servo_jv", [velocity] * samples)

        def is_told() -> bool:
            enabled.servo_jv(velocity)  # a stream ends where a test is held up
            told = enabled.setpoint_js()
            return told.position.size == 0 and bool(told.velocity == pytest.approx(velocity))

        self.until(is_told, "tell the velocity as its setpoint")
        self.until(lambda: enabled.health().stream_timeouts >= 1, "end the stream")
        end = self.rest(enabled)
        assert ((end - start) * away > 0.0).all(), f"from {start} it went to {end}"
        assert not enabled.setpoint_js().velocity.any()

    def test_a_second_client_is_refused_while_a_stream_runs(self, enabled: LocalDevice) -> None:
        self.need(enabled, "servo_jp")
        first, second, engine = Client("the first"), Client("the second"), enabled.engine
        here = JointState(position=enabled.setpoint_js().position)

        def refusal() -> CommandRefused | None:
            # Where a test is held up between the two, the first one's stream has ended.
            try:
                engine.submit("servo_jp", here, client=first)
                engine.submit("servo_jp", here, client=second)
            except CommandRefused as refused:
                return refused if "the first" in str(refused) else None
            return None

        refused = self.until(refusal, "refuse the second client")
        assert refused.reason is Reason.STREAM_OWNED

    def test_servo_cp_is_followed(self, enabled: LocalDevice) -> None:
        self.need(enabled, "servo_cp", "forward_kinematics", "measured_cp")
        path = self.path_to(enabled, self.goal_from(enabled))
        self.stream(enabled, "servo_cp", [enabled.forward_kinematics(q) for q in path])
        goal = enabled.forward_kinematics(path[-1])

        def is_there() -> bool:
            enabled.servo_cp(goal)  # a stream may end before the tool has arrived
            told = enabled.setpoint_cp(), enabled.measured_cp()
            return all(_apart(pose, goal) < self.tolerance for pose in told)

        self.until(is_there, "reach the pose")

    def test_move_jp_reaches_its_goal_with_a_pulse_of_busy(self, enabled: LocalDevice) -> None:
        self.need(enabled, "move_jp")
        goal = self.goal_from(enabled)
        enabled.home(timeout=0.0)  # it is: there is nothing to wait for
        assert enabled.engine.transition_ended
        move = enabled.move_jp(goal)
        assert move.wait(self.timeout)
        assert enabled.wait_for_busy(False, self.timeout)
        assert enabled.goal_js().position == pytest.approx(goal)
        self.assert_at(enabled, goal)

    def test_move_cp_reaches_its_goal(self, enabled: LocalDevice) -> None:
        self.need(enabled, "move_cp", "forward_kinematics", "measured_cp")
        goal = enabled.forward_kinematics(self.goal_from(enabled))
        assert enabled.move_cp(goal).wait(self.timeout)
        self.until(lambda: _apart(enabled.measured_cp(), goal) < self.tolerance, "reach the pose")

    def test_hold_ends_a_move(self, enabled: LocalDevice) -> None:
        self.need(enabled, "move_jp", "hold")
        self.until(lambda: self.is_aborted(enabled, enabled.hold), "end a move")
        self.rest(enabled)
        assert enabled.wait_for_busy(False, self.timeout)
        assert enabled.is_enabled()

    def test_disable_ends_a_move(self, enabled: LocalDevice) -> None:
        self.need(enabled, "move_jp")

        def is_aborted() -> bool:
            enabled.enable()
            return self.is_aborted(enabled, enabled.disable)

        self.until(is_aborted, "end a move")
        self.rest(enabled)

    def test_enabling_again_starts_from_where_it_is(self, enabled: LocalDevice) -> None:
        self.need(enabled, "move_jp")
        enabled.move_jp(self.goal_from(enabled)).wait(self.timeout)
        enabled.disable()
        here = self.rest(enabled)
        enabled.enable()
        assert np.abs(enabled.setpoint_js().position - here).max() < self.still
        self.wait_samples(enabled, 20)
        assert np.abs(enabled.measured_js().position - here).max() < self.still

    def test_free_and_back(self, enabled: LocalDevice) -> None:
        self.need(enabled, "free", "hold")
        enabled.free()
        self.wait_samples(enabled, 10)
        enabled.hold()
        self.wait_samples(enabled, 10)
        assert enabled.is_enabled()

    def test_stop_may_come_from_any_thread(self, enabled: LocalDevice) -> None:
        self.need(enabled, "hold")
        for _ in range(20):
            enabled.engine.device.stop()
        self.wait_samples(enabled, 10)

    # ------------------------------------------------------------------------------------- refusals

    def test_bad_commands_are_refused_and_leave_the_device_where_it_is(
        self, enabled: LocalDevice
    ) -> None:
        self.need(enabled, "servo_jp", "move_jp")
        count = len(enabled.engine.capabilities.joints)
        here = self.rest(enabled)
        far = [limit.upper + 1.0 for limit in enabled.engine.capabilities.limits]
        for value in ([math.nan] * count, [0.0] * (count + 1), [], "text"):
            for name in ("servo_jp", "move_jp"):
                with pytest.raises(CommandRefused) as caught:
                    getattr(enabled, name)(value)
                assert caught.value.remedy
        with pytest.raises(CommandRefused):
            enabled.move_jp(far)
        self.wait_samples(enabled, 20)
        assert enabled.health().setpoints == 0
        assert np.abs(enabled.measured_js().position - here).max() < self.still
        assert enabled.is_enabled()
        assert not enabled.is_busy()

    def test_motion_is_refused_while_disabled(self, arm: LocalDevice) -> None:
        self.need(arm, "move_jp")
        here = arm.measured_js().position
        with pytest.raises(CommandRefused, match="DISABLED"):
            arm.move_jp(here)
        assert arm.health().setpoints == 0

    # ----------------------------------------------------------------------------------- kinematics

    def test_kinematics_agree_with_each_other_and_with_the_measurement(
        self, arm: LocalDevice
    ) -> None:
        self.need(arm, "forward_kinematics", "inverse_kinematics", "measured_js")
        here, step = arm.measured_js().position, self.step_of(arm.engine.capabilities)
        sample = self._sample(arm)
        measured, joints = sample.get("measured_cp"), sample["measured_js"]
        assert isinstance(joints, JointState)
        if isinstance(measured, Pose):
            pose = arm.forward_kinematics(joints.position)
            assert _apart(pose, measured) < self.tolerance
        random = np.random.default_rng(1)
        for _ in range(20):
            near = vector(here + step * random.uniform(-1.0, 1.0, here.size))
            pose = arm.forward_kinematics(near)
            assert np.linalg.norm(pose.orientation) == pytest.approx(1.0, abs=1e-6)
            solution = arm.inverse_kinematics(pose, near)
            assert _apart(arm.forward_kinematics(solution), pose) < 1e-4
            assert np.abs(solution - near).max() < 1e-3, "not the solution nearest to the reference"

    def test_the_jacobian_is_the_derivative_of_the_pose(self, arm: LocalDevice) -> None:
        self.need(arm, "jacobian", "forward_kinematics")
        step = self.step_of(arm.engine.capabilities)
        joints = vector(arm.measured_js().position + 0.3 * step)
        kinematics = arm.engine.device.kinematics
        assert kinematics is not None
        jacobian = kinematics.jacobian(joints)
        assert jacobian.shape == (6, joints.size)
        h = 1e-6
        for index in range(joints.size):
            offset = np.zeros(joints.size)
            offset[index] = h
            high = arm.forward_kinematics(joints + offset)
            low = arm.forward_kinematics(joints - offset)
            linear = (high.position - low.position) / (2.0 * h)
            assert jacobian[:3, index] == pytest.approx(linear, abs=1e-4)

    # ------------------------------------------------------------------------------------- the link

    def test_a_lost_link_is_a_fault_and_its_return_moves_and_enables_nothing(
        self, enabled: LocalDevice, session: Session
    ) -> None:
        self.break_link(session)
        self.until(lambda: enabled.operating_state().state is OperatingState.FAULT, "go to FAULT")
        assert enabled.operating_state().detail
        for name in enabled.engine.capabilities.measured:
            found = enabled.engine.feedback(name)
            assert found is not None
            assert found[1].wall_ns == 0, "stale data has a stamp"
        setpoints = enabled.health().setpoints
        self.mend_link(session)
        engine = enabled.engine
        self.until(lambda: engine.connected and engine.has_sample, "connect again")
        self.wait_samples(enabled, 20)
        assert enabled.operating_state().state is OperatingState.DISABLED
        assert enabled.health().setpoints == setpoints
        self.prepare(session)
        enabled.enable()

    def test_a_damaged_record_costs_no_connection(self, arm: LocalDevice, session: Session) -> None:
        before = arm.health().reconnects
        self.damage(session)
        self.wait_samples(arm, 30)
        assert arm.health().reconnects == before, arm.operating_state().detail
        assert arm.operating_state().state is OperatingState.DISABLED

    def test_closing_while_it_connects_in_vain_ends_in_time(
        self, arm: LocalDevice, session: Session, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        device, opens = session.engine.device, threading.Event()
        really_open = device.open

        def noted_open(deadline: float) -> None:
            opens.set()
            really_open(deadline)

        monkeypatch.setattr(device, "open", noted_open)
        self.silence(session)
        self.until(opens.is_set, "connect again")
        arm.close()  # raises what did not end

    @staticmethod
    def _sample(arm: LocalDevice) -> dict[str, Value]:
        """Return everything of one sample."""
        names = arm.engine.capabilities.measured
        while True:
            found = {name: arm.engine.feedback(name) for name in names}
            values = {name: pair for name, pair in found.items() if pair is not None}
            if len({stamp.monotonic for _, stamp in values.values()}) <= 1:
                return {name: value for name, (value, _) in values.items()}


def _parts(value: Value) -> list[Any]:
    if isinstance(value, JointState):
        return [value.position, value.velocity, value.effort]
    if isinstance(value, Pose):
        return [value.position, value.orientation]
    if isinstance(value, Poses):
        return [value.vector]
    if isinstance(value, Matrix):
        return [value.values]
    assert isinstance(value, Twist | Wrench)
    return [value.vector]


def _apart(a: Pose, b: Pose) -> float:
    """Return the larger of the distance in m and the angle in rad between two poses."""
    turn = 2.0 * math.acos(min(1.0, abs(float(np.dot(a.orientation, b.orientation)))))
    return max(float(np.linalg.norm(a.position - b.position)), turn)
