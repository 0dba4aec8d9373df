"""The client of an action, in a world: three services and two topics.

See design.ros2.org/articles/actions.html.
"""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from crtk_drivers.testing.world.middleware.rclpy_endpoints import Client, Subscription
from crtk_drivers.testing.world.middleware.rclpy_handles import Handle, Node
from crtk_drivers.testing.world.middleware.rclpy_waiting import WaitSet


class ActionClient(Handle):
    """In place of rclpy's."""

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        goal_profile: Any,
        result_profile: Any,
        cancel_profile: Any,
        feedback_profile: Any,
        status_profile: Any,
    ) -> None:
        super().__init__()
        parts, hidden = kind.Impl, f"{name}/_action"
        for each in (parts.FeedbackMessage, parts.GoalStatusMessage):
            each.__class__.__import_type_support__()
        self._goal = Client(node, parts.SendGoalService, f"{hidden}/send_goal", goal_profile)
        self._cancel = Client(
            node, parts.CancelGoalService, f"{hidden}/cancel_goal", cancel_profile
        )
        self._result = Client(node, parts.GetResultService, f"{hidden}/get_result", result_profile)
        self._feedback = Subscription(
            node, parts.FeedbackMessage, f"{hidden}/feedback", feedback_profile
        )
        self._status = Subscription(
            node, parts.GoalStatusMessage, f"{hidden}/status", status_profile
        )
        self._indices: list[tuple[str, int]] = []

    def is_action_server_available(self) -> bool:
        """As rclpy: its services and its topics were found."""
        services = (self._goal, self._cancel, self._result)
        topics = (self._feedback, self._status)
        return all(each.service_server_is_available() for each in services) and all(
            each.get_publisher_count() for each in topics
        )

    def send_goal_request(self, request: Any) -> int:
        """As rclpy."""
        return self._goal.send_request(request)

    def send_cancel_request(self, request: Any) -> int:
        """As rclpy."""
        return self._cancel.send_request(request)

    def send_result_request(self, request: Any) -> int:
        """As rclpy."""
        return self._result.send_request(request)

    def take_goal_response(self, kind: Any) -> tuple[Any, Any]:
        """As rclpy."""
        return _taken(self._goal, kind)

    def take_cancel_response(self, kind: Any) -> tuple[Any, Any]:
        """As rclpy."""
        return _taken(self._cancel, kind)

    def take_result_response(self, kind: Any) -> tuple[Any, Any]:
        """As rclpy."""
        return _taken(self._result, kind)

    def take_feedback(self, kind: Any) -> Any:
        """As rclpy."""
        taken = self._feedback.take_message(kind, raw=False)
        return None if taken is None else taken[0]

    def take_status(self, kind: Any) -> Any:
        """As rclpy."""
        taken = self._status.take_message(kind, raw=False)
        return None if taken is None else taken[0]

    def get_num_entities(self) -> tuple[int, ...]:
        """As rclpy: subscriptions, guard conditions, timers, clients, services."""
        return 2, 0, 0, 3, 0

    def add_to_waitset(self, wait_set: WaitSet) -> None:
        """As rclpy."""
        topics, services = (self._feedback, self._status), (self._goal, self._cancel, self._result)
        self._indices = [("subscription", wait_set.add_subscription(each)) for each in topics]
        self._indices += [("client", wait_set.add_client(each)) for each in services]

    def is_ready(self, wait_set: WaitSet) -> tuple[bool, ...]:
        """As rclpy: feedback, status, and the answers to goal, cancel and result."""
        return tuple(wait_set.is_ready(kind, index) for kind, index in self._indices)

    @override
    def destroyed(self) -> None:
        """End all of it."""
        for each in (self._goal, self._cancel, self._result, self._feedback, self._status):
            each.destroy_when_not_in_use()


def _taken(client: Client, kind: Any) -> tuple[Any, Any]:
    info, response = client.take_response(kind)
    return (None, None) if info is None else (info.request_id.sequence_number, response)
