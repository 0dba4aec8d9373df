"""The official CRTK Python client, unmodified, against the node.

Its code is not part of this project. `CRTK_PYTHON_CLIENT` names the folder that holds its package `crtk`
(``src`` in its repository); PyKDL must be importable too. The client runs in a process of its own, as
users run it. It answers with values in releases before 1.4, with ``(value, stamp)`` since then.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import pytest

from crtk_drivers.testing.loopback import LoopbackConfig
from rigs.loopback_node import Rig, rig_of, serve
from rigs.waiting import LONG, eventually

FOLDER = os.environ.get("CRTK_PYTHON_CLIENT", "")
pytestmark = pytest.mark.skipif(
    not FOLDER, reason="CRTK_PYTHON_CLIENT does not name the sources of the official client"
)

MAIN = "import sys; from crtk_drivers.cli import main; sys.exit(main())"
EVERYWHERE = [
    "operating_state",
    "measured_js",
    "measured_cp",
    "measured_cv",
    "measured_cf",
    "setpoint_js",
    "setpoint_cp",
    "jacobian",
    "servo_jp",
    "servo_jr",
    "servo_cp",
    "servo_cv",
    "move_jp",
    "move_jr",
    "move_cp",
    "hold",
    "free",
    "forward_kinematics",
    "inverse_kinematics",
]
UR_ARGUMENTS = ["--sim", "--set", "sample_timeout=2.0"]
NOT_ON_EVERY_ARM = ["servo_jf", "servo_cf"]

PREAMBLE = """
import sys
import time
import numpy
import PyKDL
import crtk
from crtk_msgs.msg import OperatingState
from sensor_msgs.msg import JointState

TIMEOUT = 60.0

class Arm:
    def __init__(self, ral):
        self.utils = crtk.utils(self, ral, 1.0)
        for name in sys.argv[2:]:
            getattr(self.utils, "add_" + name)()

def value(answer):
    return answer[0] if isinstance(answer, tuple) else answer

def jp():
    return value(arm.measured_jp())

def cp():
    return value(arm.measured_cp())

def until(condition, what):
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end, f"not within {TIMEOUT} s: {what}; at {jp()}, {cp()}"
        time.sleep(0.005)

def until_at(goal):
    until(lambda: numpy.allclose(jp(), goal, atol=2e-3), f"joints at {goal}")

def until_at_frame(goal):
    until(lambda: PyKDL.diff(goal, cp()).vel.Norm() < 2e-3, f"pose at {goal}")

def until_at_rest():
    until(lambda: numpy.abs(value(arm.measured_jv())).max() < 1e-3, "at rest")

def fresh():
    assert arm.disable(TIMEOUT)
    assert arm.enable(TIMEOUT)
    until_at_rest()
    return numpy.copy(value(arm.setpoint_jp()))

ral = crtk.ral("official_client")
device = ral.create_child(sys.argv[1])
arm = Arm(device)
ral.spin()
ral.check_connections(TIMEOUT)
"""

STATES = """
events = []
device.subscriber("operating_state", OperatingState, events.append)
assert arm.wait_for_operating_state("DISABLED", TIMEOUT)
assert arm.is_disabled() and not arm.is_enabled()
assert arm.enable(TIMEOUT) and arm.is_enabled()
assert arm.enable(TIMEOUT), "enabled already"
arm.state_command("pause")
assert arm.wait_for_operating_state("PAUSED", TIMEOUT)
arm.state_command("resume")
assert arm.wait_for_operating_state("ENABLED", TIMEOUT)
assert arm.is_homed() and arm.home(TIMEOUT), "no homing needed"
assert arm.disable(TIMEOUT) and arm.is_disabled()
assert arm.disable(TIMEOUT), "disabled already"
until(lambda: events and events[-1].state == "DISABLED", "the event of the last state")
stamps = [ral.get_timestamp(event).nanoseconds for event in events]
assert all(a < b for a, b in zip(stamps, stamps[1:])), "a message not newer than the last is lost"
"""

FEEDBACK = """
def jacobian():
    try:
        return value(arm.jacobian())
    except IndexError:  # the client raises it until the first message has come
        return None

