"""A thin CRTK client for the tests, by the rules of the official one.

It subscribes reliable, volatile, depth 10; sends state_command latched; takes an operating state only if
it is strictly newer than the last; waits for busy to be True and then False.

Names and types are written out here: taken from the package under test, they would prove nothing.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection
from contextlib import suppress
from typing import Any, Self

import rclpy
from crtk_msgs.msg import CartesianServo, JointServo, OperatingState, StringStamped
from crtk_msgs.srv import QueryForwardKinematics, QueryInverseKinematics, TriggerOperatingState
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TwistStamped, WrenchStamped
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.experimental import EventsExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty, Float64, Float64MultiArray, String
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from rigs.waiting import LONG

PUBLISHED = {
    "measured_js": JointState,
    "measured_cp": PoseStamped,
    "measured_cv": TwistStamped,
    "measured_cf": WrenchStamped,
    "local/measured_cp": PoseStamped,
    "setpoint_js": JointState,
    "setpoint_cp": PoseStamped,
    "setpoint_cv": TwistStamped,
    "setpoint_cf": WrenchStamped,
    "body/measured_cv": TwistStamped,
    "spatial/measured_cf": WrenchStamped,
    "body/jacobian": Float64MultiArray,
    "trajectory_j/ratio": Float64,
    "trajectory_j/ratio_v": Float64,
    "trajectory_j/ratio_a": Float64,
    "goal_js": JointState,
    "goal_cp": PoseStamped,
    "jacobian": Float64MultiArray,
    "operating_state": OperatingState,
    "refusals": String,
}
COMMANDED = {
    "servo_jp": JointState,
    "servo_jr": JointState,
    "servo_jv": JointState,
    "servo_jf": JointState,
    "servo_cp": PoseStamped,
    "servo_cv": TwistStamped,
    "servo_cr": PoseStamped,
    "servo_cf": WrenchStamped,
    "servo_js": JointServo,
    "servo_cs": CartesianServo,
    "body/servo_cv": TwistStamped,
    "spatial/move_cr": PoseStamped,
    "interpolate_cf": WrenchStamped,
    "trajectory_j/set_ratio": Float64,
    "trajectory_j/set_ratio_v": Float64,
    "trajectory_j/set_ratio_a": Float64,
    "interpolate_jp": JointState,
    "interpolate_jr": JointState,
    "interpolate_jv": JointState,
    "interpolate_cp": PoseStamped,
    "interpolate_cr": PoseStamped,
    "interpolate_cv": TwistStamped,
    "move_cr": PoseStamped,
    "move_jp": JointState,
    "move_jr": JointState,
    "move_cp": PoseStamped,
    "state_command": StringStamped,
    "hold": Empty,
    "free": Empty,
}
SERVICES = {
    "operating_state": TriggerOperatingState,
    "forward_kinematics": QueryForwardKinematics,
    "inverse_kinematics": QueryInverseKinematics,
    "crtk_version": Trigger,
    "crtk_driver/set_parameters": SetParameters,
    "crtk_driver/describe_parameters": DescribeParameters,
}
GLOBAL = {"/tf": TFMessage, "/diagnostics": DiagnosticArray}
LATCHED = {"crtk_driver/crtk_capabilities": String}

RELIABLE = QoSProfile(depth=10)
TRANSIENT = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


class Inbox:
    """What arrived on one topic."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self._arrived = threading.Condition()

    def __call__(self, message: Any) -> None:
        with self._arrived:
            self.messages.append(message)
            self._arrived.notify_all()

    def mark(self) -> int:
        """Return the place of the next message."""
        return len(self.messages)

    def wait(self, accept: Callable[[Any], bool] = lambda message: True, since: int = 0) -> Any:
        """Return the first message from place `since` on that `accept` likes."""
        end = time.monotonic() + LONG
        with self._arrived:
            while True:
                while since < len(self.messages):
                    if accept(self.messages[since]):
                        return self.messages[since]
                    since += 1
                left = end - time.monotonic()
                if left <= 0.0 or not self._arrived.wait(left):
                    last = self.messages[-1] if self.messages else "nothing ever came"
                    raise AssertionError(f"no such message within {LONG} s; last: {last}")


