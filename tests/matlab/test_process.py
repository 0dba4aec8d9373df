"""What MATLAB calls, and the process behind it: without MATLAB or GNU Octave."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

import pytest

from crtk_drivers.client import matlab
from crtk_drivers.client.matlab import objects
from crtk_drivers.client.move_handle import RemoteMove
from crtk_drivers.errors import ConfigError
from rigs.programs import COMMAND
from rigs.waiting import LONG
from rigs.warm_start import server

needs_ros = pytest.mark.skipif(find_spec("rclpy") is None, reason="rclpy is not installed")


@pytest.fixture(autouse=True)
def end() -> Iterator[None]:
    yield
    matlab.close()


def once(**request: Any) -> Any:
    """One call, as MATLAB makes it."""
    answer = matlab.call(json.dumps(request), sys.executable)
    assert "\n" not in answer
    return json.loads(answer)


def answered(**request: Any) -> Any:
    """Call until there is an answer."""
    answer = once(**request)
    deadline = time.monotonic() + LONG
    while "pending" in answer:
        assert time.monotonic() < deadline, request
        answer = once(do="poll", pending=answer["pending"])
    return answer


def ask(**request: Any) -> Any:
    """Call, and return what is answered."""
    answer = answered(**request)
    assert "error" not in answer, answer["error"]
    return answer["value"]


def pid() -> int:
    assert matlab._client is not None
    return matlab._client.pid


def number(*values: float) -> dict[str, Any]:
    return {"size": [len(values), 1], "data": "".join(f"{value}," for value in values)}


@needs_ros
def test_a_device_is_moved_by_requests_alone() -> None:
    with server().start_text(COMMAND, "loopback", "--ns", "/matlab") as driver:
        try:
            ral = ask(do="ral", name="test_matlab")
            device = ask(do="device", ral=ral, namespace="matlab/")
            for name in ("operating_state", "setpoint_js", "move_jp", "hold"):
                added = ask(do="add", device=device, name=name)
                assert name in [method["name"] for method in added]
            assert ask(do="state", device=device, method="enable", arguments=[30.0]) is True
            goal = {"size": [1, 4], "data": "0.1,0.2,0.3,0.4,"}
            move = ask(do="send", device=device, name="move_jp", arguments=[goal])
            assert ask(do="wait", move=move, is_busy=False, timeout=30.0) is True
            deadline = time.monotonic() + LONG
            position: Any = None
            while position != number(0.1, 0.2, 0.3, 0.4):
                assert time.monotonic() < deadline, position
                position, *_, stamp = ask(do="get", device=device, name="setpoint_js")["values"]
            assert abs(float(stamp["data"].rstrip(",")) - time.time()) < 5.0

            # a setting takes its value
            ask(do="add", device=device, name="trajectory_j/set_ratio")
            ask(do="add", device=device, name="trajectory_j/ratio")
            ask(do="send", device=device, name="trajectory_j/set_ratio", arguments=[number(0.25)])
            deadline = time.monotonic() + LONG
            while ask(do="get", device=device, name="trajectory_j/ratio")["values"][0] != number(
                0.25
            ):
                assert time.monotonic() < deadline

            # interrupted while it waits, MATLAB goes on at once
            begin = time.monotonic()
            waiting = once(
                do="state", device=device, method="wait_for_busy", arguments=[True, 30.0]
            )
            assert "pending" in waiting
            assert ask(do="send", device=device, name="hold", arguments=[]) == 0
            assert time.monotonic() - begin < 30.0
            # and what a timer asks meanwhile is no answer to what waits
            assert once(do="poll", **waiting) == waiting

            # Ctrl-C in a terminal is not for the client; the end of the input is
            os.kill(pid(), signal.SIGINT)
            assert ask(do="is_shutdown", ral=ral) is False
            ask(do="shutdown", ral=ral)
            assert ask(do="is_shutdown", ral=ral) is True
        finally:
            driver.terminate()
            driver.wait(LONG)


def test_errors_are_answers() -> None:
    error = answered(do="get", device=7, name="measured_js")["error"]
    assert error["identifier"] == "crtk:Config"
    assert "crtk.utils" in error["message"]
    assert answered(do="wait", move=7, is_busy=False)["error"]["identifier"] == "crtk:Config"
    assert once(do="poll", pending=99)["error"]["identifier"] == "crtk:Config"
    error = answered(do="what")["error"]
    assert error == {"identifier": "crtk:Error", "message": "KeyError: 'what'"}


def test_when_the_process_dies_the_next_request_finds_a_new_one() -> None:
    ask(do="now")
    dead = pid()
    os.kill(dead, signal.SIGSTOP)  # so that the request is on its way when it dies
    os.kill(dead, signal.SIGKILL)
    answers = [answered(do="now"), answered(do="now")]
    errors = [answer["error"] for answer in answers if "error" in answer]
    assert all(error["identifier"] == "crtk:ConnectionLost" for error in errors)
    assert "value" in answers[1]
    assert pid() != dead


def test_a_python_that_is_not_there() -> None:
    error = json.loads(matlab.call('{"do": "now"}', "/no/such/python"))["error"]
    assert error["identifier"] == "crtk:ConnectionLost"
    assert "/no/such/python" in error["message"]
    error = json.loads(matlab.call('{"do": "now"}', "/bin/false"))["error"]
    assert error["identifier"] == "crtk:ConnectionLost"
    assert "anew" in error["message"]


def test_libraries_of_matlab_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    own = "/usr/local/MATLAB/R2024b/sys/os/glnxa64"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{own}:/opt/ros/jazzy/lib::{own}/x")
    monkeypatch.setenv("LD_PRELOAD", f"{own}/libstdc++.so.6")
    variables = matlab.environment()
    assert variables["LD_LIBRARY_PATH"] == "/opt/ros/jazzy/lib"
    assert "LD_PRELOAD" not in variables
    assert os.environ["LD_PRELOAD"]


def test_only_the_newest_moves_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    class Arm:
        namespace = "/r"

        def move_jp(self, goal: object) -> RemoteMove:
            return RemoteMove(
                "move_jp",
                stamp_ns=0,
                was_busy=False,
                refused_before=False,
                at_goal=lambda: None,
                lost=lambda: "",
            )

    monkeypatch.setattr(objects, "KEPT_MOVES", 3)
    own = objects.Session()
    own._devices[1] = Arm()  # type: ignore[assignment]
    moves = [own.send(1, "move_jp", [number(0.0)]) for _ in range(5)]
    assert own.is_busy(moves[2])
    with pytest.raises(ConfigError, match="not known any more"):
        own.is_busy(moves[1])
