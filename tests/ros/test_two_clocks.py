"""A client on a machine whose clock disagrees with the driver's: whole processes, over DDS."""

from __future__ import annotations

import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from crtk_msgs.msg import OperatingState
from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.cli.coupled_on_ros import coupled_on_ros
from crtk_drivers.client import connect
from crtk_drivers.config import from_values, load
from crtk_drivers.config.settings import PoseConfig
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused
from crtk_drivers.labs.lab_entries import CarriedEntry, MarkerEntry
from crtk_drivers.plugins import RunningSim
from crtk_drivers.samples import JointState, Pose
from crtk_drivers.session import Session
from crtk_drivers.status.board import Observer
from rigs.action_client import CANCELED, SUCCEEDED, as_moveit, set_duration
from rigs.loopback_client import Far, Node, far_device
from rigs.moveit_node import MoveItRig, moveit_rig
from rigs.system_clock import OFFSETS, YEAR, shifted, told_by
from rigs.waiting import LONG, eventually

COMMANDS = """
import json, sys, time
from crtk_drivers.client import connect

found = {"clock": time.time()}
with connect(sys.argv[1], timeout=60.0) as arm:
    arm.enable(timeout=60.0)
    found["enabled"] = str(arm.operating_state().state)
    goal = arm.measured_jp(wait=60.0) + 0.05
    found["moved"] = arm.move_jp(goal).wait(60.0)
    found["at"] = arm.measured_jp(wait=60.0).tolist()
    found["goal"] = goal.tolist()
    for step in range(50):
        arm.servo_jp(goal)
        time.sleep(0.01)
    arm.hold()
    arm.state_command("pause", timeout=60.0)
    arm.state_command("resume", timeout=60.0)
    arm.disable(timeout=60.0)
    found["disabled"] = str(arm.operating_state().state)
print(json.dumps(found))
"""


IN_THE_OLD_STYLE = """
import json, sys, time
import numpy
import crtk_drivers.client.compat as crtk

class Arm:
    def __init__(self, ral):
        self.utils = crtk.utils(self, ral)
        self.utils.add_operating_state()
        self.utils.add_measured_js()
        self.utils.add_move_jp()
        ral.check_connections(60.0)
        ral.spin()

ral = crtk.ral("old_style", sys.argv[1].strip("/"))
arm = Arm(ral)
found = {"enabled": arm.enable(60.0)}
sent = ral.now()
found["before anything is heard"] = arm.is_busy(start_time=sent)
arm.move_jp(arm.measured_jp(wait=60.0) + 0.05)
found["begins"] = arm.wait_for_busy(is_busy=True, start_time=sent, timeout=60.0)
found["ends"] = arm.wait_for_busy(start_time=sent, timeout=60.0)
found["after its end"] = arm.is_busy(start_time=sent)
found["disabled"] = arm.disable(60.0)
ral.shutdown()
print(json.dumps(found))
"""


AGED = """
import json, sys
from crtk_drivers.client import connect
from crtk_drivers.errors import CommandRefused

with connect(sys.argv[1], timeout=60.0) as arm:
    arm.hold()
    arm.disable(timeout=60.0)
    try:
        arm.enable(timeout=60.0)
    except CommandRefused as refusal:
        print(json.dumps([str(refusal.reason), refusal.detail, refusal.remedy]))
"""


TRAJECTORIES = """
import json, sys, time
import numpy as np
from control_msgs.action import FollowJointTrajectory
from rigs.action_client import ActionAsker, as_moveit, set_duration

space, delay, *joints = sys.argv[1:]
names, here = zip(*(each.split("=") for each in joints))
here = np.array(here, dtype=float)
with ActionAsker(FollowJointTrajectory, f"{space}/follow_joint_trajectory") as asker:
    goal = as_moveit(names, [(0.0, here), (1.0, here + 0.02)])
    if delay != "now":
        set_duration(goal.trajectory.header.stamp, time.time() + float(delay))
    asked = asker.send(goal)
    print(json.dumps(None if asked is None else asked.wait(60.0)[0]))
"""


