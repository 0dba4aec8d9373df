"""Tool centre point, gravity and payload of the UR driver at run time, in both ways of control."""

import socket
from collections.abc import Iterator

import numpy as np
import pytest

from crtk_driver_ur.frames import Transform
from crtk_driver_ur.kinematics import ArmKinematics
from crtk_driver_ur.models import model_named
from crtk_driver_ur.native.program import Setting
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import Pose, vector
from rigs.ur_bench import FAR, HOME, LONG, WAYS, UrBench, eventually, ur_bench

pytestmark = pytest.mark.sweep(3)

TOOL = (0.05, -0.02, 0.2, 0.0, 0.6, 0.0, 0.8)
"""Position, and quaternion x, y, z, w."""
NONE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
SHORT = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0)


def transform(tool) -> Transform:
    return Transform.from_quaternion(tool[:3], tool[3:])


def expected(q, tool) -> Transform:
    return ArmKinematics(model_named("ur5e"), transform(tool)).place(list(q))


def assert_at(pose: Pose, wanted: Transform, atol: float = 1e-6) -> None:
    found = Transform.from_quaternion(pose.position.tolist(), pose.orientation.tolist())
    np.testing.assert_allclose(found, wanted, atol=atol)


def of_controller(bench: UrBench) -> Transform:
    return Transform.from_pose_vector(bench.outputs("tcp_offset"))


def taken(bench: UrBench, tool) -> bool:
    try:
        bench.arm.tcp(tool)
    except CommandRefused:
        return False
    return True


def until_tool(bench: UrBench, tool) -> None:
    eventually(lambda: np.allclose(of_controller(bench), transform(tool), atol=1e-6), "the tool")


@pytest.fixture(scope="module", params=WAYS)
def shared(request) -> Iterator[UrBench]:
    with ur_bench({"control": request.param}) as bench:
        yield bench


@pytest.fixture
def bench(shared: UrBench) -> UrBench:
    shared.reset()
    shared.arm.tcp(NONE)
    until_tool(shared, NONE)
    return shared


def problems(bench: UrBench) -> dict[str, str]:
    return {note.key: note.text for note in bench.engine.health().notes if note.severity > 0}


# Tool


def test_a_tool_counts_at_once_and_the_arm_does_not_move(bench):
    with bench.nothing_moves():
        bench.arm.tcp(TOOL)
        assert_at(bench.arm.forward_kinematics(HOME), expected(HOME, TOOL))
        until_tool(bench, TOOL)
        bench.cycles(2)  # the first of these may have been on its way
    wanted = expected(bench.q(), TOOL)
    np.testing.assert_allclose(
        Transform.from_pose_vector(bench.outputs("actual_TCP_pose")), wanted, atol=1e-6
    )
    assert_at(bench.arm.measured_cp(age=0.01), wanted, 1e-4)
    assert_at(bench.arm.setpoint_cp(age=0.01), wanted, 1e-4)
    eventually(lambda: np.allclose(bench.arm.state.tcp().position, TOOL[:3]), "it is told")
    assert bench.arm.state.tcp().frame_id == "flange"
    assert problems(bench) == {}


def test_a_held_joint_position_stays_and_its_pose_is_that_of_the_new_tool(bench):
    goal = [0.005, *HOME[1:]]
    bench.arm.servo_jp(goal)
    eventually(lambda: abs(bench.q()[0] - goal[0]) < 1e-5, "it is there")
    bench.until_still()
    with bench.nothing_moves():
        eventually(lambda: taken(bench, TOOL), "the stream has ended")
        until_tool(bench, TOOL)
        np.testing.assert_allclose(bench.arm.setpoint_js().position, goal, atol=1e-6)
        assert_at(bench.arm.setpoint_cp(), expected(goal, TOOL), 1e-4)


def test_the_pose_that_is_held_is_that_of_a_tool_which_somebody_gives_the_controller():
    with ur_bench() as bench:
        bench.enable()
        goal = vector(bench.arm.setpoint_jp() + np.array((0.005, 0, 0, 0, 0, 0)))
        bench.arm.servo_jp(goal)
        eventually(lambda: abs(bench.q()[0] - goal[0]) < 1e-5, "it is there")
        bench.until_still()
        assert_at(bench.arm.setpoint_cp(), expected(goal, NONE), 1e-4)
        tool = ", ".join(map(str, transform(TOOL).pose_vector()))
        with socket.create_connection((bench.sim.host, 30002), LONG) as peer:
            peer.sendall(f"sec somebody():\n set_tcp(p[{tool}])\nend\n".encode())
            until_tool(bench, TOOL)
            wanted = expected(goal, TOOL)
            eventually(
                lambda: np.allclose(bench.arm.setpoint_cp().position, wanted.position, atol=1e-4),
                "the pose of that tool",
            )
        assert_at(bench.arm.setpoint_cp(), wanted, 1e-4)
        np.testing.assert_allclose(bench.arm.setpoint_jp(), goal)


