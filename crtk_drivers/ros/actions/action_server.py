"""One action server, of services and publishers."""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Final

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_action_status_default

from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused
from crtk_drivers.motion.move import Move
from crtk_drivers.recording.cdr_trajectories import GOAL_ID
from crtk_drivers.ros import qos
from crtk_drivers.ros.actions.action_goals import NEVER, CancelCode, Goal, Goals, GoalState
from crtk_drivers.ros.arrival import Arrival
from crtk_drivers.ros.controllers import part as part_of
from crtk_drivers.ros.messages import set_stamp, stamp_ns
from crtk_drivers.ros.publishing import Job, PublishingThread
from crtk_drivers.ros.unlocked import UnlockedNode
from crtk_drivers.ros.unlocked_service import UnlockedService
from crtk_drivers.samples import CLOCKS_AGREE

Reply = Callable[[Any], None]

logger = logging.getLogger(__name__)

FEEDBACK_RATE: Final = 20.0
"""Hz, as joint_trajectory_controller's ``action_monitor_rate``."""


class Pursuit(ABC):
    """An accepted goal while it is pursued.

    Attributes:
        move: what pursues it.
        is_cancelled: a client wants it ended.
    """

    def __init__(self, move: Move) -> None:
        self.move = move
        self.is_cancelled = False

    @abstractmethod
    def feedback(self) -> Any:
        """Return the feedback now, None if there is none; called `FEEDBACK_RATE` times a second."""

    @abstractmethod
    def result(self) -> tuple[GoalState, Any]:
        """Return how it ended. Called once its move has."""


class Behaviour(ABC):
    """What an action is for.

    Attributes:
        action: its type.
        takes_bytes: its goals are the bytes of their requests.
    """

    action: Any
    takes_bytes = False

    @abstractmethod
    def begin(self, goal: Any, arrival: Arrival) -> Pursuit:
        """Begin what a goal asks for.

        Args:
            goal: see `takes_bytes`.
            arrival: when it came; see `crtk_drivers.engine.Engine.submit`.

        Raises:
            CommandRefused: the goal is rejected; counted and told already.
        """


