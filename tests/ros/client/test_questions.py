"""A service whose first answer is lost, as to a client that was not found yet, or that answers nothing."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

import pytest
from crtk_msgs.msg import OperatingState, StringStamped
from crtk_msgs.srv import TriggerOperatingState
from std_msgs.msg import Empty

from crtk_drivers.client import connect
from crtk_drivers.client.ros_link import Link, wait_connected
from crtk_drivers.errors import DataTimeout
from rigs.beside import beside
from rigs.waiting import LONG, eventually

SERVICE, UNANSWERED = "/lossy/operating_state", "/unanswered/operating_state"


@pytest.mark.ros
def test_what_changes_nothing_is_asked_again_and_all_else_is_not() -> None:
    answers, asks = Link("answers"), Link("asks")
    asked: dict[str, int] = {}

    def serve(name: str, lost: float) -> None:
        """Serve a question whose first answers are lost."""
        service = answers.node.create_service(
            TriggerOperatingState, name, lambda request, response: response
        )
        send = service.send_response

        def lossy(response: Any, header: Any) -> None:
            asked[name] = asked.get(name, 0) + 1
            if asked[name] > lost:
                send(response, header)

        service.send_response = lossy

    try:
        serve(SERVICE, 1)
        serve(UNANSWERED, math.inf)
        answers.start()
        asks.start()
        assert asks.state_caller(SERVICE).operating_state(LONG).wall_ns == 0
        assert asked[SERVICE] > 1
        caller = asks.state_caller(UNANSWERED)
        assert wait_connected([caller], time.monotonic() + LONG)
        with pytest.raises(DataTimeout, match=r"operating_state did not answer in 1 s"):
            caller.call(1.0)
        assert asked.get(UNANSWERED, 0) <= 1
    finally:
        asks.close()
        answers.close()


@pytest.mark.ros
def test_what_stops_is_sent_before_anything_is_asked() -> None:
    mute, heard = Link("mute"), []
    speaks, answers = threading.Event(), threading.Event()
    status = OperatingState(state="ENABLED", is_homed=True)
    node = mute.node
    told = node.create_publisher(OperatingState, "/mute/operating_state", 10)
    service = node.create_service(
        TriggerOperatingState, "/mute/operating_state", lambda request, response: response
    )
    answer = service.send_response
    service.send_response = lambda *told: answer(*told) if answers.is_set() else None

    def tell() -> None:
        status.header.stamp = node.get_clock().now().to_msg()
        told.publish(status)

    def command(message: StringStamped) -> None:
        heard.append(message.string)
        if status.state != "DISABLED":  # it tells changes only
            status.state = "DISABLED"
            tell()

    node.create_timer(0.02, lambda: tell() if speaks.is_set() else None)
    node.create_subscription(Empty, "/mute/hold", lambda message: heard.append("hold"), 10)
    node.create_subscription(StringStamped, "/mute/state_command", command, 10)
    try:
        mute.start()
        with connect("/mute", timeout=LONG) as arm:
            eventually(
                lambda: {"hold", "state_command"} <= set(arm.crtk_commands), "they are found"
            )
            arm.add("hold", "state_command")
            with beside(lambda over: arm.hold()):
                eventually(lambda: "hold" in heard, "it is told to hold, though it tells nothing")
                speaks.set()
                answers.set()
            answers.clear()
            speaks.clear()
            with beside(lambda over: arm.disable(timeout=LONG)):
                eventually(lambda: "disable" in heard, "it is told to end")
                asked = arm._space.link.state_caller("/mute/operating_state")
                eventually(
                    lambda: asked._client._pending_requests, "it asks how the device is, after that"
                )
                answers.set()
    finally:
        mute.close()