def test_a_line_that_is_sent_with_the_tool_waits_for_the_controller_to_have_it(bench):
    """The controller has the tool after some cycles; the command is there in the next one."""
    q = np.array([0.2, *HOME[1:]])
    goal = expected(q, TOOL)
    pose = Pose(vector(goal.position), vector(goal.quaternion()))
    bench.arm.tcp(TOOL)
    move = bench.arm.move_cp(pose)
    assert move.wait(LONG)
    np.testing.assert_allclose(bench.q(), q, atol=1e-3)
    assert_at(bench.arm.measured_cp(), goal, 1e-3)


def test_streams_and_relative_moves_are_of_the_new_tool(bench):
    bench.arm.tcp(SHORT)
    start = expected(bench.q(), SHORT)
    turn = np.array([0.0, np.sin(0.1), 0.0, np.cos(0.1)])
    assert bench.arm.move_cr(Pose(vector((0, 0, 0)), vector(turn))).wait(LONG)
    # The arm turned about the tip of its tool.
    np.testing.assert_allclose(expected(bench.q(), SHORT).position, start.position, atol=1e-4)
    flange = expected(bench.q(), NONE).position
    assert np.linalg.norm(np.subtract(flange, expected(HOME, NONE).position)) > 0.01


def test_a_tool_is_refused_while_the_arm_moves(bench):
    bench.arm.move_jp(FAR)
    bench.until_moving()
    with bench.refused(Reason.INVALID_TRANSITION, "tcp"):
        bench.arm.tcp(TOOL)
    bench.arm.hold()
    bench.until_still()
    assert_at(bench.arm.forward_kinematics(HOME), expected(HOME, NONE))
    assert np.allclose(of_controller(bench), transform(NONE))


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ((0.0, 0.0, 6.0, 0.0, 0.0, 0.0, 1.0), Reason.OUT_OF_RANGE),
        ((0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.0), Reason.OUT_OF_RANGE),
        ((0.0, 0.0, float("nan"), 0.0, 0.0, 0.0, 1.0), Reason.NOT_FINITE),
        ((0.0, 0.0, 0.1), Reason.WRONG_TYPE),
        (Pose(vector((0, 0, 0.1)), vector((0, 0, 0, 1)), "base"), Reason.WRONG_FRAME),
    ],
)
def test_a_tool_that_cannot_be_is_refused(bench, value, reason):
    with bench.refused(reason, "tcp"):
        bench.arm.tcp(value)
    assert_at(bench.arm.forward_kinematics(HOME), expected(HOME, NONE))


@pytest.mark.real_time  # the vendor's library
def test_what_is_given_before_enable_is_sent_by_it():
    for control in WAYS:
        with ur_bench({"control": control, "tcp": [0.0, 0.0, 0.3, 0.0, 0.0, 0.0]}) as bench:
            bench.arm.tcp(TOOL)
            bench.arm.gravity([0.0, 6.2, 7.6])
            bench.arm.payload([2.0, 0.0, 0.01, 0.05])
            # The controller has another one still; what is told is of ours.
            assert np.allclose(of_controller(bench), transform(NONE))
            q = bench.q()
            eventually(
                lambda b=bench, q=q: np.allclose(
                    b.arm.measured_cp().position, expected(q, TOOL).position, atol=1e-4
                ),
                "ours",
            )
            bench.arm.enable(timeout=LONG)
            until_tool(bench, TOOL)
            eventually(lambda b=bench: b.outputs("target_gravity")[1] == 6.2, "gravity")
            eventually(lambda b=bench: b.outputs("payload") == 2.0, "payload")
            assert problems(bench) == {}


# Gravity and payload


def test_gravity_is_set_at_rest(bench):
    bench.arm.gravity([0.0, 0.0, 9.81])
    eventually(lambda: bench.outputs("target_gravity") == [0.0, 0.0, 9.81], "gravity")
    bench.arm.gravity([0.0, 0.0, 9.82])
    eventually(lambda: bench.outputs("target_gravity") == [0.0, 0.0, 9.82], "gravity")


@pytest.mark.parametrize(
    ("name", "value"),
    [("gravity", [0.0, 0.0, 9.81]), ("payload", [1.0]), ("payload_mass", 1.0)],
)
def test_what_balances_the_arm_is_refused_while_it_moves(bench, name, value):
    before = bench.outputs("target_gravity"), bench.outputs("payload")
    bench.arm.move_jp(FAR)
    bench.until_moving()
    with bench.refused(Reason.INVALID_TRANSITION, name):
        getattr(bench.arm, name)(value)
    bench.arm.hold()
    bench.until_still()
    assert (bench.outputs("target_gravity"), bench.outputs("payload")) == before


