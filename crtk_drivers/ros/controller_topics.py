"""What clients of ros2_controllers publish, MoveIt Servo among them, as commands of CRTK."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.subscription import Subscription
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from crtk_drivers.commands import FOLLOW, Payload, find
from crtk_drivers.engine import Engine
from crtk_drivers.recording.cdr_trajectories import decode_trajectory
from crtk_drivers.ros import qos
from crtk_drivers.ros.controllers import FORWARDS, TRAJECTORY, inputs_of
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.received import Received
from crtk_drivers.ros.subscriptions import CommandTopics
from crtk_drivers.ros.trajectory_input import command_of, read_trajectory, require_common_clock
from crtk_drivers.samples import Numbers, joint_state, vector


class ControllerTopics:
    """``joint_trajectory``, and the commands of two forward_command_controllers.

    Args:
        engine: of the device.
        topics: of the device's own commands.
        names: of its joints.
        admit: called before each command; may refuse it.
    """

    def __init__(
        self,
        engine: Engine,
        topics: CommandTopics,
        names: JointNames,
        admit: Callable[[str], None],
    ) -> None:
        self._engine = engine
        self._topics = topics
        self._names = names
        self._admit = admit
        self.subscriptions: dict[str, Subscription] = {}
        for topic in inputs_of(engine.device):
            if topic == TRAJECTORY:
                # One without points is a stop: what comes after it must not take its place.
                heard = topics.listen(topic, JointTrajectory, self._trajectory, qos.EVERY)
            else:
                forward = self._forward(FORWARDS[topic])
                heard = topics.listen(topic, Float64MultiArray, forward, qos.NEWEST)
            self.subscriptions[topic] = heard

    def _trajectory(self, message: Received) -> None:
        asked = read_trajectory(self._engine, self._names, message.data, decode_trajectory)
        command, value = command_of(asked)
        self._admit(command)
        if command == FOLLOW.name:
            require_common_clock(self._engine, asked, message.arrival)
        # One that is gone along has a time of its own.
        stamp_ns = 0 if command == FOLLOW.name else asked.start_ns
        self._topics.submit(command, value, stamp_ns, message)

    def _forward(self, command: str) -> Callable[[Received], None]:
        kind = find(command).kind

        def take(message: Received) -> None:
            self._admit(command)
            value, _ = self._topics.read(command, Payload.NUMBERS, message.data)
            assert isinstance(value, Numbers)
            joints = joint_state(kind, vector(value.values))
            self._topics.submit(command, joints, 0, message)

        return take
