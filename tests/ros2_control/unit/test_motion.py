"""What the controllers are made to do, by a node that is scripted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pytest

pytest.importorskip("rclpy")

from crtk_driver_ros2_control.arm import load_arm
from crtk_driver_ros2_control.asking import Asked, Delivery, Following, Told
from crtk_driver_ros2_control.config import Ros2ControlConfig
from crtk_driver_ros2_control.controllers import Component, Controller, Role, roles_of
from crtk_driver_ros2_control.joint_states import Measured
from crtk_driver_ros2_control.motion import Motion
from crtk_driver_ros2_control.outgoing import Outgoing
from crtk_driver_ros2_control.supervision import Supervision
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import TransitionFailed
from crtk_drivers.samples import JointState, vector
from crtk_drivers.state import OperatingState

pytestmark = pytest.mark.ros

JOINTS = ("a", "b")
KINDS = {"p": "position", "v": "velocity", "other": "velocity"}


class Node:
    """A manager with controllers, and what was asked of it and sent to them, in order."""

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self.active: set[str] = set()
        self.silent: set[str] = set()
        self.unanswered: list[Callable[[], None]] = []
        self.listeners = 1
        self.events: list[tuple[str, Any]] = []

    def wake(self) -> None:
        """Nothing sleeps."""

    def command(self, controller: str, values: Sequence[float]) -> None:
        self.events.append((controller, list(values)))

    def point(self, joints: Sequence[str], positions: Sequence[float], seconds: float) -> None:
        self.events.append(("point", list(positions)))

    def follow(self, goal: Following) -> None:
        self.events.append(("goal", goal))

    def cancel(self, goal: Following) -> None:
        goal.has_ended = True

    def delivery(self, controller: str) -> Asked[Delivery]:
        return Asked(controller, self._now(), Delivery(self.listeners, True))

    def forget(self, asked: Asked[Any]) -> None:
        """Nobody waits."""

    def ask(self, service: str, kind: Any, fields: Mapping[str, Any], read: Any) -> Asked[Any]:
        asked: Asked[Any] = Asked(service, self._now())
        name = service.rpartition("/")[2]

        def answer() -> None:
            asked.answer = getattr(self, f"_{name}")(fields)

        if name in self.silent:
            self.unanswered.append(answer)
        else:
            answer()
        return asked

    def _list_controllers(self, fields: Mapping[str, Any]) -> dict[str, Controller]:
        needs = {name: frozenset(f"{j}/{kind}" for j in JOINTS) for name, kind in KINDS.items()}
        states = {name: "active" if name in self.active else "inactive" for name in KINDS}
        return {
            name: Controller(
                name, states[name], "", need if name in self.active else frozenset(), need
            )
            for name, need in needs.items()
        }

    def _list_hardware_components(self, fields: Mapping[str, Any]) -> dict[str, Component]:
        return {"system": Component("system", "active")}

    def _get_parameters(self, fields: Mapping[str, Any]) -> tuple[str, ...]:
        return JOINTS

    def _switch_controller(self, fields: Mapping[str, Any]) -> Told:
        self.events.append(("switch", list(fields["activate_controllers"])))
        self.active -= set(fields["deactivate_controllers"])
        self.active |= set(fields["activate_controllers"])
        return Told(True, "")


class Stepped:
    """A robot of two joints, and the time."""

    def __init__(self, **values: Any) -> None:
        self.now = 1000.0
        config = Ros2ControlConfig(
            controller_manager="/controller_manager",
            joints=[{"name": name, "acceleration": 100.0} for name in JOINTS],
            position_controller="p",
            velocity_controller="v",
            allow_untimed=True,
            **values,
        )
        arm, roles = load_arm(config), roles_of(config)
        ones = vector([1.0, 1.0])
        self.node = Node(lambda: self.now)
        self.out = Outgoing(roles, JOINTS, ones, vector(100.0 * ones), 0.01, lambda: self.now)
        self.out.wire = self.node
        self.out.orders = dict.fromkeys(roles, (0, 1))
        self.here: Measured | None = None
        self.supervision = Supervision(config, roles, JOINTS, self.node)
        self.motion = Motion(config, arm, roles, self.out, lambda: self.here, "/robot")
        self.motion.connect(self.node, self.supervision)

    def see(self, *position: float, velocity: Sequence[float] = (0.0, 0.0)) -> None:
        """Joint states come."""
        self.tick()
        state = JointState(vector(position), vector(velocity), (), JOINTS)
        self.here = Measured(state, self.now, self.now)
        self.motion.settle(self.here)
        self.tick()

    def tick(self) -> None:
        self.now += 0.005
        self.out.pump()

    def enable(self) -> None:
        for _ in self.motion.enable():
            self.tick()

    def follow(self, mode: Mode, *values: float) -> None:
        self.motion.follow(Setpoint(mode, vector(values)))
        for _ in range(20):
            self.motion.step()
            self.tick()


@pytest.fixture
def stepped(monkeypatch: pytest.MonkeyPatch) -> Stepped:
    """A robot whose joint states have come."""
    made = Stepped()
    monkeypatch.setattr("time.monotonic", lambda: made.now)
    made.see(0.1, 0.2)
    return made


def test_a_controller_has_what_it_is_to_hold_before_it_is_activated(stepped: Stepped) -> None:
    stepped.enable()
    kinds = [kind for kind, _ in stepped.node.events]
    assert kinds[:2] == ["p", "switch"]
    assert stepped.node.events[0][1] == [0.1, 0.2]


def test_a_controller_that_does_not_listen_is_not_activated(stepped: Stepped) -> None:
    stepped.node.listeners = 0
    with pytest.raises(TransitionFailed, match="p does not listen"):
        stepped.enable()
    assert stepped.node.events == []


def test_a_stop_of_velocities_is_not_believed_before_the_joints_stand(stepped: Stepped) -> None:
    stepped.enable()
    stepped.follow(Mode.JOINT_VELOCITY, 0.5, 0.0)
    assert stepped.motion.role is Role.VELOCITY
    stepped.motion.stop()
    for _ in range(10):
        stepped.tick()
    stepped.see(0.1, 0.2, velocity=(0.5, 0.0))
    assert stepped.out.is_at_rest
    assert not stepped.motion.has_stopped
    stepped.see(0.1, 0.2)
    assert stepped.motion.has_stopped


def test_joints_that_do_not_tell_velocities_stand_when_positions_do(stepped: Stepped) -> None:
    stepped.enable()
    stepped.motion.stop()
    for position in (0.10, 0.11, 0.12):
        stepped.see(position, 0.2, velocity=())
    assert not stepped.motion.takes_setpoints
    stepped.see(0.12, 0.2, velocity=())
    assert stepped.motion.takes_setpoints


def test_joints_that_sag_are_followed_once(stepped: Stepped) -> None:
    stepped.enable()
    stepped.follow(Mode.JOINT_POSITION, 0.1, 0.2)
    stepped.motion.stop()
    for _ in range(10):
        stepped.tick()
    held = [0.2]
    for _ in range(5):
        stepped.see(0.1, held[-1] - 0.05)  # what gravity takes
        held.append(stepped.node.events[-1][1][1])
    assert min(held) == pytest.approx(0.15)


def test_somebody_elses_controller_of_the_same_joints_beside_ours_is_told(stepped: Stepped) -> None:
    stepped.enable()
    stepped.node.active.add("other")
    for _ in range(3):
        stepped.now += 0.3
        stepped.supervision.look(stepped.now)
    condition = stepped.motion.condition
    assert condition.allows is OperatingState.PAUSED
    assert condition.reason == "other has the joints, too"


def test_an_answer_that_was_lost_is_asked_for_again_of_what_changes_nothing(
    stepped: Stepped,
) -> None:
    stepped.node.silent = {"list_controllers", "get_parameters"}
    listed, orders = stepped.supervision.listed(), stepped.supervision.orders()
    next(listed)
    next(orders)
    stepped.node.silent = set()
    for steps in (listed, orders):
        for _ in steps:
            stepped.now += 0.2
            assert stepped.now < 1010.0
    assert len(stepped.node.unanswered) == 2, "and others are not repeated"


def test_one_service_that_falls_silent_is_told_though_others_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    stepped = Stepped(hardware=["system"], service_timeout=1.0)
    monkeypatch.setattr("time.monotonic", lambda: stepped.now)
    stepped.node.silent.add("list_hardware_components")
    for _ in range(10):
        stepped.now += 0.3
        stepped.supervision.look(stepped.now)
    assert stepped.motion.condition.allows is OperatingState.FAULT
    assert "list_hardware_components: no answer" in stepped.motion.condition.reason


def test_a_switch_that_was_given_up_is_waited_for_before_controllers_are_made_inactive(
    stepped: Stepped,
) -> None:
    stepped.node.silent.add("switch_controller")
    enabling = stepped.motion.enable()
    while not stepped.node.unanswered:
        next(enabling)
        stepped.tick()
    enabling.close()
    disabling = stepped.motion.disable()
    for _ in range(5):
        next(disabling, None)
        stepped.tick()
    stepped.node.silent.clear()
    stepped.node.unanswered.pop()()
    assert stepped.node.active == {"p"}
    for _ in disabling:
        stepped.tick()
    assert stepped.node.active == set()