CANCEL_WHAT_CAME_BEFORE_NOW = """
import json, sys, time
from action_msgs.srv import CancelGoal
from rigs.action_client import set_duration
from rigs.loopback_client import Node

with Node("canceller") as node:
    client = node.node.create_client(
        CancelGoal, f"{sys.argv[1]}/follow_joint_trajectory/_action/cancel_goal"
    )
    assert client.wait_for_service(60.0)
    request = CancelGoal.Request()
    set_duration(request.goal_info.stamp, time.time())
    print(json.dumps(len(client.call(request).goals_canceling)))
"""


@pytest.fixture(scope="module")
def moveit() -> Iterator[MoveItRig]:
    plugin = plugins.device("virtual")
    values = {**plugin.typical, "rate": 200.0, "sample_timeout": 3.0}
    session = Session(plugin, load(plugin.config, from_values(values)))
    with moveit_rig(session, "/two_clocks_moveit") as rig:
        yield rig.enabled()


@pytest.fixture(scope="module")
def far() -> Iterator[Far]:
    with far_device("/two_clocks") as far:
        yield far


@pytest.mark.parametrize("seconds", OFFSETS)
def test_a_client_with_another_clock_commands(far: Far, seconds: float) -> None:
    far.reset()
    begun = far.engine.health()
    found = told_by(seconds, COMMANDS, far.namespace)
    assert found["clock"] - time.time() == pytest.approx(seconds, abs=60.0), "the rig shifts"
    assert (found["enabled"], found["disabled"]) == ("ENABLED", "DISABLED")
    assert found["moved"] is True
    assert found["at"] == pytest.approx(found["goal"], abs=1e-3)
    measured = far.engine.feedback("measured_js")
    assert measured is not None
    assert isinstance(measured[0], JointState)
    assert np.allclose(measured[0].position, found["goal"], atol=1e-3)
    assert far.engine.health().refusals == begun.refusals, "nothing was refused"


@pytest.mark.parametrize("seconds", OFFSETS)
def test_busy_since_a_time_needs_no_common_clock(far: Far, seconds: float) -> None:
    far.reset()
    assert told_by(seconds, IN_THE_OLD_STYLE, far.namespace) == {
        "enabled": True,
        "before anything is heard": True,
        "begins": True,
        "ends": True,
        "after its end": False,
        "disabled": True,
    }


@pytest.mark.parametrize(
    ("seconds", "reason", "told"),
    [
        (-2.0, "too_old", r"by the sender's clock, is 2\.\d{3} s old by the driver's"),
        (
            2.0,
            "from_future",
            r"by the sender's clock, lies (1\.9\d\d|2\.0\d\d) s ahead of the driver's",
        ),
        (0.3, "from_future", r"by the sender's clock, lies 0\.[23]\d\d s ahead of the driver's"),
    ],
)
def test_an_age_that_is_judged_is_told_by_its_clocks(
    seconds: float, reason: str, told: str
) -> None:
    with far_device("/two_clocks_aged", limits={"max_command_age": 0.2}) as far:
        why, detail, remedy = told_by(seconds, AGED, far.namespace)
    assert why == reason
    assert re.search(told, detail)
    assert "chrony or PTP" in remedy


def followed(rig: MoveItRig, seconds: float, delay: str) -> object:
    joints = [f"{n}={q:.9f}" for n, q in zip(rig.names, rig.joints(), strict=True)]
    return told_by(seconds, TRAJECTORIES, rig.space, delay, *joints)


class Told(Observer):
    def __init__(self, engine: Engine) -> None:
        self.refusals: list[CommandRefused] = []
        self.warnings: list[str] = []
        engine.add_observer(self)

    @override
    def command_refused(self, refusal: CommandRefused) -> None:
        self.refusals.append(refusal)

    @override
    def warned(self, text: str) -> None:
        self.warnings.append(text)


@pytest.mark.parametrize("seconds", OFFSETS)
def test_a_trajectory_for_now_needs_no_common_clock(moveit: MoveItRig, seconds: float) -> None:
    assert followed(moveit, seconds, "now") == SUCCEEDED


