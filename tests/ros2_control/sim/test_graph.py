"""The simulated robot on ROS, by clients that know nothing of our driver."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from control_msgs.action import FollowJointTrajectory
from controller_manager_msgs.srv import (
    ListControllers,
    ListHardwareComponents,
    SetHardwareComponentState,
    SwitchController,
)
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from crtk_sim_backends.process import RunningSim
from crtk_sim_backends.ros2_control import SIM
from rigs.action_client import ABORTED, CANCELED, SUCCEEDED, ActionAsker, trajectory_goal
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros

JOINTS = [f"joint_{number}" for number in range(1, 7)]
START = [0.0, 0.4, 0.8, 0.2, 0.6, 0.0]
P, V, T = (
    "forward_position_controller",
    "forward_velocity_controller",
    "joint_trajectory_controller",
)


class Client:
    """A node that asks and waits."""

    def __init__(self, namespace: str) -> None:
        self.namespace = namespace
        self._context = Context()
        rclpy.init(context=self._context)
        self.node = rclpy.create_node("somebody", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._clients: dict[str, Any] = {}

    def ask(self, kind: Any, service: str, /, **fields: Any) -> Any:
        client = self._clients.get(service)
        if client is None:
            client = self.node.create_client(kind, f"{self.namespace}/{service}")
            self._clients[service] = client
        assert client.wait_for_service(LONG)
        future = client.call_async(kind.Request(**fields))
        self._executor.spin_until_future_complete(future, LONG)
        assert future.done(), service
        return future.result()

    def switch(self, activate: list[str], deactivate: list[str], strictness: int = 2) -> Any:
        return self.ask(
            SwitchController,
            "controller_manager/switch_controller",
            activate_controllers=activate,
            deactivate_controllers=deactivate,
            strictness=strictness,
        )

    def states(self) -> dict[str, str]:
        answer = self.ask(ListControllers, "controller_manager/list_controllers")
        return {one.name: one.state for one in answer.controller}

    def until(self, test: Callable[[], Any], what: str) -> None:
        deadline = time.monotonic() + LONG
        while not test():
            assert time.monotonic() < deadline, what
            self._executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture
def client(sim: RunningSim) -> Iterator[Client]:
    client = Client(sim.control.status()["namespace"])
    yield client
    client.close()
    sim.control.inject("all_inactive")
    sim.control.call("place", positions=START)


def test_what_the_manager_lists(client: Client) -> None:
    answer = client.ask(ListControllers, "controller_manager/list_controllers")
    found = {one.name: one for one in answer.controller}
    assert found["joint_state_broadcaster"].state == "active"
    assert list(found[P].required_command_interfaces) == [f"{name}/position" for name in JOINTS]
    assert list(found[P].claimed_interfaces) == []
    parameters = client.ask(GetParameters, f"{P}/get_parameters", names=["joints", "other"])
    assert list(parameters.values[0].string_array_value) == JOINTS
    assert parameters.values[1].type == 0
    hardware = client.ask(ListHardwareComponents, "controller_manager/list_hardware_components")
    assert [(one.name, one.state.label) for one in hardware.component] == [("sim_system", "active")]


def test_a_conflict_is_refused_with_a_message(client: Client) -> None:
    assert client.switch([P], []).ok
    answer = client.switch([V], [])
    assert not answer.ok
    assert "Resource conflict" in answer.message
    assert client.switch([V], [P]).ok
    assert client.states()[V] == "active"


def test_hardware_goes_through_its_life_cycle(client: Client) -> None:
    name = "controller_manager/set_hardware_component_state"
    for number, label in ((2, "inactive"), (3, "active")):
        request = SetHardwareComponentState.Request(name="sim_system")
        request.target_state.id = number
        answer = client.ask(
            SetHardwareComponentState, name, name="sim_system", target_state=request.target_state
        )
        assert (answer.ok, answer.state.label) == (True, label)


def test_joint_states_have_a_joint_of_somebody_else_and_the_description_is_latched(
    client: Client,
) -> None:
    states: list[JointState] = []
    texts: list[str] = []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    base = client.namespace
    client.node.create_subscription(JointState, f"{base}/joint_states", states.append, 10)
    client.node.create_subscription(
        String, f"{base}/robot_description", lambda message: texts.append(message.data), latched
    )
    client.until(lambda: states and texts, "both")
    assert list(states[0].name) == ["gripper_joint", *JOINTS]
    assert "tool0" in texts[0]


def test_a_command_stays_when_nobody_sends_any_more(client: Client, sim: RunningSim) -> None:
    assert client.switch([V], []).ok
    publisher = client.node.create_publisher(
        Float64MultiArray, f"{client.namespace}/{V}/commands", 10
    )
    client.until(publisher.get_subscription_count, "it listens")

    def begins() -> bool:
        publisher.publish(Float64MultiArray(data=[0.2, 0.0, 0.0, 0.0, 0.0, 0.0]))
        return bool(sim.control.status()["velocities"][0] > 0.1)

    eventually(begins, "it moves")
    here = sim.control.status()["positions"][0]
    eventually(lambda: sim.control.status()["positions"][0] > here + 0.1, "it goes on")
    assert sim.control.status()["velocities"][0] == pytest.approx(0.2, abs=0.02)


def test_a_goal_is_reached_rejected_cancelled_and_ended_by_a_switch(
    client: Client, sim: RunningSim
) -> None:
    goal = trajectory_goal(JOINTS[::-1], [(0.5, [0.0, 0.6, 0.2, 0.8, 0.4, 0.2])])
    name = f"{client.namespace}/{T}/follow_joint_trajectory"
    with ActionAsker(FollowJointTrajectory, name) as asker:
        assert asker.send(goal) is None, "it is not active"
        assert client.switch([T], []).ok
        status, result = asker.ask(goal).wait()
        assert (status, result.error_code) == (SUCCEEDED, 0)
        unknown = trajectory_goal([*JOINTS[:5], "elbow"], [(1.0, START)])
        assert asker.send(unknown) is None
        long = trajectory_goal(JOINTS, [(30.0, [1.0] * 6)])
        asked = asker.ask(long)
        asked.cancel()
        assert asked.wait()[0] == CANCELED
        asked = asker.ask(long)
        eventually(lambda: sim.control.status()["velocities"][0] != 0.0, "it moves")
        assert client.switch([], [T]).ok
        status, result = asked.wait()
        assert status == ABORTED
        assert "deactivate" in result.error_string


def test_services_can_be_late(client: Client, sim: RunningSim) -> None:
    sim.control.inject("late_services", seconds=0.3, service="list_controllers")
    began = time.monotonic()
    client.states()
    assert time.monotonic() - began > 0.25
    sim.control.clear()
