"""A Universal Robots arm as a CRTK device.

Two ways lead to the controller. The state comes over an RTDE connection of our own (`rtde.stream`), read
in the I/O thread. Commands go to a control process that owns the vendor library (`control`): it may hang or
crash without harm to this one, and the controller's watchdog stops the arm when it does.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Generator, Mapping
from typing import Any

from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.control import ControlOptions, ControlSupervisor, Notice
from crtk_driver_ur.control_frames import Event, EventKind, Reply
from crtk_driver_ur.frames import IDENTITY, Transform
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.models import CB3, JOINT_NAMES, RobotModel, model_named
from crtk_driver_ur.motion_sequencer import MotionOptions
from crtk_driver_ur.rtde.stream import RTDE_PORT, RtdeStream, StateSample
from crtk_driver_ur.safety import RobotMode, RuntimeState, SafetyMode, condition_of
from crtk_driver_ur.samples import BASE_FRAME, TOOL_FRAME, SampleMaker, pose_of
from crtk_drivers.device import (
    Capabilities,
    CartesianLimits,
    Condition,
    Device,
    Goal,
    JointLimits,
    Mode,
    MoveProgress,
    Setpoint,
    Steps,
    StopPolicy,
)
from crtk_drivers.errors import (
    CommandRefused,
    ConnectionFailed,
    ConnectionLost,
    DeviceFault,
    Reason,
    TransitionFailed,
)
from crtk_drivers.geometry import rotvec_from_pose
from crtk_drivers.samples import Array, Pose, Sample, Vector, vector
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

HARDWARE_JOINT_ACCELERATION = 40.0
"""rad/s², the most that URScript accepts (URScript manual, movej, speedj)."""

HARDWARE_JOINT_JERK = 1000.0
"""rad/s³; the controller publishes no limit, and its own profiles have none."""

UNLOCK_AFTER = 5.0
"""Seconds that a protective stop must last before the controller unlocks it (Dashboard Server manual)."""

REMOTE_CHECK_PERIOD = 0.5
"""Seconds between two questions whether the teach pendant has control."""

AT_REST = 1e-3
"""rad/s below which a target speed counts as standing still."""

CLOSE_TIMEOUT = 1.0
"""Seconds for the control process to stop the arm and end."""

_MOVE_ENDS = {
    EventKind.MOVE_DONE: MoveProgress.DONE,
    EventKind.INTERRUPTED: MoveProgress.FAILED,
    EventKind.MOTION_FAILED: MoveProgress.FAILED,
    EventKind.PROGRAM_STOPPED: MoveProgress.FAILED,
}

_PROGRAM_STOPPED = Condition(
    OperatingState.PAUSED,
    "the control program was stopped on the controller (teach pendant, or its watchdog). "
    "Look at the teach pendant, then resume.",
)


class UrDevice(Device):
    """One arm.

    Args:
        config: see `UrConfig`.
    """

    def __init__(self, config: UrConfig) -> None:
        self._config = config
        self._model: RobotModel = model_named(config.model)
        self._tool = None if config.tcp is None else Transform.from_pose_vector(config.tcp)
        self._kinematics = ArmKinematics(self._model, self._tool or IDENTITY)
        self._kinematics_tool: tuple[float, ...] | None = None
        self._samples = SampleMaker(self._tool)
        self._frequency = config.frequency or self._model.frequency
        self._control = ControlSupervisor(config.host, _control_options(config, self._model))
        self._stream: RtdeStream | None = None
        self._stream_lost = False
        self._state: StateSample | None = None
        self._replies: dict[int, Reply] = {}
        self._remote: bool | None = None
        self._remote_asked = 0
        self._remote_asked_at = -math.inf
        self._stopped_at = -math.inf
        self._in_control = False
        self._loss = ""
        self._motion = 0
        self._progress = MoveProgress.DONE

    # ------------------------------------------------------------------------------------ description

    @property
    def capabilities(self) -> Capabilities:
        """See the base class."""
        model, servo = self._model, self._config.servo
        limits = tuple(
            JointLimits(
                lower,
                upper,
                velocity,
                HARDWARE_JOINT_ACCELERATION,
                HARDWARE_JOINT_JERK,
                effort,
            )
            for lower, upper, velocity, effort in zip(
                model.position_limits.lower,
                model.position_limits.upper,
                model.velocity_limits,
                model.torque_limits,
                strict=True,
            )
        )
        timeout = 1.0 / self._config.watchdog_frequency
        return Capabilities(
            joints=JOINT_NAMES,
            limits=limits,
            cartesian_limits=CartesianLimits(
                servo.max_linear_velocity,
                servo.max_angular_velocity,
                servo.linear_acceleration,
                servo.joint_acceleration,
            ),
            modes=frozenset({Mode.JOINT_POSITION, Mode.JOINT_VELOCITY, Mode.CARTESIAN_VELOCITY}),
            measured=("measured_js", "measured_cp", "measured_cv", "measured_cf"),
            native_moves=frozenset({"move_jp", "move_cp"}),
            has_kinematics=True,
            has_free=True,
            rate=self._frequency,
            paced_by_stream=True,
            base_frame=BASE_FRAME,
            tool_frame=TOOL_FRAME,
            transition_timeout=60.0,
            stop=StopPolicy(
                timeout,
                f"holds its position; the controller stops the arm {timeout:g} s after this "
                "process or the link died",
            ),
        )

    @property
    def address(self) -> str:
        """See the base class."""
        return f"{self._config.host or '(no host)'}:{RTDE_PORT}"

    @property
    def condition(self) -> Condition:
        """See the base class."""
        state = self._state
        if state is None:
            return Condition()
        found = condition_of(
            state.robot_mode,
            state.safety_mode,
            state.runtime_state,
            state.robot_status_bits,
            self._remote,
        )
        if found.allows is not OperatingState.ENABLED or not self._in_control:
            return found
        if self._loss:
            return Condition(OperatingState.FAULT, self._loss)
        if state.runtime_state in (RuntimeState.STOPPING, RuntimeState.STOPPED):
            return _PROGRAM_STOPPED
        return found

    @property
    def counters(self) -> Mapping[str, float]:
        """Of the RTDE stream (packages) and of the control process."""
        status, state = self._control.status, self._state
        counters = {
            "control process starts": float(status.starts),
            "control process silent for (s)": status.silent_for if status.alive else math.nan,
            "longest library call (s)": status.heartbeat.longest_call,
        }
        if self._stream is not None:
            stream = self._stream.counters
            counters["packages lost"] = float(stream.lost)
            counters["packages skipped"] = float(stream.skipped)
            counters["packages malformed"] = float(stream.malformed)
        if state is not None:
            counters["robot mode"] = float(state.robot_mode)
            counters["safety mode"] = float(state.safety_mode)
            counters["speed scaling"] = state.speed_scaling
        return counters

    # ------------------------------------------------------------------------------------- connection

    def open(self, deadline: float) -> None:
        """See the base class."""
        stream = RtdeStream(self._config.host, frequency=self._config.frequency)
        stream.open(deadline)
        try:
            self._check_generation(stream)
            if self._control.status.alive:
                self._control.replace()
            else:
                self._control.start()
        except BaseException:
            stream.close()
            raise
        self._stream, self._stream_lost = stream, False
        self._state, self._remote, self._in_control, self._loss = None, None, False, ""
        self._remote_asked = 0
        self._replies.clear()

    def _check_generation(self, stream: RtdeStream) -> None:
        cb3_controller = stream.controller_version.major < 5
        if cb3_controller is not (self._model.generation is CB3):
            kind = "a CB3" if cb3_controller else "an e-Series"
            raise ConnectionFailed(
                f"PolyScope {stream.controller_version} is {kind} controller, "
                f"but model is {self._model.name}",
                where=f"ur {self.address}",
                remedy="Set `model` to the arm that is connected.",
            )

    def close(self) -> None:
        """See the base class."""
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()
        if self._stream_lost:
            # Waiting for a library that lost its controller too would keep the caller.
            self._control.kill()
        self._control.close(CLOSE_TIMEOUT)
        self._in_control = False

    def read(self, deadline: float) -> Sample | None:
        """See the base class."""
        if self._stream is None:
            raise ConnectionLost("not open", where=f"ur {self.address}")
        for notice in self._control.poll():
            self._take(notice)
        self._watch_control()
        try:
            state = self._stream.receive(deadline)
        except ConnectionLost:
            self._stream_lost = True
            raise
        if state is None:
            return None
        before, self._state = self._state, state
        if state.safety_mode == SafetyMode.PROTECTIVE_STOP and (
            before is None or before.safety_mode != SafetyMode.PROTECTIVE_STOP
        ):
            self._stopped_at = state.received
        self._follow_tool(state)
        return self._samples.make(state)

    def _follow_tool(self, state: StateSample) -> None:
        """Compute with the controller's tool where the configuration names none."""
        if self._tool is None and state.tcp_offset not in (None, self._kinematics_tool):
            assert state.tcp_offset is not None
            self._kinematics_tool = state.tcp_offset
            tool = Transform.from_pose_vector(state.tcp_offset)
            self._kinematics = ArmKinematics(self._model, tool)

    # -------------------------------------------------------------------------------- control process

    def _take(self, notice: Notice) -> None:
        if isinstance(notice, Reply):
            if notice.sequence == self._remote_asked:
                self._remote_asked = 0
                self._remote = None if notice.error is not None else bool(notice.value)
            else:
                self._replies[notice.sequence] = notice
            return
        self._take_event(notice)

    def _take_event(self, event: Event) -> None:
        error = event.error
        if event.sequence == self._motion and event.kind in _MOVE_ENDS:
            self._progress = _MOVE_ENDS[event.kind]
        if event.kind in (EventKind.PROCESS_DIED, EventKind.CONNECTION_LOST):
            self._loss = f"{error.text}. {error.hint}"
        elif event.kind is EventKind.PROGRAM_STOPPED:
            self._progress = MoveProgress.FAILED
            self._remote_asked_at = -math.inf
        elif event.kind in (EventKind.MOTION_FAILED, EventKind.BAD_FRAME):
            logger.warning("ur %s: %s: %s %s", self.address, error.call, error.text, error.hint)

    def _watch_control(self) -> None:
        """Replace a control process that died or hangs, and keep asking who has control."""
        status = self._control.status
        if not status.responsive:
            if status.alive:
                self._loss = (
                    f"the control process has been silent for {status.silent_for:.2f} s"
                    + (f" in {status.call}" if status.call else "")
                    + "; it is replaced"
                )
            logger.error("ur %s: %s", self.address, self._loss or "the control process ended")
            self._control.replace()
            self._remote_asked = 0
            return
        now = time.monotonic()
        due = now - self._remote_asked_at > REMOTE_CHECK_PERIOD
        if due and not self._remote_asked and self._model.generation is not CB3:
            self._remote_asked_at = now
            self._remote_asked = self._control.request("is_in_remote_control")

    def _send(self, command: Callable[..., int], *arguments: Any) -> int:
        try:
            return command(*arguments)
        except ConnectionLost as error:
            raise DeviceFault(
                error.message, where=f"ur {self.address}", remedy="Send enable to start again."
            ) from error

    # ----------------------------------------------------------------------------------------- motion

    def write(self, setpoint: Setpoint) -> None:
        """See the base class."""
        servo, valid_for = self._config.servo, self._config.stream_timeout
        values = setpoint.values.tolist()
        if setpoint.mode is Mode.JOINT_POSITION:
            self._send(self._control.send_servo_joint, values)
        elif setpoint.mode is Mode.JOINT_VELOCITY:
            self._send(self._control.send_speed_joint, values, servo.joint_acceleration, valid_for)
        else:
            self._send(
                self._control.send_speed_cartesian, values, servo.linear_acceleration, valid_for
            )

    def stop(self) -> None:
        """See the base class."""
        try:
            self._control.stop()
        except ConnectionLost as error:
            logger.warning("%s; the controller's watchdog stops the arm", error)

    def move(self, goal: Goal) -> None:
        """See the base class."""
        move = self._config.move
        self._progress = MoveProgress.RUNNING
        if goal.joints is not None:
            self._motion = self._send(
                self._control.move_joint,
                goal.joints.tolist(),
                move.joint_velocity * goal.ratio,
                move.joint_acceleration * goal.ratio,
            )
            return
        assert goal.pose is not None
        self._motion = self._send(
            self._control.move_linear,
            rotvec_from_pose(goal.pose).tolist(),
            move.linear_velocity * goal.ratio,
            move.linear_acceleration * goal.ratio,
        )

    def move_progress(self) -> MoveProgress:
        """See the base class."""
        return self._progress

    def free(self) -> Steps:
        """See the base class."""
        self._send(self._control.freedrive)
        yield

    # ------------------------------------------------------------------------------------- transitions

    def enable(self) -> Steps:
        """Unlock a protective stop, power on, release the brakes, start the control program."""
        yield from self._until(lambda: self._state is not None)
        yield from self._require_remote("enable")
        yield from self._unlock()
        self._require_safe()
        yield from self._power_up()
        yield from self._start_program()

    def resume(self) -> Steps:
        """Take control again; the setpoint starts from where the arm is now."""
        yield from self._require_remote("resume")
        self._require_safe()
        yield from self._start_program()

    def pause(self) -> Steps:
        """Stop and keep the control program and the power."""
        self.stop()
        yield from self._until(self._standing)
        self._in_control = False

    def disable(self) -> Steps:
        """Stop, end the control program, and switch the power off (if configured)."""
        self._in_control = False
        if self._control.status.heartbeat.connected:
            self.stop()
            yield from self._until(self._standing)
            yield from self._ask("stop_script")
        if self._config.power_off_on_disable and self._mode() > RobotMode.POWER_OFF:
            yield from self._ask("power_off")
            yield from self._until(lambda: self._mode() <= RobotMode.POWER_OFF)

    def _unlock(self) -> Steps:
        if self._safety() != SafetyMode.PROTECTIVE_STOP:
            return
        yield from self._until(lambda: time.monotonic() > self._stopped_at + UNLOCK_AFTER)
        yield from self._ask("close_safety_popup")
        yield from self._ask("unlock_protective_stop")
        yield from self._until(lambda: self._safety() != SafetyMode.PROTECTIVE_STOP)

    def _power_up(self) -> Steps:
        if self._mode() < RobotMode.IDLE:
            yield from self._ask("power_on")
            yield from self._until(lambda: self._mode() >= RobotMode.IDLE, safe=True)
        if self._mode() != RobotMode.RUNNING:
            yield from self._ask("brake_release")
            yield from self._until(lambda: self._mode() == RobotMode.RUNNING, safe=True)

    def _start_program(self) -> Steps:
        beat = self._control.status.heartbeat
        playing = self._state is not None and self._state.runtime_state == RuntimeState.PLAYING
        if not beat.connected:
            yield from self._answer("connect", self._send(self._control.connect))
        elif not (beat.program_running and playing):
            yield from self._answer("upload_script", self._send(self._control.upload_script))
        yield from self._configure()
        yield from self._until(
            lambda: self._state is not None and self._state.runtime_state == RuntimeState.PLAYING,
            safe=True,
        )
        self._loss = ""
        self._in_control = True

    def _configure(self) -> Steps:
        config = self._config
        if config.payload is not None:
            center = list(config.payload.center_of_gravity)
            yield from self._ask("set_payload", mass=config.payload.mass, center_of_gravity=center)
        if config.tcp is not None:
            yield from self._ask("set_tcp", pose=list(config.tcp))
        if config.gravity is not None:
            yield from self._ask("set_gravity", direction=list(config.gravity))

    def _require_remote(self, command: str) -> Steps:
        if self._model.generation is CB3:
            return
        reply = yield from self._ask("is_in_remote_control")
        self._remote = bool(reply)
        if not self._remote:
            raise CommandRefused(
                "state_command",
                Reason.LOCAL_CONTROL,
                f"{command}: the teach pendant has control",
                where=f"ur {self.address}",
                remedy="Switch it to remote control (top right corner), then send it again.",
            )

    def _require_safe(self) -> None:
        found = self.condition
        if found.allows is OperatingState.FAULT:
            raise DeviceFault(found.reason, where=f"ur {self.address}")

    def _ask(self, name: str, **arguments: Any) -> Generator[None, None, Any]:
        """Send a slow request and return the value of its answer."""
        sequence = self._send(lambda: self._control.request(name, **arguments))
        return (yield from self._answer(name, sequence))

    def _answer(self, name: str, sequence: int) -> Generator[None, None, Any]:
        """Wait for the answer to a request and return its value."""
        starts = self._control.status.starts
        while sequence not in self._replies:
            if self._control.status.starts != starts:
                raise TransitionFailed(
                    f"{name}: {self._loss or 'the control process was replaced'}",
                    where=f"ur {self.address}",
                    remedy="Send it again.",
                )
            yield
        reply = self._replies.pop(sequence)
        if reply.error is not None:
            raise TransitionFailed(
                f"{reply.error.call}: {reply.error.text}",
                where=f"ur {self.address}",
                remedy=reply.error.hint,
            )
        return reply.value

    def _until(self, test: Callable[[], bool], *, safe: bool = False) -> Steps:
        """Wait for `test`; with `safe`, give up when the safety system stops the arm meanwhile."""
        while not test():
            if safe:
                self._require_safe()
            yield

    def _standing(self) -> bool:
        return self._state is None or max(map(abs, self._state.target_qd)) < AT_REST

    def _mode(self) -> int:
        return RobotMode.NO_CONTROLLER if self._state is None else self._state.robot_mode

    def _safety(self) -> int:
        return SafetyMode.UNDEFINED if self._state is None else self._state.safety_mode

    # -------------------------------------------------------------------------------------- kinematics

    def forward_kinematics(self, joints: Vector) -> Pose:
        """See the base class."""
        return pose_of(self._kinematics.forward(joints.tolist()))

    def inverse_kinematics(self, pose: Pose, reference: Vector) -> Vector:
        """See the base class."""
        target = Transform.from_quaternion(pose.position.tolist(), pose.orientation.tolist())
        return vector(self._kinematics.inverse(target, reference.tolist()))

    def jacobian(self, joints: Vector) -> Array:
        """See the base class."""
        return self._kinematics.jacobian(joints.tolist())


def _control_options(config: UrConfig, model: RobotModel) -> ControlOptions:
    return ControlOptions(
        watchdog_frequency=config.watchdog_frequency,
        upper_range_registers=config.upper_range_registers,
        motion=MotionOptions(
            period=1.0 / model.frequency,
            lookahead=config.servo.lookahead,
            gain=config.servo.gain,
            joint_deceleration=config.servo.joint_acceleration,
            linear_deceleration=config.servo.linear_acceleration,
        ),
    )