def test_a_move_waits_for_the_payload_that_was_given_before_it(bench):
    mark = bench.mark()
    bench.arm.payload_mass(2.5)
    move = bench.arm.move_jp([0.2, *HOME[1:]])
    assert move.wait(LONG)
    assert bench.outputs("payload") == 2.5
    if bench.control == "native":
        sent = [entry["values"] for entry in bench.sim.control.trace(after=mark)]
        first = next(i for i, values in enumerate(sent) if values.get("input_int_register_2"))
        assert any(values.get("input_int_register_3") for values in sent[:first])
    bench.arm.payload([0.0])
    eventually(lambda: bench.outputs("payload") == 0.0, "none")


def test_free_waits_for_tool_and_payload_that_were_given_before_it(bench):
    def in_one_cycle() -> None:
        bench.engine.on_sample = None
        bench.arm.tcp(TOOL)
        bench.arm.payload_mass(2.5)
        bench.arm.free()

    mark = bench.mark()
    bench.engine.on_sample = in_one_cycle
    eventually(lambda: bench.outputs("payload") == 2.5, "it has the payload")
    if bench.control == "native":
        kind = "input_int_register_2"

        def sent():
            return [entry["values"] for entry in bench.sim.control.trace(after=mark)]

        eventually(lambda: any(values.get(kind) for values in sent()), "it is let go")
        first = next(i for i, values in enumerate(sent()) if values.get(kind))
        settings = {values.get("input_int_register_4") for values in sent()[:first]}
        assert settings >= {Setting.TCP, Setting.PAYLOAD}
    bench.arm.hold()
    eventually(lambda: bench.engine.is_at_rest, "it holds")
    bench.arm.payload([0.0])
    eventually(lambda: bench.outputs("payload") == 0.0, "none")


def test_payload_with_centre_and_inertia(bench):
    bench.arm.payload([1.5, 0.01, 0.02, 0.03])
    eventually(lambda: bench.outputs("payload") == 1.5, "the mass")
    assert bench.outputs("payload_cog") == pytest.approx([0.01, 0.02, 0.03])
    inertia = [0.01, 0.02, 0.03, 0.001, 0.0, 0.0]
    bench.arm.payload([1.75, 0.0, 0.0, 0.04, *inertia])
    eventually(lambda: bench.outputs("payload") == 1.75, "the mass")
    assert bench.outputs("payload_inertia") == pytest.approx(inertia)
    bench.arm.payload_mass(1.25)
    eventually(lambda: bench.outputs("payload") == 1.25, "the mass alone")
    assert bench.outputs("payload_cog") == pytest.approx([0.0, 0.0, 0.04])
    eventually(lambda: bench.arm.state.payload() == (1.25, 0.0, 0.0, 0.04), "it is told")
    assert bench.arm.state.payload_mass() == 1.25
    bench.arm.payload([0.5, 0.0, 0.0, 0.0])
    eventually(lambda: bench.outputs("payload") == 0.5, "the mass")
    assert bench.outputs("payload_cog") == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    bench.arm.payload([0.0])
    eventually(lambda: bench.outputs("payload") == 0.0, "none")
    eventually(lambda: not bench.device._inputs.is_changing("payload"), "taken")
    assert problems(bench) == {}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("payload", []),
        ("payload", [1.0, 0.0]),
        ("payload", [-1.0]),
        ("payload", [5.1, 0.0, 0.0, 0.0]),
        ("payload_mass", 50.0),
        ("payload", [4.0, 0.0, 0.0, 0.9]),
        ("payload", [0.1, 0.0, 0.0, 1.1]),
        ("payload", [1.0, 0.0, 0.0, 0.1, -0.01, 0.01, 0.01, 0.0, 0.0, 0.0]),
        ("payload", [1.0, 0.0, 0.0, 0.1, 0.01, 0.01, 0.05, 0.0, 0.0, 0.0]),
        ("payload", [1.0, 0.0, 0.0, 0.1, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0]),
        ("gravity", [0.0, 9.82, 0.0]),
        ("gravity", [0.0, 0.0, -9.82]),
        ("gravity", [0.0, 0.0, 8.0]),
        ("gravity", [9.82]),
        ("gravity", [0.0, 15.0, 15.0]),
    ],
)
def test_numbers_that_cannot_be_are_refused(bench, name, value):
    with bench.refused(Reason.OUT_OF_RANGE, name):
        getattr(bench.arm, name)(value)


@pytest.mark.parametrize(("model", "version"), [("ur5", "3.15.8"), ("ur5", "3.8.0")])
@pytest.mark.parametrize("control", WAYS)
def test_other_generations(control, model, version):
    with ur_bench({"control": control}, model=model, version=version) as bench:
        bench.arm.enable(timeout=LONG)
        bench.arm.payload([1.0, 0.0, 0.0, 0.05, 0.01, 0.01, 0.01, 0.0, 0.0, 0.0])
        bench.arm.tcp(SHORT)
        eventually(lambda: not bench.device._inputs.is_changing("tcp"), "taken")
        eventually(lambda: not bench.device._inputs.is_changing("payload"), "taken")
        assert bench.status.state == "ENABLED"
        assert problems(bench) == {}
