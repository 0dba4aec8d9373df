"""A program of a UR arm that is to be played, and a stop right behind that, over DDS."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from crtk_msgs.msg import StringStamped
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from crtk_drivers.config import NodeConfig
from rigs.loopback_node import served
from rigs.ros_client import RosClient
from rigs.ur_bench import UrBench, ur_bench
from rigs.ur_node import NOT_ON_A_UR, PATIENT
from rigs.waiting import LONG, eventually

NAMESPACE = "/test_ros_ur_programs"
TURN = "def turn():\n  movej([0.4, -1.57, 1.57, -1.57, -1.57, 0.0], a=6, v=2)\n  sleep(60)\nend\n"
TRIES = 40
STOPPED = 1
"""Value of `runtime_state`."""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[UrBench, RosClient]]:
    """An arm that is not enabled, with a program that turns its base loaded."""
    programs: Path = tmp_path_factory.mktemp("programs")
    (programs / "turn.script").write_text(TURN)
    config = {**PATIENT, "power_off_on_disable": False}
    with (
        ur_bench(config, start=False, programs=str(programs)) as bench,
        RosClient(NAMESPACE, NOT_ON_A_UR) as client,
        served(bench.session, NAMESPACE, (), NodeConfig()),
    ):
        client.check_connections()
        client.reach("enable", "ENABLED")
        client.reach("disable", "DISABLED")
        sender = client.node.create_publisher(StringStamped, f"{NAMESPACE}/load_program", 10)

        def is_loaded() -> bool:
            sender.publish(StringStamped(string="turn.script"))
            return bool(bench.arm.state.loaded_program().endswith("turn.script"))

        eventually(is_loaded, "it is loaded")
        yield bench, client


def test_a_program_from_before_hold_moves_nothing_after(arm: tuple[UrBench, RosClient]) -> None:
    bench, client = arm
    caller = client.node.create_client(Trigger, f"{NAMESPACE}/play_program")
    assert caller.wait_for_service(LONG)
    bench.until_outputs(runtime_state=(STOPPED,))
    answers: list[Any] = []
    moved = 0
    for _ in range(TRIES):
        before = bench.q()
        asked = caller.call_async(Trigger.Request())
        client.send("hold", Empty())
        eventually(asked.done, "it is answered")
        answers.append(asked.result().message)
        if bench.watch(0.1) > 1e-3 or abs(bench.q() - before).max() > 1e-3:
            moved += 1
            client.trigger("stop_program")
            bench.until_outputs(runtime_state=(STOPPED,))
            bench.until_still()
    assert not moved, (moved, set(answers))
    assert all("came before" in told or "broken off" in told for told in answers), set(answers)