class ActionServer:
    """Serves one action.

    Goals are taken in the executor's thread of `node`; all that is published, and results, go out from the
    publishing thread.

    Args:
        node: that has a thread of its own.
        thread: of the driver.
        engine: of the device.
        name: of the action, relative to the node's namespace.
        behaviour: what it is for.
    """

    def __init__(
        self,
        node: UnlockedNode,
        thread: PublishingThread,
        engine: Engine,
        name: str,
        behaviour: Behaviour,
    ) -> None:
        self._engine = engine
        self._behaviour = behaviour
        self._name = name
        self._goals = Goals()
        self._lock = threading.Lock()
        self._pursued: dict[bytes, Pursuit] = {}
        self._ended: SimpleQueue[bytes] = SimpleQueue()
        kind = behaviour.action
        self._services = [
            UnlockedService(node, type_, part_of(name, part), answer, takes_bytes)
            for part, type_, answer, takes_bytes in (
                ("send_goal", kind.Impl.SendGoalService, self._send_goal, behaviour.takes_bytes),
                ("cancel_goal", CancelGoal, self._cancel, False),
                ("get_result", kind.Impl.GetResultService, self._get_result, False),
            )
        ]
        self._feedback: Publisher = qos.publisher(
            node, kind.Impl.FeedbackMessage, part_of(name, "feedback"), qos.DATA
        )
        self._status: Publisher = qos.publisher(
            node, GoalStatusArray, part_of(name, "status"), qos_profile_action_status_default
        )
        self._ends: Job = thread.job(f"{name} ends", self._tell_ends)
        self._told: Job = thread.job(f"{name} status", self._tell_status)
        self._heard: Job = thread.job(f"{name} feedback", self._tell_feedback)

    # ------------------------------------------------------------------- in the executor's thread

    def _send_goal(self, request: Any, reply: Reply, arrival: Arrival) -> None:
        response = self._behaviour.action.Impl.SendGoalService.Response(accepted=False)
        try:
            self._take(request, response, arrival)
        finally:
            reply(response)

    def _take(self, request: Any, response: Any, arrival: Arrival) -> None:
        """Begin what is asked, and say in the response whether it was accepted."""
        if isinstance(request, bytes):
            goal_id, wanted = request[GOAL_ID], request
        else:
            goal_id, wanted = bytes(bytearray(request.goal_id.uuid)), request.goal
        if goal_id == NEVER or self._goals.get(goal_id) is not None:
            logger.warning(
                "%s: a goal of %s has an id that is taken", self._engine.where, self._name
            )
            return
        try:
            pursuit = self._behaviour.begin(wanted, arrival)
        except CommandRefused:
            return  # counted and told to the engine's observers
        with self._lock:
            now = time.time_ns()
            goal = self._goals.add(goal_id, now)
            goal.become(GoalState.EXECUTING)
            self._pursued[goal_id] = pursuit
            self._heard.set_rate(FEEDBACK_RATE)
        set_stamp(response.stamp, now)
        response.accepted = True
        self._told.ask()
        pursuit.move.when_ended(lambda: self._has_ended(goal_id))

    def _has_ended(self, goal_id: bytes) -> None:
        """Whoever ends a move, the I/O thread among them, only leaves a note of it."""
        self._ended.put(goal_id)
        self._ends.ask()

    def _cancel(self, request: Any, reply: Reply, arrival: Arrival) -> None:
        wanted = request.goal_info
        before, behind_ns = stamp_ns(wanted.stamp), -arrival.ahead_ns
        if before and behind_ns > CLOCKS_AGREE * 1e9:
            # Whether it is a time that we told or one of the client's clock is not known: none is missed.
            before += behind_ns
        with self._lock:
            code, goals = self._goals.to_cancel(bytes(bytearray(wanted.goal_id.uuid)), before)
            pursued = [self._pursued[goal.id] for goal in goals if goal.id in self._pursued]
            for goal in goals:
                goal.become(GoalState.CANCELING)
        for pursuit in pursued:
            pursuit.is_cancelled = True
            self._engine.end_move(pursuit.move, "its client cancelled it")
        if code is CancelCode.NONE and not goals:
            code = CancelCode.REJECTED
        infos = [_info(goal) for goal in goals]
        reply(CancelGoal.Response(return_code=int(code), goals_canceling=infos))
        self._told.ask()

    def _get_result(self, request: Any, reply: Reply, arrival: Arrival) -> None:
        response = self._behaviour.action.Impl.GetResultService.Response()

        def answer() -> None:
            if goal is not None:
                response.status, response.result = int(goal.state), goal.result
            reply(response)

        with self._lock:
            goal = self._goals.get(bytes(bytearray(request.goal_id.uuid)))
            waits = goal is not None and goal.ask(answer)
        if not waits:
            answer()

    # ----------------------------------------------------------------- in the publishing thread

    def _tell_ends(self) -> None:
        while not self._ended.empty():
            goal_id = self._ended.get()
            pursuit = self._pursued[goal_id]
            state, result = pursuit.result()
            with self._lock:
                goal = self._goals.get(goal_id)
                del self._pursued[goal_id]
                asking = [] if goal is None else goal.end(state, result)
            for answer in asking:
                answer()
            self._told.ask()

    def _tell_status(self) -> None:
        with self._lock:
            rows = [
                GoalStatus(goal_info=_info(goal), status=int(goal.state)) for goal in self._goals
            ]
        self._status.publish(GoalStatusArray(status_list=rows))

    def _tell_feedback(self) -> None:
        with self._lock:
            pursued = tuple(self._pursued.items())
            if not pursued:
                self._heard.set_rate(0.0)
        for goal_id, pursuit in pursued:
            feedback = pursuit.feedback()
            if feedback is not None and self._feedback.get_subscription_count():
                message = self._behaviour.action.Impl.FeedbackMessage(feedback=feedback)
                message.goal_id.uuid = list(goal_id)
                self._feedback.publish(message)


def _info(goal: Goal) -> Any:
    info = GoalStatus().goal_info
    info.goal_id.uuid = list(goal.id)
    set_stamp(info.stamp, goal.accepted_ns)
    return info