until(lambda: arm.measured_js()[-1] > 0.0, "measured: the stamp is 0 until the device is connected")
until(lambda: jacobian() is not None, "a jacobian")
count = len(jp())
position, velocity, effort, stamp = arm.measured_js()
assert len(position) == len(velocity) == count and len(effort) in (0, count), (velocity, effort)
assert stamp > 0.0, stamp
assert value(arm.measured_cv()).shape == value(arm.measured_cf()).shape == (6,)
assert jacobian().shape == (6, count)
joints = jp()
frame = value(arm.forward_kinematics(joints))
until_at_frame(frame)
assert numpy.allclose(value(arm.inverse_kinematics(joints, frame)), joints, atol=1e-6)
assert arm.enable(TIMEOUT)
until_at(value(arm.setpoint_jp()))
until_at_frame(value(arm.setpoint_cp()))
alone = crtk.measured_cp(ral.create_child(sys.argv[1] + "/"), 1.0)
ral.check_connections(TIMEOUT)
until(lambda: PyKDL.diff(cp(), value(alone.measured_cp())).vel.Norm() < 2e-3, "the same pose")
"""

MOVES = """
start = fresh()
goal = start + 0.05
handle = arm.move_jp(goal)
assert handle.wait(is_busy=True, timeout=TIMEOUT)
assert handle.wait(timeout=TIMEOUT) and not handle.is_busy()
until_at(goal)
assert arm.move_jp(goal).wait(timeout=TIMEOUT), "a move that is there already"
assert arm.move_jr(numpy.full(len(goal), -0.02)).wait(timeout=TIMEOUT)
until_at(goal - 0.02)
frame = PyKDL.Frame(value(arm.setpoint_cp()))
frame.p[2] += 0.03
assert arm.move_cp(frame).wait(timeout=TIMEOUT)
until_at_frame(frame)
until_at_rest()
here = jp()
assert arm.move_jp(numpy.zeros(1)).wait(timeout=TIMEOUT), "a move of the wrong size"
assert arm.move_jp(numpy.full(len(goal), 99.0)).wait(timeout=TIMEOUT), "a move out of the limits"
assert numpy.allclose(jp(), here, atol=1e-3), "a refused move moves nothing"
sent = ral.now()
arm.move_jp(start)
assert arm.wait_for_busy(is_busy=True, start_time=sent, timeout=TIMEOUT)
assert arm.wait_for_busy(start_time=sent, timeout=TIMEOUT)
until_at(start)
handle = arm.move_jp(start + 0.4)
assert handle.wait(is_busy=True, timeout=TIMEOUT)
arm.hold()
assert handle.wait(timeout=TIMEOUT), "hold ends the move"
until_at_rest()
assert numpy.abs(jp() - start - 0.4).max() > 0.02, "it was held on the way"
assert arm.move_jp(start).wait(timeout=TIMEOUT)
assert arm.disable(TIMEOUT)
assert arm.move_jp(goal).wait(timeout=TIMEOUT), "a move while disabled"
until_at(start)
"""

OPENING = """
start = fresh()
for number in range(10):
    if number % 2 == 0:
        assert arm.disable(TIMEOUT)
    assert arm.enable(TIMEOUT) and arm.home(TIMEOUT)
    goal = start + (0.02 if number % 2 == 0 else 0.0)
    assert arm.move_jp(goal).wait(timeout=TIMEOUT)
    until_at(goal)
"""

STREAMS = """
PERIOD = 0.005

def stream(send, steps=60):
    for step in range(1, steps + 1):
        send(step)
        time.sleep(PERIOD)

start = fresh()
stream(lambda step: arm.servo_jp(start + 0.0005 * step))
until_at(start + 0.03)
until(lambda: numpy.allclose(value(arm.setpoint_jp()), start + 0.03), "the setpoint is published")
assert not value(arm.is_busy(ral.create_time())), "servo is not busy"
velocity = numpy.full(len(start), -0.0005 / PERIOD)
stream(lambda step: arm.servo_jp(start + 0.03 - 0.0005 * step, velocity))
until_at(start)

start = fresh()
stream(lambda step: arm.servo_jr(numpy.full(len(start), 0.0005)))
until_at(start + 0.03)

fresh()
frame = PyKDL.Frame(value(arm.setpoint_cp()))
goal = PyKDL.Frame(frame)

def servo_cp(step):
    goal.p[2] = frame.p[2] + 0.0003 * step
    arm.servo_cp(goal)

stream(servo_cp)
until_at_frame(goal)

fresh()
height = cp().p[2]
while cp().p[2] < height + 0.005:
    arm.servo_cv(numpy.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0]))
    time.sleep(PERIOD)
arm.servo_cv(numpy.zeros(6))
until_at_rest()

# no add_servo_jv in the client: its abstraction layer has publishers
servo_jv = device.publisher("servo_jv", JointState)
ral.check_connections(TIMEOUT)
start = fresh()
while (jp() - start).min() < 0.01:
    servo_jv.publish(JointState(velocity=[0.05] * len(start)))
    time.sleep(PERIOD)