class RosClient:
    """Connected to one namespace, to everything in the tables above but what is `absent` there."""

    def __init__(self, namespace: str, absent: Collection[str] = ()) -> None:
        self.namespace = namespace
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("test_client", context=self._context)
        self.inboxes: dict[str, Inbox] = {}
        self.state_stamps: list[int] = []
        self._state_stamp = 0
        for name, kind in PUBLISHED.items():
            if name not in absent:
                self._listen(name, f"{namespace}/{name}", kind, RELIABLE)
        for name, kind in LATCHED.items():
            self._listen(name, f"{namespace}/{name}", kind, TRANSIENT)
        for name, kind in GLOBAL.items():
            self._listen(name, name, kind, RELIABLE)
        self.publishers = {
            name: self.node.create_publisher(
                kind,
                f"{namespace}/{name}",
                TRANSIENT if name == "state_command" else RELIABLE,
            )
            for name, kind in COMMANDED.items()
            if name not in absent
        }
        self.clients = {
            name: self.node.create_client(kind, f"{namespace}/{name}")
            for name, kind in SERVICES.items()
        }
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name="test client")
        self._thread.start()

    def _listen(self, name: str, topic: str, kind: type, qos: QoSProfile) -> None:
        inbox = self.inboxes[name] = Inbox()
        receive = self._newer_state(inbox) if name == "operating_state" else inbox
        self.node.create_subscription(kind, topic, receive, qos)

    def _newer_state(self, inbox: Inbox) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            self.state_stamps.append(stamp_ns(message))
            if stamp_ns(message) > self._state_stamp:
                self._state_stamp = stamp_ns(message)
                inbox(message)

        return receive

    def _spin(self) -> None:
        while not self._stop.is_set():
            # A test destroyed what was just about to be served.
            with suppress(InvalidHandle):
                self._executor.spin_once(timeout_sec=0.05)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def __getitem__(self, name: str) -> Inbox:
        return self.inboxes[name]

    def check_connections(self) -> None:
        """Wait until each end has met its other end, as the official client does, and has been met by it."""
        end = time.monotonic() + LONG
        loose = ["?"]
        while loose and time.monotonic() < end:
            loose = [n for n, p in self.publishers.items() if not p.get_subscription_count()]
            loose += [s.topic_name for s in self.node.subscriptions if not s.get_publisher_count()]
            loose += [n for n, c in self.clients.items() if not c.service_is_ready()]
            time.sleep(0.01)
        assert not loose, f"not connected: {loose}"
        # A node that this one has found may not have found this one yet, and would miss what is sent.
        # It finds ends in the order in which they were made: those of topics before those of services.
        self.call("crtk_version", Trigger.Request())

    def send(self, name: str, message: Any) -> None:
        self.publishers[name].publish(message)

    def call(self, name: str, request: Any, again: float = 2.0) -> Any:
        """Ask, and again after so many seconds: an answer is lost where this node is not found yet."""
        done, asked = threading.Event(), []
        end = time.monotonic() + LONG
        while not done.is_set():
            assert time.monotonic() < end, f"{name} did not answer"
            asked.append(self.clients[name].call_async(request))
            asked[-1].add_done_callback(lambda _: done.set())
            done.wait(min(again, end - time.monotonic()))
        return next(future.result() for future in asked if future.done())

    def trigger(self, name: str) -> Trigger.Response:
        """Ask a service of the device's own for what it does."""
        if name not in self.clients:
            self.clients[name] = self.node.create_client(Trigger, f"{self.namespace}/{name}")
            assert self.clients[name].wait_for_service(LONG)
        response: Trigger.Response = self.call(name, Trigger.Request(), again=LONG)
        return response

    def set_parameter(self, name: str, value: float) -> bool:
        """Set a parameter of the node and return whether it was accepted."""
        number = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        request = SetParameters.Request(parameters=[Parameter(name=name, value=number)])
        response = self.call("crtk_driver/set_parameters", request)
        return bool(response.results[0].successful)

    # ------------------------------------------------------------------------------ operating state

    @property
    def state(self) -> Any:
        return self["operating_state"].wait(since=max(0, self["operating_state"].mark() - 1))

    def state_command(self, text: str) -> None:
        self.send("state_command", StringStamped(string=text))

    def reach(self, command: str, state: str) -> Any:
        """Send a state command and wait for the state, busy over."""
        since = self["operating_state"].mark()
        self.state_command(command)
        return self["operating_state"].wait(lambda m: m.state == state and not m.is_busy, since)

    def wait_for_busy(self, since: int) -> None:
        """Wait as the official move handle does: busy must be seen True, then False."""
        inbox = self["operating_state"]
        started = inbox.messages.index(inbox.wait(lambda m: m.is_busy, since))
        inbox.wait(lambda m: not m.is_busy, started)

    def move(self, name: str, message: Any) -> None:
        since = self["operating_state"].mark()
        self.send(name, message)
        self.wait_for_busy(since)
