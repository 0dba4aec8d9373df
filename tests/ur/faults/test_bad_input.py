"""Bad input to a UR arm: refused with a reason, told and counted, and nothing reaches the controller.

The inputs are those of the table I1 to I20 in the documentation that concern this driver.
"""

import math
import threading
import time

import numpy as np
import pytest

from crtk_drivers.errors import CommandRefused, MotionAborted
from crtk_drivers.samples import JointState, Pose, Twist, vector
from rigs.ur_bench import HOME, LENIENT, LONG, UrBench, driver_at, eventually, ur_bench

NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
NAN, INF = math.nan, math.inf
SERVO, MOVE = ("servo_jp", "servo_jr"), ("move_jp", "move_jr")
UNIT = (0.0, 0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def shared():
    # A client that is held up has not stopped its stream, to begin another.
    with ur_bench({"mode_switch_dwell": LENIENT}) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    return shared


def near(**changes: float) -> list[float]:
    """HOME with joints replaced: near(j2=1.0)."""
    return [changes.get(f"j{i}", q) for i, q in enumerate(HOME)]


def joints(values, name=()) -> JointState:
    return JointState(position=vector(values), name=tuple(name))


def pose(position=(-0.4, -0.2, 0.3), orientation=UNIT, frame_id="") -> Pose:
    return Pose(vector(position), vector(orientation), frame_id)


def twist(*values: float, frame_id="") -> Twist:
    return Twist(vector(values[:3]), vector(values[3:]), frame_id)


REFUSED = [
    # I1
    *((name, near(j2=NAN), "not_finite") for name in (*SERVO, *MOVE, "servo_jv")),
    *((name, near(j5=-INF), "not_finite") for name in (*SERVO, *MOVE, "servo_jv")),
    ("servo_cp", pose((NAN, 0.0, 0.0)), "not_finite"),
    ("move_cp", pose(orientation=(0.0, NAN, 0.0, 1.0)), "not_finite"),
    ("servo_cv", twist(0.0, INF, 0.0, 0.0, 0.0, 0.0), "not_finite"),
    # I2
    *((name, [0.0] * 5, "wrong_size") for name in (*SERVO, *MOVE, "servo_jv")),
    *((name, [0.0] * 7, "wrong_size") for name in (*SERVO, *MOVE, "servo_jv")),
    ("servo_cv", [0.0] * 5, "wrong_type"),
    ("servo_cp", [0.0] * 6, "wrong_type"),
    # I3
    *((name, [], "empty") for name in (*SERVO, *MOVE, "servo_jv")),
    ("servo_jp", JointState(velocity=vector([0.0] * 6)), "empty"),
    # I4
    ("servo_jp", joints(HOME, ("elbow", *NAMES[1:])), "wrong_names"),
    ("servo_jp", joints(HOME, (NAMES[1], *NAMES[1:])), "wrong_names"),
    ("move_jp", joints(HOME[:5], NAMES[:5]), "wrong_size"),
    # I6, I7
    ("servo_cp", pose(orientation=(0.0, 0.0, 0.0, 0.0)), "bad_quaternion"),
    ("move_cp", pose(orientation=(0.0, 0.0, 0.0, 1.01)), "bad_quaternion"),
    # I8
    ("move_jp", near(j0=7.0), "out_of_range"),
    ("move_jr", [7.0, 0.0, 0.0, 0.0, 0.0, 0.0], "out_of_range"),
    ("servo_jv", [9.0, 0.0, 0.0, 0.0, 0.0, 0.0], "out_of_range"),
    ("servo_cv", twist(9.0, 0.0, 0.0, 0.0, 0.0, 0.0), "out_of_range"),
    # I9
    ("servo_jp", near(j0=1.0), "step_too_large"),
    # I10
    ("servo_cp", pose(frame_id="world"), "wrong_frame"),
    ("servo_cv", twist(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, frame_id="tool0"), "wrong_frame"),
    # of another kind altogether
    ("servo_jp", "home", "wrong_type"),
    ("servo_jp", None, "wrong_type"),
    ("move_jp", pose(), "wrong_type"),
    ("move_cp", joints(HOME), "wrong_type"),
]


def test_every_bad_value_is_refused_and_nothing_is_sent(bench):
    with bench.nothing_sent():
        for name, value, reason in REFUSED:
            try:
                with bench.refused(reason, name):
                    getattr(bench.arm, name)(value)
            except BaseException as error:
                error.add_note(f"{name}({value!r}) was to be refused: {reason}")
                raise
            assert bench.status.state == "ENABLED"
    counted = sum(bench.arm.health().refusals.values())
    assert counted >= len(REFUSED)
    assert bench.arm.move_jp(near(j0=0.1)).wait(LONG), "the driver goes on"


@pytest.mark.parametrize("command", ["servo_jp", "servo_jr", "servo_jv", "move_jp", "move_jr"])
def test_a_permutation_of_the_names_is_put_in_order(bench, command):
    order = [3, 0, 5, 1, 4, 2]
    name = tuple(NAMES[i] for i in order)
    values = {
        "servo_jp": near(j0=0.02),
        "servo_jr": [0.02, 0.0, 0.0, 0.0, 0.0, 0.0],
        "servo_jv": [0.1, 0.0, 0.0, 0.0, 0.0, 0.0],
        "move_jp": near(j0=0.05),
        "move_jr": [0.05, 0.0, 0.0, 0.0, 0.0, 0.0],
    }[command]
    numbers = vector([values[i] for i in order])
    kind = "velocity" if command == "servo_jv" else "position"
    getattr(bench.arm, command)(JointState(**{kind: numbers}, name=name))
    eventually(lambda: bench.q()[0] > 0.003, "the first joint moves")
    bench.until_still()
    np.testing.assert_allclose(bench.q()[1:], HOME[1:], atol=1e-3)


def test_i5_names_may_be_left_out_and_i7_quaternions_a_little_off(bench):
    bench.arm.servo_jp(JointState(position=vector(near(j0=0.005))))
    eventually(lambda: abs(bench.q()[0] - 0.005) < 1e-4, "the position is reached")
    bench.arm.hold()
    goal = bench.arm.setpoint_cp()
    off = Pose(goal.position, vector(goal.orientation * 1.0005), "")
    assert bench.arm.move_cp(off).wait(LONG)
    assert math.isclose(np.linalg.norm(bench.arm.goal_cp().orientation), 1.0, rel_tol=1e-12)


@pytest.mark.slow  # tests of the engine have it of any device
def test_i8_a_servo_position_out_of_range_is_clamped_and_told(bench):
    limit = bench.engine.capabilities.limits[2].upper
    assert bench.arm.move_jp(near(j2=limit - 0.003)).wait(LONG)
    bench.arm.servo_jp(near(j2=limit + 0.003))
    eventually(lambda: abs(bench.q()[2] - limit) < 1e-3, "the limit is reached")
    assert math.isclose(bench.arm.setpoint_jp()[2], limit)
    assert bench.arm.health().clamped == 1
    assert any("clamped" in text for text in bench.log.warnings)
    assert bench.status.state == "ENABLED"
    bench.go_home()


def test_i8_i11_what_is_refused_if_so_configured(bench):
    bench.arm.pause(timeout=LONG)
    bench.sim.control.inject("stop_program")
    bench.arm.disable(timeout=LONG)
    config = {
        "limits": {"clamp_servo": False, "max_command_age": LONG},
        "upper_range_registers": True,
    }
    with driver_at(bench.sim, config) as strict:
        strict.enable()
        now, far = time.time_ns(), 10**12
        value = JointState(position=vector(HOME))
        with strict.nothing_sent():
            with strict.refused("out_of_range", "servo_jp"):
                strict.arm.servo_jp(near(j0=7.0))
            with strict.refused("too_old"):
                strict.engine.submit("servo_jp", value, now - far)
            with strict.refused("from_future"):
                strict.engine.submit("move_jp", value, now + far)
        strict.engine.submit("servo_jp", value, time.time_ns())
        strict.engine.submit("servo_jp", value, 0)
        assert strict.status.state == "ENABLED"


@pytest.mark.parametrize("state", ["DISABLED", "PAUSED", "FAULT"])
def test_i12_no_motion_unless_enabled(bench, state):
    if state == "DISABLED":
        bench.arm.disable(timeout=LONG)
    elif state == "PAUSED":
        bench.arm.pause(timeout=LONG)
    else:
        bench.sim.control.inject("emergency_stop")
    bench.until_state(state)
    good = {
        "servo_jp": HOME,
        "servo_jr": [0.01] * 6,
        "servo_jv": [0.1] * 6,
        "servo_cp": bench.arm.measured_cp(),
        "servo_cv": [0.1] * 6,
        "move_jp": near(j0=0.5),
        "move_jr": [0.5] * 6,
        "move_cp": bench.arm.measured_cp(),
    }
    with bench.nothing_moves():
        mark = bench.mark()
        for name, value in good.items():
            with bench.refused("not_enabled", name):
                getattr(bench.arm, name)(value)
        with bench.refused("not_enabled", "free"):
            bench.arm.free()
        bench.arm.hold()
        assert bench.watch(0.2) < 1e-3
        assert bench.sent_since(mark) == []
    assert bench.status.state == state
    # Nothing of what was refused waits for the state in which it would be accepted.
    bench.sim.control.clear()
    with bench.nothing_moves():
        bench.enable()
        assert bench.watch(0.2) < 1e-3


@pytest.mark.parametrize(
    "text", ["", "Enable", "ENABLED", " enable", "enable\n", "reset", "enable\0", "x" * 10_000]
)
def test_i13_only_exact_state_commands(bench, text):
    with bench.nothing_sent(), bench.refused("unknown_command", "state_command"):
        bench.arm.state_command(text)
    refusal = bench.log.refusals[-1]
    assert "disable" in str(refusal), "the valid ones are listed"
    assert len(str(refusal)) < 500
    assert bench.status.state == "ENABLED"


def test_i13_a_command_that_the_state_does_not_have(bench):
    with bench.refused("invalid_transition", "state_command"):
        bench.arm.resume()
    bench.arm.disable(timeout=LONG)
    with bench.refused("invalid_transition", "state_command"):
        bench.arm.pause()
    assert bench.status.state == "DISABLED"


def test_i14_of_a_flood_the_newest_wins(bench):
    """As fast as three threads can; the arm must follow without a backlog and end at the last.

    All of it is so near that whoever was held up may begin the stream anew with what it has.
    """
    count, mark = 3000, bench.mark()
    failures: list[BaseException] = []

    def flood(first: int) -> None:
        try:
            for i in range(first, count, 3):
                bench.arm.servo_jp(near(j0=0.02 * i / count))
        except CommandRefused as refusal:
            failures.append(refusal)

    threads = [threading.Thread(target=flood, args=(i,)) for i in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    setpoints = bench.arm.health().setpoints
    bench.arm.servo_jp(near(j0=0.005))
    eventually(lambda: abs(bench.q()[0] - 0.005) < 1e-3, "the last position is reached")
    assert bench.arm.health().setpoints <= setpoints + 2, "nothing was queued"
    assert len(bench.sent_since(mark)) < count
    assert bench.status.state == "ENABLED"


def test_i14_of_a_flood_of_moves_the_last_one_arrives(bench):
    # So far away that none arrives because who sends the next was held up.
    moves = [bench.arm.move_jp(near(j0=2.5 * (-1) ** i)) for i in range(300)]
    last = bench.arm.move_jp(near(j0=0.1))
    assert last.wait(LONG)
    np.testing.assert_allclose(bench.q(), near(j0=0.1), atol=1e-3)
    for move in moves:
        with pytest.raises(MotionAborted, match="pre-empted"):
            move.wait(LONG)
    assert bench.arm.wait_for_busy(False, LONG)


def test_i15_a_refused_move_leaves_the_running_one_and_busy_alone(bench):
    move = bench.arm.move_jp(near(j0=0.8))
    bench.until_moving()
    with bench.refused("out_of_range", "move_jp"):
        bench.arm.move_jp(near(j0=7.0))
    with bench.refused("unreachable", "move_cp"):
        bench.arm.move_cp(pose((3.0, 0.0, 0.0)))
    assert bench.arm.is_busy() or not move.is_busy()
    assert move.wait(LONG)
    np.testing.assert_allclose(bench.q(), near(j0=0.8), atol=1e-3)
    np.testing.assert_allclose(bench.arm.goal_jp(), near(j0=0.8))
    assert bench.arm.wait_for_busy(False, LONG)


def test_i15_busy_rises_and_falls_for_a_refused_move(bench):
    with bench.refused("out_of_range"):
        bench.arm.move_jp(near(j0=7.0))
    assert [status.is_busy for status in bench.log.statuses] == [True, False]


def test_i16_two_kinds_of_stream_do_not_alternate(bench):
    with bench.nothing_moves():
        for _ in range(20):
            bench.arm.servo_jp(HOME)
            with bench.refused("mode_switch", "servo_jv"):
                bench.arm.servo_jv([0.5] * 6)
            time.sleep(0.005)
        assert bench.watch(0.1) < 1e-3


@pytest.mark.parametrize(
    ("query", "arguments"),
    [
        ("forward_kinematics", ([0.0] * 5,)),
        ("forward_kinematics", ([],)),
        ("forward_kinematics", ([NAN] * 6,)),
        ("inverse_kinematics", (pose((NAN, 0.0, 0.0)),)),
        ("inverse_kinematics", (pose(orientation=(0.0,) * 4),)),
        ("inverse_kinematics", (pose(), [0.0] * 7)),
        ("inverse_kinematics", (pose(), [INF] * 6)),
    ],
)
def test_i20_bad_kinematics_queries(bench, query, arguments):
    with bench.nothing_sent(), pytest.raises(CommandRefused, match=query):
        getattr(bench.arm, query)(*arguments)
    assert bench.arm.forward_kinematics(HOME).frame_id == "base"
