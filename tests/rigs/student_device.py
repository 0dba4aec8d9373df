"""A CRTK device as somebody might write it in an afternoon, without this package: a gantry of three axes.

It is sound, and each of its faults breaks one clause of `crtk_drivers.client.conformance`. Names, types and
rules are written out here: taken from the package under test, they would prove nothing.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
from builtin_interfaces.msg import Time
from crtk_msgs.msg import OperatingState, StringStamped
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics, TriggerOperatingState
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from rigs.student_gantry import JOINTS, PLACE, RANGE, Gantry, Vector

PERIOD = 0.01
HEARTBEAT = 0.2
GRIPPER_EVERY = 4
"""Cycles."""


class StudentDevice:
    """The gantry on ROS.

    Args:
        node: that it has its topics and services on.
        faults: what is wrong with it.
    """

    def __init__(self, node: Any, *faults: str) -> None:
        self.faults = frozenset(faults)
        self.node = node
        self.frame = f"{node.get_fully_qualified_name().split('/')[1]}/base"
        self.gantry = Gantry(self.faults)
        self._lock = threading.RLock()
        self._increment_ns = 0
        self._was_slow = False
        self._count = 0
        self._publishers: dict[str, Any] = {}
        self._state_ns = 0
        self._told_at = -math.inf
        self._before = 0.0
        self._command_ns = 0
        self._heard_at = -math.inf
        self._set_up_publishers()
        self._set_up_subscriptions()
        self._set_up_services()

    # ---------------------------------------------------------------------------------------- set-up

    def _publish(self, name: str, kind: type, latched: bool = False) -> None:
        best_effort = "best_effort" in self.faults and name == "measured_js"
        self._publishers[name] = self.node.create_publisher(
            kind,
            name,
            QoSProfile(
                depth=10,
                reliability=ReliabilityPolicy.BEST_EFFORT
                if best_effort
                else ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL
                if latched
                else DurabilityPolicy.VOLATILE,
            ),
        )

    def _set_up_publishers(self) -> None:
        for name in ("measured_js", "setpoint_js", "gripper/measured_js"):
            self._publish(name, JointState)
        old = "old_payload" in self.faults
        self._publish("measured_cp", TransformStamped if old else PoseStamped)
        for name in ("measured_cv", "body/measured_cv", "spatial/measured_cv"):
            self._publish(name, TwistStamped)
        self._publish("jacobian", Float64MultiArray)
        if "no_setpoint_cp" not in self.faults:
            self._publish("setpoint_cp", PoseStamped)
        if "no_goal" not in self.faults:
            self._publish("goal_js", JointState, latched=True)
        self._publish("goal_cp", PoseStamped, latched=True)
        self._publish("operating_state", OperatingState, "volatile_state" not in self.faults)
        self._tf = self.node.create_publisher(TFMessage, "/tf", 100)
        if "unknown_name" in self.faults:
            self._publish("measured_jq", JointState)
        if "joints_of_body" in self.faults:
            self._publish("body/measured_js", JointState)
        if "two_publishers" in self.faults:
            self.second = self.node.create_publisher(TwistStamped, "measured_cv", 10)

    def _set_up_subscriptions(self) -> None:
        listen = self._listen
        listen("servo_jp", JointState, lambda m: self.gantry.servo(self._by_name(m)))
        listen("servo_jr", JointState, self._servo_relative)
        listen("servo_jv", JointState, lambda m: self.gantry.servo_velocity(list(m.velocity)))
        listen("move_jp", JointState, lambda m: self._move(m, list(m.position)))
        listen("move_jr", JointState, lambda m: self._move(m, list(m.position), relative=True))
        listen("servo_cp", PoseStamped, self._servo_pose)
        listen("move_cp", PoseStamped, self._move_pose)
        listen("servo_cr", PoseStamped, self._servo_displacement)
        listen("move_cr", PoseStamped, self._move_displacement)
        listen("servo_jf", JointState, lambda m: self.gantry.servo_effort(list(m.effort)))
        listen("trajectory_j/set_ratio", Float64, self._set_ratio)
        listen("gripper/move_jp", JointState, lambda m: self.gantry.open_gripper(list(m.position)))
        listen("hold", Empty, lambda _: self.gantry.stop())
        listen("free", Empty, lambda _: self.gantry.let_go())
        if "dead_topic" in self.faults:
            listen("interpolate_jp", JointState, lambda _: None)
        else:
            listen(
                "interpolate_jp", JointState, lambda m: self.gantry.interpolate(self._by_name(m))
            )
        if "no_state_command" in self.faults:
            return
        if "text_command" in self.faults:
            listen("state_command", String, lambda m: self.gantry.command(m.data))
        else:
            listen("state_command", StringStamped, lambda m: self.gantry.command(m.string))

    def _listen(self, name: str, kind: type, act: Callable[[Any], None]) -> None:
        latched = "latched_command" in self.faults and name == "state_command"

        def receive(message: Any) -> None:
            with self._lock:
                if name.startswith("servo"):
                    stamp = message.header.stamp
                    self._command_ns = stamp.sec * 10**9 + stamp.nanosec
                    self._heard_at = time.monotonic()
                act(message)
                if self.gantry.is_refused and "tells_nothing" not in self.faults:
                    self.node.get_logger().warning(f"{name} is refused")
                self.gantry.is_refused = False
                self._tell_state(time.monotonic(), time.time_ns())

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        depth = 100 if name == "servo_jr" or "queues" in self.faults else 1
        self.node.create_subscription(
            kind, name, receive, QoSProfile(depth=depth, durability=durability)
        )

    def _set_up_services(self) -> None:
        create = self.node.create_service
        create(TriggerOperatingState, "operating_state", self._answer_state)
        if "forward_trigger" in self.faults:
            create(Trigger, "forward_kinematics", lambda _, answer: answer)
        else:
            create(QueryForwardKinematics, "forward_kinematics", self._forward)
        create(QueryInverseKinematics, "inverse_kinematics", self._inverse)

    # ------------------------------------------------------------------------------------ what it takes

    def _servo_relative(self, message: JointState) -> None:
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        since, self._increment_ns = stamp_ns - self._increment_ns, stamp_ns
        if since > 5_000_000 or "drops_increments" not in self.faults:
            self.gantry.servo_relative(list(message.position))

    def _set_ratio(self, message: Float64) -> None:
        if "ignores_ratio" not in self.faults and 0.0 < message.data <= 1.0:
            self.gantry.ratio = message.data

    def _by_name(self, message: JointState) -> Vector:
        values = list(message.position)
        names = list(message.name)
        if names and "by_place" not in self.faults:
            if sorted(names) != sorted(JOINTS) or len(values) != len(names):
                return []
            return [values[names.index(joint)] for joint in JOINTS]
        return values

    def _pose(self, message: PoseStamped) -> Vector:
        p, q = message.pose.position, message.pose.orientation
        if message.header.frame_id not in ("", self.frame) and "any_frame" not in self.faults:
            return []
        norm = math.hypot(q.x, q.y, q.z, q.w)
        if "zero_quaternion" in self.faults and norm == 0.0:
            return [p.x, p.y, p.z]
        if not abs(norm - 1.0) < 1e-3 or math.hypot(q.x, q.y, q.z) > 1e-3:
            return []
        if "turned_frame" in self.faults:
            return [PLACE[0] + p.y - PLACE[1], PLACE[1] + p.x - PLACE[0], p.z]
        return [p.x, p.y, p.z]

    def _servo_pose(self, message: PoseStamped) -> None:
        self.gantry.servo(self._pose(message))

    def _move_pose(self, message: PoseStamped) -> None:
        values = self._pose(message)
        if values and self.gantry.move(values):
            told = _pose(values)
            told.header.stamp, told.header.frame_id = message.header.stamp, self.frame
            self._publishers["goal_cp"].publish(told)

    def _servo_displacement(self, message: PoseStamped) -> None:
        self.gantry.servo_relative(self._pose(message))

    def _move_displacement(self, message: PoseStamped) -> None:
        way = self._pose(message)
        if way and "other_axes" in self.faults:
            way = [way[1], way[0], way[2]]
        self.gantry.move(way, relative=True)

    def _move(self, message: JointState, values: Vector, relative: bool = False) -> None:
        accepted = self.gantry.move(values, relative)
        if (accepted or "any_goal" in self.faults) and "goal_js" in self._publishers:
            goal = self.gantry.goal if accepted else values
            position = [] if goal is None else [float(v) for v in goal]
            told = JointState(name=list(JOINTS), position=position)
            told.header.stamp, told.header.frame_id = message.header.stamp, self.frame
            self._publishers["goal_js"].publish(told)

    def _answer_state(self, _: Any, answer: Any) -> Any:
        with self._lock:
            answer.operating_state = self._state_message(time.time_ns())
            if "service_lies" in self.faults:
                answer.operating_state.state = "PAUSED"
        return answer

    def _forward(self, request: Any, answer: Any) -> Any:
        off = 0.05 if "wrong_forward" in self.faults else 0.0
        if "slow_service" in self.faults and not self._was_slow:
            self._was_slow = True
            time.sleep(1.2)
        p = answer.cp.position
        p.x, p.y, p.z = (off + float(v) for v in request.jp)
        answer.cp.orientation.w = 1.0
        answer.result = True
        return answer

    def _inverse(self, request: Any, answer: Any) -> Any:
        p = request.cp.position
        values = [p.x, p.y, p.z]
        if any(abs(v) > RANGE for v in values) and "endless_inverse" not in self.faults:
            answer.result, answer.message = False, "out of reach"
        else:
            answer.jp, answer.result = values, True
        return answer

    # ------------------------------------------------------------------------------------ what it tells

    def _state_message(self, now_ns: int) -> OperatingState:
        state = self.gantry.state
        message = OperatingState(state=state.title() if "title_case" in self.faults else state)
        message.is_homed = self.gantry.is_homed
        message.is_busy = self.gantry.is_busy or (
            "busy_disabled" in self.faults and state == "DISABLED"
        )
        _stamp(message, now_ns)
        return message

    def _tell_state(self, now: float, now_ns: int) -> None:
        beat = 2.5 if "slow_heartbeat" in self.faults else HEARTBEAT
        due = now - self._told_at >= beat and "no_heartbeat" not in self.faults
        if not (due or self.gantry.changed):
            return
        self.gantry.changed, self._told_at = False, now
        message = self._state_message(now_ns)
        if "constant_stamps" in self.faults:
            self._state_ns = self._state_ns or now_ns
            _stamp(message, self._state_ns)
        self._publishers["operating_state"].publish(message)

    def _tell(self, now: float, now_ns: int) -> None:
        gantry, faults = self.gantry, self.faults
        place, rate = list(gantry.measured), list(gantry.rate)
        if "scale" in faults:
            place = [p + 1.045 * (m - p) for p, m in zip(PLACE, gantry.measured, strict=True)]
        if "fast_velocity" in faults:
            rate = [1.2 * each for each in rate]
        self._tell_state(now, now_ns)
        if "silent_disabled" in faults and gantry.state != "ENABLED" and self._before:
            return
        if "slow_feedback" in faults and now - self._before < 0.2:
            return
        self._before = now
        stamp_ns = now_ns
        if "since_boot" in faults:
            stamp_ns = int(1e9 * now)
        self._count += 1
        if "stamps_go_back" in faults and self._count % 2:
            stamp_ns -= 5 * 10**8
        measured = JointState(
            name=[] if "no_names" in faults else list(JOINTS),
            position=place,
            velocity=rate,
        )
        if "sizes" in faults:
            measured.velocity = [0.0, 0.0]
        if "nan_velocity" in faults:
            measured.velocity = [math.nan, 0.0, 0.0]
        measured.effort = [0.0, 0.0, 0.0] if "zero_effort" in faults else [1.0, 1.0, 2.0]
        self._send("measured_js", measured, stamp_ns, "" if "no_joint_frame" in faults else None)
        if self._count % GRIPPER_EVERY == 0:
            gripper = JointState(name=["jaw"], position=list(gantry.gripper), velocity=[0.0])
            self._send("gripper/measured_js", gripper, stamp_ns)
        apart = 10**6 if "own_stamps" in faults else 0
        self._tell_tool(place, rate, stamp_ns + apart)
        setpoint = JointState(name=list(JOINTS), position=gantry.setpoint)
        if gantry.velocity is not None:
            setpoint = JointState(name=list(JOINTS), velocity=gantry.velocity)
        elif gantry.effort is not None:
            setpoint.effort = gantry.effort
            if "effort_and_place" not in faults:
                setpoint.position = []
        elif gantry.goal is not None and "still_setpoint" not in faults:
            setpoint.velocity = list(gantry.rate)
        streams = now - self._heard_at < 0.1 and self._command_ns and "own_time" not in faults
        self._send("setpoint_js", setpoint, self._command_ns if streams else stamp_ns)
        if "setpoint_cp" in self._publishers:
            pose = _pose(gantry.setpoint)
            invalid = gantry.velocity is not None and "valid_setpoint_cp" not in faults
            self._send("setpoint_cp", pose, 0 if invalid else stamp_ns)

    def _tell_tool(self, position: Vector, rate: Vector, stamp_ns: int) -> None:
        faults = self.faults
        pose = _pose(position)
        if "scaled_quaternion" in faults:
            pose.pose.orientation.w = 1.01
        if "old_payload" not in faults:
            self._send("measured_cp", pose, stamp_ns)
        twist = TwistStamped()
        linear = twist.twist.linear
        linear.x, linear.y, linear.z = rate
        if "angular_first" in faults:
            twist.twist.angular, twist.twist.linear = twist.twist.linear, twist.twist.angular
        self._send("measured_cv", twist, stamp_ns, "" if "no_twist_frame" in faults else None)
        self._send("spatial/measured_cv", twist, stamp_ns)
        if "body_twist" in faults:
            linear.x, linear.y, linear.z = (-2.0 * each for each in rate)
        self._send("body/measured_cv", twist, stamp_ns)
        sign = -1.0 if "wrong_jacobian" in faults else 1.0
        matrix = Float64MultiArray()
        matrix.data = [sign * float(row == column) for row in range(6) for column in range(3)]
        matrix.layout.dim = [_dimension(6), _dimension(3)]
        self._publishers["jacobian"].publish(matrix)
        if "no_tf" not in faults:
            transform = TransformStamped(child_frame_id=f"{self.frame}_tool")
            transform.header.frame_id = self.frame
            _stamp(transform, stamp_ns)
            t = transform.transform.translation
            t.x, t.y, t.z = position
            self._tf.publish(TFMessage(transforms=[transform]))

    def _send(self, name: str, message: Any, stamp_ns: int, frame: str | None = None) -> None:
        _stamp(message, stamp_ns)
        message.header.frame_id = self.frame if frame is None else frame
        self._publishers[name].publish(message)

    def step(self, seconds: float) -> None:
        """Go on for some time, and tell where it is."""
        with self._lock:
            now = time.monotonic()
            self.gantry.step(now, seconds)
            self._tell(now, time.time_ns())


class StudentNode:
    """The gantry on a node of its own, in real time. Use it as a context manager.

    Args:
        namespace: ``/student``.
        faults: what is wrong with it.
    """

    def __init__(self, namespace: str, *faults: str) -> None:
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("gantry", namespace=namespace, context=self._context)
        self.device = StudentDevice(self._node, *faults)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._stop = threading.Event()
        self._threads = [
            threading.Thread(target=self._spin, name="student spin"),
            threading.Thread(target=self._run, name="student run"),
        ]

    def _spin(self) -> None:
        while not self._stop.is_set():
            with suppress(InvalidHandle):
                self._executor.spin_once(timeout_sec=0.05)

    def _run(self) -> None:
        before = time.monotonic()
        while not self._stop.wait(PERIOD):
            now = time.monotonic()
            self.device.step(now - before)
            before = now

    def __enter__(self) -> StudentDevice:
        for thread in self._threads:
            thread.start()
        return self.device

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()


def _stamp(message: Any, nanoseconds: int) -> None:
    seconds, rest = divmod(nanoseconds, 10**9)
    message.header.stamp = Time(sec=seconds, nanosec=rest)


def _pose(position: Vector) -> PoseStamped:
    message = PoseStamped()
    p = message.pose.position
    p.x, p.y, p.z = position
    message.pose.orientation.w = 1.0
    return message


def _dimension(size: int) -> Any:
    from std_msgs.msg import MultiArrayDimension

    return MultiArrayDimension(size=size)
