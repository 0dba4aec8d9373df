"""A node on the robot's side of ROS, with a context, an executor and one thread of its own.

What other threads want of it they put into a queue; it is done by this thread, which alone touches ROS. A
DDS writer may block it; nobody waits for it but with a deadline.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, TypeVar

import rclpy
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.executors import Executor
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from crtk_driver_ros2_control.asking import Asked, Delivery, Following
from crtk_driver_ros2_control.foreign import messages
from crtk_driver_ros2_control.outgoing import IDLE
from crtk_drivers.ros import qos
from crtk_drivers.ros.received import AttributedSubscription
from crtk_drivers.ros.senders import Sender, Senders
from crtk_drivers.ros.spinning import SPIN_PERIOD, make_executor
from crtk_drivers.ros.unlocked import UnlockedNode

logger = logging.getLogger(__name__)

T = TypeVar("T")

NODE_NAME: Final = "crtk_ros2_control"
CENSUS: Final = 1.0
"""Seconds between two looks at who else sends commands."""
FLUSH: Final = 0.2
"""Seconds that the end waits for a robot to have received the last commands."""
LOOK: Final = 0.005
"""Seconds between two looks at what is to be sent before the end."""
SUCCEEDED: Final = 4
"""Of action_msgs/GoalStatus."""


class ForeignNode:
    """Talks to the nodes of one robot. Nothing runs before `start`; after `stop` it is over.

    Args:
        namespace: of its controllers, ending in a slash.
        joint_states: topic of its joint states.
        forward, trajectory: names of controllers that commands are sent to.
        domain: of ROS; None: that of the environment.
        heard: called in this node's thread with the bytes of each joint state and who sent it.
        pump: called in this node's thread after all that has happened, and when `wake` was called; returns
            after how many seconds it wants to be called again, `IDLE` if it has nothing more to send.
        ending: seconds in which `pump` has sent all of a stop.

    Attributes:
        failure: why it ended; empty if it did not, or was stopped.
        others: nodes that publish commands for our controllers as well.
        asks: services that will be asked, to be set before `start`: clients that are made at once are known
            to the other side when they ask, and an answer to one that is not is lost.
    """

    def __init__(
        self,
        *,
        namespace: str,
        joint_states: str,
        forward: Sequence[str],
        trajectory: str,
        domain: int | None,
        heard: Callable[[bytes, Sender], None],
        pump: Callable[[], float],
        ending: float,
    ) -> None:
        self._namespace = namespace
        self._joint_states = joint_states
        self._forward = tuple(forward)
        self._trajectory = trajectory
        self._domain = domain
        self._heard = heard
        self._pump = pump
        self._ending = ending
        self._jobs: deque[Callable[[], None]] = deque()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ros2_control", daemon=True)
        self._clients: dict[str, Any] = {}
        self._publishers: dict[str, Any] = {}
        self._pending: dict[Any, tuple[Any, Asked[Any]]] = {}
        self._actions: ActionClient | None = None
        self._executor: Executor | None = None
        self._is_woken = False
        self._next_census = 0.0
        self.failure = ""
        self.others: tuple[str, ...] = ()
        self.asks: Mapping[str, type] = {}

    # ----------------------------------------------------------------------------- from any thread

    def start(self) -> None:
        """Start its thread, which makes the node."""
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Send what waits, end the thread and the node; return whether that was in time."""
        self._stopping.set()
        self.wake()
        self._thread.join(timeout)
        return not self._thread.is_alive()

    @property
    def is_running(self) -> bool:
        """Whether its thread lives."""
        return self._thread.is_alive()

    def wake(self) -> None:
        """Have `pump` called soon."""
        executor = self._executor
        if executor is not None and not self._is_woken:
            self._is_woken = True
            executor.create_task(_nothing)  # what ends a `spin_once` that waits

    def ask(
        self, service: str, kind: type, fields: Mapping[str, Any], read: Callable[[Any], T]
    ) -> Asked[T]:
        """Ask a service; what it answers is read in this node's thread."""
        asked: Asked[T] = Asked(service, time.monotonic())
        self._do(lambda: self._send(service, kind, fields, read, asked))
        return asked

    def forget(self, asked: Asked[Any]) -> None:
        """Wait for an answer no longer."""
        self._do(lambda: self._forget(asked))

    def delivery(self, controller: str) -> Asked[Delivery]:
        """Ask who gets what is sent to a controller, and whether it has arrived."""
        publisher = self._publishers[controller]
        asked: Asked[Delivery] = Asked(publisher.topic_name, time.monotonic())

        def look() -> None:
            has_arrived = publisher.wait_for_all_acked(Duration())
            asked.answer = Delivery(publisher.get_subscription_count(), has_arrived)

        self._do(look)
        return asked

    def follow(self, goal: Following) -> None:
        """Send a goal to the trajectory controller."""
        self._do(lambda: self._follow(goal))

    def cancel(self, goal: Following) -> None:
        """End a goal: the controller holds."""
        goal.is_cancelled = True
        self._do(lambda: self._cancel(goal))

    def _do(self, job: Callable[[], None]) -> None:
        self._jobs.append(job)
        self.wake()

    # ------------------------------------------------------------------------- from its own thread

    def command(self, controller: str, values: Sequence[float]) -> None:
        """Publish a command of a forward controller, in the order of its joints. For `pump`."""
        self._publishers[controller].publish(messages.command(values))

    def point(self, joints: Sequence[str], positions: Sequence[float], seconds: float) -> None:
        """Publish a trajectory of one point, from where the joints are now. For `pump`."""
        self._publishers[self._trajectory].publish(messages.one_point(joints, positions, seconds))

    def _run(self) -> None:
        try:
            context = Context()
            rclpy.init(
                context=context,
                domain_id=self._domain,
                signal_handler_options=SignalHandlerOptions.NO,
            )
        except Exception as error:
            logger.exception("the node on the robot's side could not be made")
            self.failure = f"ROS does not start: {error}"
            return
        try:
            self._spin(context)
        except Exception as error:
            logger.exception("the node on the robot's side ended")
            self.failure = f"its node ended: {error}"
        finally:
            context.try_shutdown()

    def _spin(self, context: Context) -> None:
        node = UnlockedNode(
            NODE_NAME,
            context=context,
            enable_rosout=False,
            start_parameter_services=False,
            use_global_arguments=False,
        )
        self._make(node)
        executor = make_executor(context)
        executor.add_node(node)
        self._executor = executor
        wait = 0.0
        try:
            while not self._stopping.is_set() and context.ok():
                executor.spin_once(timeout_sec=min(wait, SPIN_PERIOD))
                self._is_woken = False
                wait = self._work()
            self._finish()
        finally:
            self._executor = None
            executor.shutdown(timeout_sec=0.0)
            if self._actions is not None:
                self._actions.destroy()  # which the node does not know of
            node.destroy_node()

    def _make(self, node: UnlockedNode) -> None:
        self._node = node
        subscription = node.create_subscription(
            JointState, self._joint_states, lambda message: None, qos.DATA
        )
        self._subscription = AttributedSubscription(node, subscription, self._heard, Senders(node))
        for service, kind in self.asks.items():
            self._clients[service] = node.create_client(kind, service)
        for controller in self._forward:
            topic = f"{self._namespace}{controller}/commands"
            self._publishers[controller] = node.create_publisher(
                Float64MultiArray, topic, qos.NEWEST
            )
        if self._trajectory:
            base = f"{self._namespace}{self._trajectory}"
            self._publishers[self._trajectory] = node.create_publisher(
                JointTrajectory, f"{base}/joint_trajectory", qos.NEWEST
            )
            self._actions = ActionClient(
                node, FollowJointTrajectory, f"{base}/follow_joint_trajectory"
            )

    def _work(self) -> float:
        while self._jobs:
            job = self._jobs.popleft()
            try:
                job()
            except Exception:
                logger.exception("something asked of the robot could not be sent")
        now = time.monotonic()
        if now >= self._next_census:
            self._next_census = now + CENSUS
            self.others = self._census()
        return self._pump()

    def _census(self) -> tuple[str, ...]:
        """Return who else publishes commands for our controllers, by the graph."""
        found: set[str] = set()
        for publisher in self._publishers.values():
            infos = self._node.get_publishers_info_by_topic(publisher.topic_name)
            names = [f"{one.node_namespace.rstrip('/')}/{one.node_name}" for one in infos]
            if self._node.get_fully_qualified_name() in names:
                names.remove(self._node.get_fully_qualified_name())
            found.update(names)
        return tuple(sorted(found))

    def _finish(self) -> None:
        """Send what has been commanded, to the end of a stop: a velocity on the way to zero would stay.

        Then wait a little until it has arrived.
        """
        deadline = time.monotonic() + self._ending
        while self._work() < IDLE and time.monotonic() < deadline:
            time.sleep(LOOK)
        deadline = time.monotonic() + FLUSH
        for publisher in self._publishers.values():
            left = max(deadline - time.monotonic(), 0.0)
            publisher.wait_for_all_acked(Duration(seconds=left))

    def _send(
        self,
        service: str,
        kind: type,
        fields: Mapping[str, Any],
        read: Callable[[Any], T],
        asked: Asked[T],
    ) -> None:
        client = self._clients.get(service)
        if client is None:
            client = self._clients[service] = self._node.create_client(kind, service)
        if not client.service_is_ready():
            # It may have been found by the next call.
            asked.error = f"nobody serves {service}"
            return
        future = client.call_async(messages.request(kind, fields))
        self._pending[asked] = client, future

        def answered(done: Any) -> None:
            self._pending.pop(asked, None)
            try:
                asked.answer = read(done.result())
            except Exception as error:
                asked.error = f"its answer cannot be read: {error}"

        future.add_done_callback(answered)

    def _forget(self, asked: Asked[Any]) -> None:
        found = self._pending.pop(asked, None)
        if found is not None:
            client, future = found
            client.remove_pending_request(future)

    def _follow(self, goal: Following) -> None:
        assert self._actions is not None
        if goal.is_cancelled:
            _end(goal, "cancelled before it was sent")
            return
        if not self._actions.server_is_ready():
            _end(goal, "nobody serves its action")
            return
        future = self._actions.send_goal_async(
            messages.goal(goal.joints, goal.positions.tolist(), goal.seconds)
        )
        future.add_done_callback(lambda done: self._accepted(goal, done))

    def _accepted(self, goal: Following, done: Any) -> None:
        handle = done.result()
        if handle is None or not handle.accepted:
            _end(goal, "the controller does not take it")
            return
        goal.handle = handle
        if goal.is_cancelled:
            handle.cancel_goal_async()
        handle.get_result_async().add_done_callback(lambda result: _result(goal, result))

    def _cancel(self, goal: Following) -> None:
        handle: Any = goal.handle
        if handle is not None and not goal.has_ended:
            handle.cancel_goal_async()


def _nothing() -> None:
    pass


def _result(goal: Following, done: Any) -> None:
    answer = done.result()
    goal.succeeded = answer is not None and answer.status == SUCCEEDED
    _end(goal, "" if answer is None else str(answer.result.error_string))


def _end(goal: Following, text: str) -> None:
    goal.text = text
    goal.has_ended = True
