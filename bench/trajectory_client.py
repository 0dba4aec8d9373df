"""The client of `bench.trajectories`, in a process of its own.

Arguments: the namespace, the joints with commas between. Reads lines: ``follow`` or ``many`` and the joint
positions of the start, or ``wait`` and seconds; answers with seconds to acceptance, to the result, and the
final status. Or ``point`` or ``array`` and the start: a stream as MoveIt Servo's, in steps; answers with the
times (monotonic, s) at which those were published.
"""

from __future__ import annotations

import sys
import time
from typing import Final

import numpy as np
import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

POINTS: Final = 200
SECONDS: Final = 4.0
MANY: Final = 100_000
AMPLITUDE: Final = 0.15
"""rad that each joint goes away and back."""
RATE: Final = 100.0
"""Hz of a stream."""
STEP: Final = 0.002
STEPS: Final = 100
HELD: Final = 10
"""rad, number, and messages that say the same, of its steps."""


def points(start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times (m,), positions and velocities (m, n) of a way from rest to rest, away and back twice."""
    times = np.linspace(0.0, SECONDS, POINTS)
    phase = times / SECONDS
    ease = phase - np.sin(2 * np.pi * phase) / (2 * np.pi)
    rate = (1 - np.cos(2 * np.pi * phase)) / SECONDS
    angle = 2 * np.pi * 1.25 * ease
    away = AMPLITUDE * np.sin(angle)
    speed = AMPLITUDE * np.cos(angle) * 2 * np.pi * 1.25 * rate
    ones = np.ones_like(start)
    return times, start + np.outer(away, ones), np.outer(speed, ones)


def goal_of(names: list[str], start: np.ndarray, repeat: int = 1) -> FollowJointTrajectory.Goal:
    """Return the goal; with `repeat` its points again and again, which is no trajectory."""
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = names
    for seconds, position, velocity in zip(*points(start), strict=True):
        point = JointTrajectoryPoint(positions=position.tolist(), velocities=velocity.tolist())
        point.time_from_start.sec = int(seconds)
        point.time_from_start.nanosec = int((seconds % 1.0) * 1e9)
        goal.trajectory.points.append(point)
    goal.trajectory.points = list(goal.trajectory.points) * repeat
    return goal


def streamed(node: Node, space: str, word: str, names: list[str], start: np.ndarray) -> list[float]:
    """Publish a stream that steps forth and back, and return when each step was published first."""
    kind, topic = (
        (JointTrajectory, "joint_trajectory")
        if word == "point"
        else (Float64MultiArray, "forward_position_controller/commands")
    )
    publisher = node.create_publisher(kind, f"{space}/{topic}", 1)
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    begun, stepped = time.monotonic(), []
    for number in range(HELD * STEPS):
        time.sleep(max(0.0, begun + number / RATE - time.monotonic()))
        place = start + STEP * (number // HELD % 2)
        if word == "point":
            point = JointTrajectoryPoint(positions=place.tolist())
            point.time_from_start.nanosec = int(1e9 / RATE)
            message = JointTrajectory(joint_names=names, points=[point])
        else:
            message = Float64MultiArray(data=place.tolist())
        if number and number % HELD == 0:
            stepped.append(time.monotonic())
        publisher.publish(message)
    node.destroy_publisher(publisher)
    return stepped


def main() -> None:
    """Serve lines until there are no more."""
    space, names = sys.argv[1], sys.argv[2].split(",")
    rclpy.init()
    node = rclpy.create_node("bench_moveit")
    client = ActionClient(node, FollowJointTrajectory, f"{space}/follow_joint_trajectory")
    client.wait_for_server()
    print(flush=True)
    for line in sys.stdin:
        word, *numbers = line.split()
        if word == "wait":
            time.sleep(float(numbers[0]))
            print(0.0, 0.0, 0.0, flush=True)
            continue
        start = np.array([float(number) for number in numbers])
        if word in ("point", "array"):
            print(*streamed(node, space, word, names, start), flush=True)
            continue
        repeat = 1 if word == "follow" else MANY // POINTS
        goal = goal_of(names, start, repeat)
        begin = time.monotonic()
        sent = client.send_goal_async(goal)
        rclpy.spin_until_future_complete(node, sent)
        accepted = time.monotonic() - begin
        handle = sent.result()
        status = 0.0
        if handle.accepted:
            result = handle.get_result_async()
            rclpy.spin_until_future_complete(node, result)
            status = float(result.result().status)
        print(accepted, time.monotonic() - begin, status, flush=True)
    node.destroy_node()
    rclpy.shutdown()


if __name__ == "__main__":
    main()
