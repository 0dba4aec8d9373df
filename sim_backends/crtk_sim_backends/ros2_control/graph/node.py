"""What a simulated robot is on ROS: the topics and services of controller_manager and its controllers.

All of it is spun by the simulator's own loop, so that nothing happens between two of its ticks.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.msg import (
    ControllerState,
    HardwareComponentState,
    HardwareInterface,
)
from controller_manager_msgs.srv import (
    ListControllers,
    ListHardwareComponents,
    SetHardwareComponentState,
    SwitchController,
)
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from crtk_sim_backends.ros2_control.controllers import (
    ForwardController,
    Point,
    TrajectoryController,
)
from crtk_sim_backends.ros2_control.robot import HARDWARE, Robot

ROUNDS: Final = 8
"""Events that are served in one tick, at most."""
STATES: Final = {"unconfigured": 1, "inactive": 2, "active": 3, "finalized": 4}
"""Of lifecycle_msgs/State."""


class Graph:
    """The node of a robot.

    Args:
        robot: that it shows.
        namespace: of all that it has.
        domain: of ROS; None: that of the environment.
        description: URDF that is published.
    """

    def __init__(self, robot: Robot, namespace: str, domain: int | None, description: str) -> None:
        self._robot = robot
        self._namespace = namespace
        self._context = Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = Node(
            "controller_manager",
            namespace=namespace,
            context=self._context,
            enable_rosout=False,
            start_parameter_services=False,
            use_global_arguments=False,
        )
        self._rival: Node | None = None
        self._rival_publisher: Any = None
        self._waiting: list[tuple[float, Callable[[], None]]] = []
        self._delayed: deque[tuple[float, Any]] = deque()
        self._stamp = 0
        self._lost: Counter[str] = Counter()
        self._states = self._node.create_publisher(JointState, f"{namespace}/joint_states", 10)
        self._serve_manager()
        for name, controller in robot.controllers.items():
            self._serve_controller(name, controller)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._description = self._node.create_publisher(
            String, f"{namespace}/robot_description", latched
        )
        self._description.publish(String(data=description))
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)

    def spin(self) -> None:
        """Serve what has come."""
        now = time.monotonic()
        due = [work for at, work in self._waiting if at <= now]
        self._waiting = [(at, work) for at, work in self._waiting if at > now]
        for work in due:
            work()
        for _ in range(ROUNDS):
            self._executor.spin_once(timeout_sec=0.0)

    def close(self) -> None:
        """End the node."""
        self._executor.shutdown(timeout_sec=0.0)
        if self._rival is not None:
            self._rival.destroy_node()
        self._node.destroy_node()
        self._context.try_shutdown()

    # ------------------------------------------------------------------------------- joint states

    def tell(self) -> None:
        """Publish joint states, as the faults of now have them."""
        robot, faults = self._robot, self._robot.faults
        now = time.monotonic()
        if "frozen" not in faults:
            self._stamp = time.time_ns()
        self._tell_rival()
        if robot.broadcasts:
            if "garbage" in faults:
                self._states.publish(b"\x00\x01\x00\x00\xff\xff\xff\xff")
                return
            due = now + faults.get("delay", {}).get("seconds", 0.0)
            self._delayed.extend((due, message) for message in self._messages())
        while self._delayed and self._delayed[0][0] <= now:
            message = self._delayed.popleft()[1]
            if not robot.is_silent:
                self._states.publish(message)

    def _messages(self) -> list[JointState]:
        robot, faults = self._robot, self._robot.faults
        joints = robot.joints
        columns = {
            "position": joints.position.tolist(),
            "velocity": joints.velocity.tolist(),
            "effort": joints.effort.tolist(),
        }
        if "not_a_number" in faults:
            fault = faults["not_a_number"]
            columns[fault["of"]][fault["joint"]] = float("nan")
        places = list(range(len(robot.names)))
        if "missing" in faults:
            places.remove(faults["missing"]["joint"])
        if "twice" in faults:
            places.append(faults["twice"]["joint"])
        if "reorder" in faults:
            places.reverse()
        parts = [places]
        if "split" in faults:
            half = len(places) // 2
            parts = [places[:half], places[half:]]
        return [self._message(part, columns) for part in parts]

    def _message(self, places: list[int], columns: dict[str, list[float]]) -> JointState:
        message = JointState()
        if "unstamped" not in self._robot.faults:
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(
                self._stamp, 1_000_000_000
            )
        # Another device's joint, as where a gripper is behind the same manager.
        message.name = ["gripper_joint", *(self._robot.names[place] for place in places)]
        for name, values in columns.items():
            setattr(message, name, [0.0, *(values[place] for place in places)])
        return message

    def _tell_rival(self) -> None:
        if "rival" not in self._robot.faults:
            return
        if self._rival is None:
            self._rival = Node(
                "joint_state_publisher",
                namespace=self._namespace,
                context=self._context,
                enable_rosout=False,
                start_parameter_services=False,
                use_global_arguments=False,
            )
            self._rival_publisher = self._rival.create_publisher(
                JointState, f"{self._namespace}/joint_states", 10
            )
        message = JointState(name=list(self._robot.names))
        message.header.stamp.sec = int(time.time())
        message.position = [0.0] * len(message.name)
        self._rival_publisher.publish(message)

    # ----------------------------------------------------------------------------------- services

    def _serve(self, kind: Any, name: str, answer: Callable[[Any, Any], None]) -> None:
        """Serve what may be answered late: rclpy calls back, and the response is sent when it is due."""
        service = self._node.create_service(
            kind, name, lambda request, response: (request, response)
        )
        send = service.send_response

        def send_when_due(both: Any, header: Any) -> None:
            def respond() -> None:
                request, response = both
                answer(request, response)
                send(response, header)

            seconds = self._lateness(name)
            if seconds > 0.0:
                self._waiting.append((time.monotonic() + seconds, respond))
            else:
                respond()

        service.send_response = send_when_due

    def _lateness(self, name: str) -> float:
        """Return after how many seconds a service of this full name answers; inf: never."""
        faults, service = self._robot.faults, name.rpartition("/")[2]
        if self._robot.is_silent:
            return float("inf")
        silent, late = faults.get("silent_services"), faults.get("late_services")
        lost = faults.get("lost_answers")
        if lost is None:
            self._lost.clear()
        elif self._lost[name] < lost["count"]:
            self._lost[name] += 1
            return float("inf")
        if silent is not None and silent["service"] in ("", service):
            return float("inf")
        if late is not None and late["service"] in ("", service):
            return float(late["seconds"])
        return 0.0

    def _serve_manager(self) -> None:
        base = f"{self._namespace}/controller_manager"
        self._serve(ListControllers, f"{base}/list_controllers", self._list_controllers)
        self._serve(SwitchController, f"{base}/switch_controller", self._switch)
        self._serve(ListHardwareComponents, f"{base}/list_hardware_components", self._list_hardware)
        self._serve(
            SetHardwareComponentState, f"{base}/set_hardware_component_state", self._set_hardware
        )

    def _list_controllers(self, request: Any, response: Any) -> None:
        for one in self._robot.controllers.values():
            needs = self._robot.claimed(one)
            response.controller.append(
                ControllerState(
                    name=one.name,
                    state=one.state,
                    type=one.type,
                    update_rate=100,
                    claimed_interfaces=needs if one.state == "active" else [],
                    required_command_interfaces=needs,
                )
            )

    def _switch(self, request: Any, response: Any) -> None:
        response.ok, response.message = self._robot.switch(
            list(request.activate_controllers),
            list(request.deactivate_controllers),
            request.strictness,
        )

    def _list_hardware(self, request: Any, response: Any) -> None:
        robot = self._robot
        component = HardwareComponentState(
            name=HARDWARE, type="system", rw_rate=100, plugin_name="mock_components/GenericSystem"
        )
        component.state.id = STATES[robot.hardware]
        component.state.label = robot.hardware
        for kind in ("position", "velocity", "effort"):
            component.command_interfaces += [
                HardwareInterface(name=f"{name}/{kind}", data_type="double", is_available=True)
                for name in robot.names
            ]
        response.component.append(component)

    def _set_hardware(self, request: Any, response: Any) -> None:
        names = {number: name for name, number in STATES.items()}
        wanted = names.get(request.target_state.id, request.target_state.label)
        response.ok, state = self._robot.set_hardware(request.name, wanted)
        response.state.id, response.state.label = STATES.get(state, 0), state

    # -------------------------------------------------------------------------------- controllers

    def _serve_controller(self, name: str, controller: Any) -> None:
        def parameters(request: Any, response: Any) -> None:
            one = self._robot.controllers.get(name)
            names = [] if one is None else [self._robot.names[place] for place in one.order]
            for wanted in request.names:
                value = ParameterValue(type=ParameterType.PARAMETER_NOT_SET)
                if wanted == "joints":
                    value = ParameterValue(
                        type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=names
                    )
                response.values.append(value)

        self._serve(GetParameters, f"{self._namespace}/{name}/get_parameters", parameters)
        if isinstance(controller, ForwardController):
            self._node.create_subscription(
                Float64MultiArray,
                f"{self._namespace}/{name}/commands",
                lambda message: self._robot.forward(name, list(message.data)),
                10,
            )
        if isinstance(controller, TrajectoryController):
            self._serve_trajectories(name)

    def _serve_trajectories(self, name: str) -> None:
        base = f"{self._namespace}/{name}"
        self._node.create_subscription(
            JointTrajectory,
            f"{base}/joint_trajectory",
            lambda message: self._follow(name, message, None),
            10,
        )

        async def execute(handle: Any) -> Any:
            ended: Future = Future()
            result = FollowJointTrajectory.Result()
            began = self._follow(
                name,
                handle.request.trajectory,
                lambda reached, why: ended.done() or ended.set_result((reached, why)),
            )
            reached, why = (await ended) if began else (False, "the controller is not active")
            result.error_string = why
            if handle.is_cancel_requested:
                handle.canceled()
            elif reached:
                handle.succeed()
            else:
                result.error_code = FollowJointTrajectory.Result.INVALID_GOAL
                handle.abort()
            return result

        def cancel(handle: Any) -> CancelResponse:
            one = self._robot.controllers.get(name)
            if self._robot.is_silent:
                return CancelResponse.REJECT
            if isinstance(one, TrajectoryController):
                # Once the goal is known to be cancelling.
                self._waiting.append((time.monotonic(), lambda: one.hold("cancelled")))
            return CancelResponse.ACCEPT

        self._actions = ActionServer(
            self._node,
            FollowJointTrajectory,
            f"{base}/follow_joint_trajectory",
            execute_callback=execute,
            goal_callback=lambda goal: self._accepts(name, goal.trajectory),
            cancel_callback=cancel,
        )

    def _accepts(self, name: str, trajectory: JointTrajectory) -> GoalResponse:
        one = self._robot.controllers.get(name)
        fits = one is not None and one.state == "active" and not self._robot.is_silent
        if fits and self._points(trajectory) is not None:
            return GoalResponse.ACCEPT
        return GoalResponse.REJECT

    def _points(self, trajectory: JointTrajectory) -> list[Point] | None:
        """Return the points in the order of the robot, None if they are no trajectory of it."""
        names, robot = list(trajectory.joint_names), self._robot
        if sorted(names) != sorted(robot.names) or not trajectory.points:
            return None
        order = [names.index(name) for name in robot.names]
        points, before = [], 0.0
        for point in trajectory.points:
            at = point.time_from_start.sec + 1e-9 * point.time_from_start.nanosec
            if len(point.positions) != len(names) or at <= before:
                return None
            before = at
            velocity = _placed(point.velocities, order) if len(point.velocities) else None
            points.append(Point(at, _placed(point.positions, order), velocity))
        return points

    def _follow(self, name: str, trajectory: JointTrajectory, ended: Any) -> bool:
        robot = self._robot
        one, points = robot.controllers.get(name), self._points(trajectory)
        if points is None or not isinstance(one, TrajectoryController) or one.state != "active":
            return False
        if robot.is_silent:
            return False
        one.begin(points, robot.now, robot.joints.position, robot.joints.velocity, ended)
        return True


def _placed(values: Any, order: list[int]) -> Any:
    return np.array([values[place] for place in order])
