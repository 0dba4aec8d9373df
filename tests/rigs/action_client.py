"""A client of the actions that MoveIt asks, by rclpy's own action client."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any, Self

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from trajectory_msgs.msg import JointTrajectoryPoint

from rigs.waiting import LONG

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


class Asked:
    """A goal that was accepted."""

    def __init__(self, client: ActionAsker, handle: Any, feedback: list[Any]) -> None:
        self._client = client
        self._handle = handle
        self._result = client.begun(handle.get_result_async)
        self.feedback = feedback

    def wait(self, timeout: float = 30.0) -> tuple[int, Any]:
        """Return its final status and its result."""
        answer = self._client.until(self._result, timeout)
        return int(answer.status), answer.result

    def cancel(self) -> Any:
        """Ask for its end; return the answer."""
        return self._client.until(self._client.begun(self._handle.cancel_goal_async))

    @property
    def has_ended(self) -> bool:
        return bool(self._result.done())


class ActionAsker:
    """One action's client."""

    def __init__(self, kind: Any, name: str, node_name: str = "move_group") -> None:
        self.kind = kind
        self._context = Context()
        rclpy.init(context=self._context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(node_name, context=self._context)
        self._client = ActionClient(self.node, kind, name)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._spin, name=node_name)

    def _spin(self) -> None:
        while not self._stop.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def __enter__(self) -> Self:
        self._thread.start()
        assert self._client.wait_for_server(LONG), "no such action server"
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._client.destroy()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.try_shutdown()

    def begun(self, ask: Callable[[], Any]) -> Any:
        """Return the future of what the executor's thread asks: rclpy loses answers that come too soon."""
        asked: list[Any] = []
        done = threading.Event()

        def run() -> None:
            asked.append(ask())
            done.set()

        self._executor.create_task(run)
        assert done.wait(LONG), "the client's executor stands"
        return asked[0]

    def until(self, future: Any, timeout: float = LONG) -> Any:
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        assert done.wait(timeout), f"no answer within {timeout} s"
        return future.result()

    def send(self, goal: Any) -> Asked | None:
        """Send a goal; None: rejected."""
        feedback: list[Any] = []

        def heard(message: Any) -> None:
            feedback.append(message.feedback)

        handle = self.until(self.begun(lambda: self._client.send_goal_async(goal, heard)))
        return Asked(self, handle, feedback) if handle.accepted else None

    def ask(self, goal: Any) -> Asked:
        asked = self.send(goal)
        assert asked is not None, "the goal was rejected"
        return asked


def trajectory_goal(
    names: Sequence[str], rows: Sequence[tuple[float, Sequence[float]]], **fields: Any
) -> FollowJointTrajectory.Goal:
    """A goal through points, each at rest: (seconds, positions)."""
    goal = FollowJointTrajectory.Goal(**fields)
    goal.trajectory.joint_names = list(names)
    for seconds, positions in rows:
        point = JointTrajectoryPoint(positions=[float(p) for p in positions])
        point.velocities = [0.0] * len(point.positions)
        set_duration(point.time_from_start, seconds)
        goal.trajectory.points.append(point)
    return goal


def set_duration(duration: Any, seconds: float) -> None:
    duration.sec = int(seconds // 1)
    duration.nanosec = int((seconds % 1.0) * 1e9)


def as_moveit(
    names: Sequence[str], rows: Sequence[tuple[float, Sequence[float]]]
) -> FollowJointTrajectory.Goal:
    """A goal as moveit_simple_controller_manager's handle sends it.

    follow_joint_trajectory_controller_handle.cpp: the trajectory with a zero stamp, no tolerances unless they
    are configured, and no goal time; its first point is the state that it planned from, at time 0, at rest.
    """
    return trajectory_goal(names, rows)
