"""A leader, an ideal follower and a pedal for the states of teleoperation, without ROS and clocks."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from crtk_drivers.geometry.quaternions import quaternion_from_rotvec, quaternion_product, unit
from crtk_drivers.motion.teleop import (
    Commands,
    Coupled,
    Heard,
    Inputs,
    Phase,
    Side,
    TeleopSettings,
    step,
)
from crtk_drivers.samples import JointState, Pose, Twist, vector
from crtk_drivers.state import OperatingState, Status

ENABLED = Status(OperatingState.ENABLED, True)
PERIOD = 0.005
REST = Twist(vector((0, 0, 0)), vector((0, 0, 0)))


def settings_of(**given: Any) -> TeleopSettings:
    pedals = {} if {"clutch", "engage"} & set(given) else {"engage": {"topic": "/pedal"}}
    return TeleopSettings(leader="hand", follower="arm", **pedals, **given)


def pose(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn: Any = (0.0, 0.0, 0.0)) -> Pose:
    return Pose(vector((x, y, z)), quaternion_from_rotvec(vector(turn)), "base")


def gripper(opening: float, now: float, setpoint: float | None = None) -> Side:
    """Return what is heard of one joint, which is where it was sent."""
    told, sent = (
        Heard(JointState(vector((each,))), now)
        for each in (opening, opening if setpoint is None else setpoint)
    )
    return Side("", None, joint=told, joint_setpoint=sent)


@dataclass
class Hand:
    """A leader, an ideal follower, and a pedal, stepped together."""

    settings: TeleopSettings
    leader: Pose = field(default_factory=pose)
    follower: Pose = field(default_factory=lambda: pose(0.5, 0.1, 0.3, (0.2, -0.4, 1.0)))
    now: float = 100.0
    pressed: bool = False
    coupled: Coupled = field(default_factory=Coupled)
    sent: list[Commands] = field(default_factory=list)
    grip: float = 0.0
    jaw: float = 0.0

    def inputs(self, **other: Any) -> Inputs:
        leader = Side("", ENABLED, Heard(self.leader, self.now), Heard(REST, self.now))
        follower = Side("", ENABLED, Heard(self.follower, self.now))
        heard = Inputs(
            self.now,
            leader,
            follower,
            engage=Heard(self.pressed, self.now),
            leader_gripper=gripper(self.grip, self.now),
            jaw=gripper(self.jaw, self.now),
        )
        return replace(heard, **other)

    def step(self, heard: Inputs | None = None) -> Commands:
        self.now += PERIOD
        self.coupled, commands = step(self.settings, self.coupled, heard or self.inputs())
        self.sent.append(commands)
        if isinstance(commands.follower, Pose):
            self.follower = commands.follower
        if commands.jaw is not None:
            self.jaw = commands.jaw
        return commands

    def steps(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD)):
            self.step()

    def engage(self) -> None:
        """Rest, press, and be coupled."""
        self.pressed = False
        self.steps(0.15)
        assert self.coupled.phase is Phase.RELEASED, self.coupled.reason
        self.pressed = True
        self.step()


def assert_same(one: Any, other: Pose) -> None:
    """To the last bit."""
    assert one.position.tolist() == other.position.tolist()
    assert one.orientation.tolist() == other.orientation.tolist()


def moved(start: Pose, way: tuple[Any, ...]) -> Pose:
    turned = quaternion_product(quaternion_from_rotvec(vector(way[3:6])), start.orientation)
    return Pose(vector(start.position + way[:3]), unit(turned), start.frame_id)