servo_jv.publish(JointState(velocity=[0.0] * len(start)))
until_at_rest()
"""

UNSUPPORTED = """
for name in ("servo_jf", "servo_cf"):
    getattr(arm.utils, "add_" + name)()
try:
    ral.check_connections(1.0)
except TimeoutError as error:
    assert "[{0}/servo_jf, {0}/servo_cf]".format(sys.argv[1]) in str(error), error
else:
    raise AssertionError("the arm takes efforts")
"""

HOMING = """
assert arm.enable(TIMEOUT)
assert not arm.is_homed()
assert arm.home(TIMEOUT) and arm.is_homed()
goal = value(arm.setpoint_jp()) + 0.02
assert arm.move_jp(goal).wait(timeout=TIMEOUT)
until_at(goal)
assert arm.unhome(TIMEOUT) and not arm.is_homed()
assert arm.unhome(TIMEOUT), "not homed already"
assert arm.disable(TIMEOUT)
"""

RESTART = """
assert arm.enable(TIMEOUT)
print("enabled", flush=True)
sys.stdin.readline()
ral.check_connections(TIMEOUT)
arm.state_command("pause")
sys.stdin.readline()
assert arm.wait_for_operating_state("DISABLED", TIMEOUT)
assert arm.enable(TIMEOUT)
"""


@contextmanager
def started(namespace: str, script: str, features: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A client process that runs a script; it must end well."""
    path = os.pathsep.join([FOLDER, *filter(None, [os.environ.get("PYTHONPATH")])])
    client = subprocess.Popen(
        [sys.executable, "-c", f"{PREAMBLE}{script}\nral.shutdown()\n", namespace, *features],
        # a sourced ROS 2 sets ROS_VERSION, the rclpy wheels do not
        env={**os.environ, "PYTHONPATH": path, "ROS_VERSION": "2"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield client
        _, told = client.communicate(timeout=50)
    finally:
        client.kill()
        client.communicate()
    assert client.returncode == 0, told


def run(namespace: str, script: str, features: list[str]) -> None:
    with started(namespace, script, features):
        pass


@pytest.fixture(scope="module")
def ur() -> Iterator[str]:
    """`crtk-driver ur --sim` as a process."""
    namespace = "/official_client/ur5"
    driver = subprocess.Popen([sys.executable, "-c", MAIN, "ur", "--ns", namespace, *UR_ARGUMENTS])
    try:
        yield namespace
    finally:
        driver.terminate()
        assert driver.wait(20) == 0


SCRIPTS = pytest.mark.parametrize(
    "script",
    [STATES, FEEDBACK, OPENING, MOVES, STREAMS],
    ids=["states", "feedback", "opening", "moves", "streams"],
)


@SCRIPTS
def test_on_a_gantry(rig: Rig, script: str) -> None:
    run(rig.client.namespace, script, EVERYWHERE + NOT_ON_EVERY_ARM)


@SCRIPTS
def test_on_a_simulated_ur(ur: str, script: str) -> None:
    run(ur, f"{script}\nassert arm.disable(TIMEOUT)", EVERYWHERE)


def test_commands_that_an_arm_does_not_take_are_told_by_check_connections(ur: str) -> None:
    run(ur, UNSUPPORTED, EVERYWHERE)


def test_homing() -> None:
    with rig_of("/official_homing", needs_homing=True, transition_time=0.2) as rig:
        run(rig.client.namespace, HOMING, EVERYWHERE)


def test_a_restarted_node_does_not_get_the_old_enable() -> None:
    """The client latches state_command, and sends its old commands to whoever wants them."""
    namespace = "/official_restart"
    first, second = (serve(LoopbackConfig(), namespace, []) for _ in range(2))

    def go_on(client: subprocess.Popen[str]) -> None:
        assert client.stdin is not None
        client.stdin.write("\n")
        client.stdin.flush()

    with ExitStack() as stack:
        with first:
            client = stack.enter_context(started(namespace, RESTART, EVERYWHERE))
            assert client.stdout is not None
            assert client.stdout.readline() == "enabled\n"
        engine = stack.enter_context(second)[0].engine
        eventually(lambda: engine.status.state == "DISABLED", "the new node is connected")
        go_on(client)
        eventually(lambda: "pause" in engine.health().last_refusal, "what was sent last has come")
        assert "pause is invalid in DISABLED" in engine.health().last_refusal
        assert sum(engine.health().refusals.values()) == 1, "nothing came before it"
        go_on(client)
        client.wait(LONG)
