"""What a node serves for MoveIt beside CRTK: actions, in a node and a thread of their own, and topics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from rclpy.context import Context

from crtk_drivers.engine import Engine
from crtk_drivers.errors import ConfigError
from crtk_drivers.ros.controllers import FOLLOW, GRIP, PARALLEL_GRIP, actions_of
from crtk_drivers.ros.joint_names import JointNames
from crtk_drivers.ros.names import ACTIONS_NODE_NAME
from crtk_drivers.ros.own_thread import SpunNode
from crtk_drivers.ros.publishing import PublishingThread


class Actions:
    """The action servers of one device. Nothing is there if it has nothing to be asked.

    Args:
        context, namespace: of the driver's node.
        thread: that publishes.
        engine: of the device.
        names: of its joints.
        admit: called before each goal; may refuse it.

    Raises:
        ConfigError: the messages of the actions are not installed.
    """

    def __init__(
        self,
        context: Context,
        namespace: str,
        thread: PublishingThread,
        engine: Engine,
        names: JointNames,
        admit: Callable[[str], None],
    ) -> None:
        self._spun: SpunNode | None = None
        behaviours = _behaviours(engine, names, admit)
        if not behaviours:
            return
        from crtk_drivers.ros.actions.action_server import ActionServer

        self._spun = SpunNode(context, ACTIONS_NODE_NAME, namespace, f"actions {engine.name}")
        for name, behaviour in behaviours.items():
            ActionServer(self._spun.node, thread, engine, name, behaviour)

    def start(self) -> None:
        """Begin to serve."""
        if self._spun is not None:
            self._spun.start()

    def stop(self, timeout: float) -> None:
        """Serve no more. One that is being answered is waited for, for `timeout` s."""
        if self._spun is not None:
            self._spun.stop(timeout)


def _behaviours(engine: Engine, names: JointNames, admit: Callable[[str], None]) -> dict[str, Any]:
    try:
        from crtk_drivers.ros.actions.grippers import Grip, ParallelGrip
        from crtk_drivers.ros.actions.trajectories import FollowTrajectory
    except ImportError as error:
        raise ConfigError(
            f"node.moveit: the actions of control_msgs are not installed: {error}",
            remedy="pip install 'crtk-drivers[moveit]', or with an installed ROS 2: "
            "sudo apt install ros-jazzy-control-msgs",
        ) from error
    kinds: Mapping[str, Callable[..., Any]] = {
        FOLLOW: FollowTrajectory,
        GRIP: Grip,
        PARALLEL_GRIP: ParallelGrip,
    }
    return {name: kinds[name](engine, names, admit) for name in actions_of(engine.device)}
