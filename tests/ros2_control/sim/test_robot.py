"""The simulated robot without ROS: switches, what controllers keep, trajectories."""

import numpy as np
import pytest

from crtk_sim_backends.faults import check_fault
from crtk_sim_backends.ros2_control.controllers import (
    ForwardController,
    Point,
    TrajectoryController,
)
from crtk_sim_backends.ros2_control.injection import KINDS
from crtk_sim_backends.ros2_control.joints import JointLimits
from crtk_sim_backends.ros2_control.robot import BEST_EFFORT, HARDWARE, STRICT, Robot

P, V, E = (f"forward_{kind}_controller" for kind in ("position", "velocity", "effort"))
T = "joint_trajectory_controller"


def robot(keeps: bool = False) -> Robot:
    return Robot((JointLimits("a"), JointLimits("b")), keeps)


def active(one: Robot) -> list[str]:
    return [name for name, controller in one.controllers.items() if controller.state == "active"][
        1:
    ]


def inject(one: Robot, kind: str, **parameters: object) -> None:
    one.begin(check_fault(KINDS, kind, parameters, "test"))


def run(one: Robot, seconds: float) -> None:
    for _ in range(round(seconds / 0.01)):
        one.advance(0.01)


def test_a_strict_switch_is_all_or_nothing() -> None:
    one = robot()
    assert one.switch([P], [], STRICT) == (True, "")
    ok, why = one.switch([V], [], STRICT)
    assert not ok
    assert "Resource conflict" in why
    assert active(one) == [P]
    assert one.switch([V], [P], STRICT)[0]
    assert active(one) == [V]
    for activate, deactivate in (([V], []), ([], [P]), (["nobody"], [V])):
        assert not one.switch(activate, deactivate, STRICT)[0]
    assert active(one) == [V]


def test_a_best_effort_switch_does_what_can_be_done() -> None:
    one = robot()
    assert one.switch([P, "nobody"], [V], BEST_EFFORT)[0]
    assert active(one) == [P]
    assert not one.switch([V], [], BEST_EFFORT)[0]


def test_without_active_hardware_nothing_can_be_commanded() -> None:
    one = robot()
    one.switch([P], [], STRICT)
    inject(one, "hardware_error", to="inactive")
    assert active(one) == []
    assert one.broadcasts
    assert "hardware is inactive" in one.switch([P], [], STRICT)[1]
    assert one.set_hardware(HARDWARE, "active") == (True, "active")
    assert one.switch([P], [], STRICT)[0]
    inject(one, "hardware_error", to="finalized")
    assert not one.broadcasts
    assert one.set_hardware(HARDWARE, "active") == (False, "finalized")


@pytest.mark.parametrize("keeps", [False, True])
def test_a_forward_controller_keeps_its_command_for_ever(keeps: bool) -> None:
    one = robot(keeps)
    one.forward(V, [0.5, 0.0])  # while it is inactive
    one.switch([V], [], STRICT)
    run(one, 0.5)
    assert bool(one.joints.velocity[0] > 0.1) is keeps
    one.forward(V, [0.2, 0.0])
    run(one, 3.0)
    assert one.joints.velocity[0] == pytest.approx(0.2, abs=0.01)


def test_a_command_of_another_size_or_with_nan_is_ignored() -> None:
    one = robot()
    one.switch([V], [], STRICT)
    one.forward(V, [0.2, 0.0])
    for values in ([0.5], [0.5, 0.5, 0.5], [float("nan"), 0.5], []):
        one.forward(V, values)
    controller = one.controllers[V]
    assert isinstance(controller, ForwardController)
    assert controller.ignored == 4
    assert controller.command is not None
    assert controller.command.tolist() == [0.2, 0.0]


def test_a_trajectory_is_linear_without_velocities_and_cubic_with_them() -> None:
    one = robot()
    one.switch([T], [], STRICT)
    controller = one.controllers[T]
    assert isinstance(controller, TrajectoryController)
    here = one.joints.position.copy()
    for velocity, quarter in ((None, 0.25), (np.zeros(2), 0.15625)):
        controller.activated(here)
        controller.begin([Point(1.0, here + 1.0, velocity)], 0.0, here, np.zeros(2))
        found = controller.update(0.25, here)
        assert found is not None
        assert found - here == pytest.approx([quarter, quarter])


def test_a_goal_ends_once_and_is_replaced_by_another_one() -> None:
    one = robot()
    one.switch([T], [], STRICT)
    controller = one.controllers[T]
    assert isinstance(controller, TrajectoryController)
    ends: list[tuple[bool, str]] = []
    here = one.joints.position.copy()
    for _ in range(2):
        points = [Point(0.2, here + 0.1, np.zeros(2))]
        controller.begin(points, one.now, here, np.zeros(2), lambda *end: ends.append(end))
    run(one, 1.0)
    assert [reached for reached, _ in ends] == [False, True]
    one.switch([], [T], STRICT)
    assert len(ends) == 2