@pytest.mark.parametrize(
    ("seconds", "told"),
    [
        (2.0, r"the clock of its sender is (1\.9\d\d|2\.000) s ahead of the driver's"),
        (
            -2.0,
            r"it came 2\.\d\d\d s after it was sent, by the clocks of its sender and the driver",
        ),
        (YEAR, r"the clock of its sender is 3153\d{4}\.\d{3} s ahead of the driver's"),
    ],
)
def test_a_beginning_by_another_clock_is_refused(
    moveit: MoveItRig, seconds: float, told: str
) -> None:
    heard, here = Told(moveit.engine), moveit.joints()
    assert followed(moveit, seconds, "0.3") is None
    (refusal,) = heard.refusals
    assert re.search(told, refusal.detail)
    assert "chrony or PTP" in refusal.remedy
    assert np.allclose(moveit.joints(), here, atol=1e-3)


def test_a_beginning_by_a_clock_slightly_off_is_noted(moveit: MoveItRig) -> None:
    heard = Told(moveit.engine)
    assert followed(moveit, -0.02, "0.3") == SUCCEEDED
    assert any(
        re.search(r"it came 0\.\d\d\d s after it was sent, .* by chrony or PTP", each)
        for each in heard.warnings
    ), heard.warnings


@pytest.mark.parametrize("seconds", [-YEAR, 2.0])
def test_cancelling_by_a_time_stops_by_any_clock(moveit: MoveItRig, seconds: float) -> None:
    here = moveit.joints()
    asked = moveit.asker.ask(as_moveit(moveit.names, [(0.0, here), (LONG, here + 0.2)]))
    assert told_by(seconds, CANCEL_WHAT_CAME_BEFORE_NOW, moveit.space) == 1
    assert asked.wait(LONG)[0] == CANCELED


@dataclass
class FollowingSim:
    """A simulator that notes by how much (s) what it is told lies in its past."""

    running: bool = True
    past: list[float] = field(default_factory=list)

    def put(self, sim: RunningSim, marker: str, pose: Pose, wall_ns: int) -> None:
        self.past.append((time.time_ns() - wall_ns) / 1e9)


@pytest.mark.parametrize("seconds", [2.0, -2.0, YEAR, -YEAR])
def test_a_simulator_follows_an_arm_by_its_own_clock(seconds: float) -> None:
    sim: Any = FollowingSim()
    plugin: Any = SimpleNamespace(
        name="tracker", sim_load=None, sim_put=sim.put, markers=lambda config: {"marker": "M"}
    )
    space = "/two_clocks_carrier"
    entry = CarriedEntry(stands=PoseConfig(), markers={"marker": MarkerEntry(on=space)})
    driver = subprocess.Popen(
        [sys.executable, "-m", "rigs.serve_loopback", space],
        env=shifted(seconds),
        stdout=subprocess.DEVNULL,
    )
    try:
        with coupled_on_ros(plugin, plugin, sim, entry):
            eventually(lambda: len(sim.past) > 100, "the simulator is told of the arm")
    finally:
        driver.terminate()
        driver.wait(LONG)
    assert np.median(sim.past[50:]) == pytest.approx(0.0, abs=0.2)


@pytest.mark.parametrize("behind", [0.006, 0.9])
def test_a_state_by_a_clock_that_is_behind_is_heard(behind: float) -> None:
    space = f"/two_clocks_taken_over_{round(1e3 * behind)}"
    with Node("taking_over") as node:
        publisher = node.node.create_publisher(OperatingState, f"{space}/operating_state", 10)

        def tell(state: str, at: float) -> None:
            message = OperatingState(state=state, is_homed=True)
            set_duration(message.header.stamp, at)
            publisher.publish(message)

        stop = threading.Event()
        thread = threading.Thread(target=until_heard, args=(stop, tell))
        thread.start()
        try:
            with connect(space, timeout=LONG, features=["operating_state"]) as arm:
                stop.set()
                thread.join()
                tell("DISABLED", time.time())
                tell("ENABLED", time.time() - behind)
                assert arm.wait_for_status(lambda status: status.state == "ENABLED", LONG)
        finally:
            stop.set()
            thread.join()


def until_heard(stop: threading.Event, tell: Callable[[str, float], None]) -> None:
    while not stop.wait(0.05):
        tell("DISABLED", time.time())
