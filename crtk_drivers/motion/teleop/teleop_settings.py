"""The table ``[teleop]`` of a lab file: who leads, who follows, how, and by which pedals."""

from __future__ import annotations

import re
from functools import cached_property
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from crtk_drivers.config import Settings
from crtk_drivers.geometry.quaternions import quaternion_from_rpy
from crtk_drivers.samples import Vector

Mode = Literal["position", "rate", "velocity"]
Orientation = Literal["relative", "aligned", "locked"]
Translation = Literal["follows", "locked"]

Positive = Annotated[float, Field(gt=0.0, le=1000.0)]
Angles = tuple[
    Annotated[float, Field(ge=-7.0, le=7.0)],
    Annotated[float, Field(ge=-7.0, le=7.0)],
    Annotated[float, Field(ge=-7.0, le=7.0)],
]

Opening = Annotated[float, Field(ge=-100.0, le=100.0)]

_PART: Final = r"^[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*$"
_TOPIC: Final = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)+")
SPACE: Final = "space"
"""How the space bar is written."""


class PedalSettings(Settings):
    """A pedal or button of a sensor_msgs/Joy, or a key of the terminal."""

    topic: str = Field(
        default="",
        description="Full name of its sensor_msgs/Joy: /footpedals/clutch. Give this or key.",
    )
    button: int = Field(
        default=0, ge=0, le=63, description="Which of the message's buttons; 1 is pressed."
    )
    repeats: bool = Field(
        default=True,
        description="Its state is told again and again, so that silence means that nobody presses it. The "
        "dVRK tells changes only: false; then only a publisher that is gone is noticed.",
    )
    timeout: Positive = Field(
        default=0.5,
        description="Seconds of silence, of one that repeats, after which it is not heard.",
    )
    key: str = Field(
        default="",
        description="A key of the terminal that presses and, the next time, lets go: one letter, or space.",
    )

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        if bool(self.topic) == bool(self.key):
            raise ValueError("give a topic or a key")
        if self.topic and not _TOPIC.fullmatch(self.topic):
            raise ValueError(f"topic {self.topic!r} is no full name, as /footpedals/clutch is")
        if self.key and self.key != SPACE and (len(self.key) != 1 or not self.key.isalnum()):
            raise ValueError(f"key {self.key!r} is neither one letter or digit nor space")
        return self

    @property
    def told(self) -> str:
        """How it is called in messages."""
        return f"key {self.key}" if self.key else self.topic


class LimitsSettings(Settings):
    """What the follower is never sent, and what ends the coupling."""

    speed: float = Field(
        default=0.25, gt=0.0, le=10.0, description="Of what the follower is sent, in m/s."
    )
    turn_speed: float = Field(
        default=1.0, gt=0.0, le=20.0, description="Of what the follower is sent, in rad/s."
    )
    acceleration: float = Field(
        default=1.0, gt=0.0, le=100.0, description="Of velocities that are sent, in m/s²."
    )
    turn_acceleration: float = Field(
        default=5.0, gt=0.0, le=500.0, description="Of velocities that are sent, in rad/s²."
    )
    jump: float = Field(
        default=0.05,
        gt=0.0,
        le=1.0,
        description="A leader that is further than this, in m, from where it was one step before has jumped.",
    )
    turn_jump: float = Field(default=0.5, gt=0.0, le=3.0, description="The same in rad.")
    lag: float = Field(
        default=0.1,
        gt=0.0,
        le=1.0,
        description="The follower is held when it, or what it is sent, is further than this, in m, from "
        "where the leader wants it.",
    )
    turn_lag: float = Field(default=0.6, gt=0.0, le=3.0, description="The same in rad.")


class ForceSettings(Settings):
    """What the follower feels, for the hand at the leader."""

    source: Literal["measured_cf", "body/measured_cf"] = Field(
        default="measured_cf", description="What of the follower is reflected."
    )
    gain: float = Field(
        default=0.5, ge=0.0, le=10.0, description="Force at the leader for one of the follower."
    )
    turn_gain: float = Field(default=0.0, ge=0.0, le=10.0, description="The same for torques.")
    most: float = Field(
        default=3.0, gt=0.0, le=200.0, description="Largest force at the leader, in N."
    )
    most_torque: float = Field(
        default=0.1, gt=0.0, le=50.0, description="Largest torque at the leader, in N·m."
    )
    ramp: float = Field(
        default=0.5, gt=0.0, le=10.0, description="Seconds in which it comes after each coupling."
    )


class GripperSettings(Settings):
    """The leader's gripper, and the jaw that it opens and closes."""

    leader: str = Field(
        default="gripper",
        pattern=_PART,
        description="Sub-namespace of the leader in which its gripper is: measured_js of one joint.",
    )
    follower: str = Field(
        default="gripper",
        pattern=_PART,
        description="Sub-namespace of the follower in which its gripper is: measured_js and servo_jp of one "
        "joint. jaw on the dVRK.",
    )
    leader_closed: Opening = Field(
        description="Where the leader's gripper closes the jaw, in its own unit: rad (m)."
    )
    leader_open: Opening = Field(description="Where it opens it.")
    follower_closed: Opening = Field(
        description="Where the jaw is sent at most to close, in its own unit: rad (m). The dVRK presses "
        "below 0."
    )
    follower_open: Opening = Field(description="Where it is sent at most to open.")
    speed: Positive = Field(description="Of what the jaw is sent, in rad/s (m/s).")
    near: float = Field(
        default=0.05,
        gt=0.0,
        le=0.5,
        description="How near to where the jaw is, as a share of its way, the leader's gripper must come "
        "after each coupling before it leads the jaw.",
    )
    timeout: Positive = Field(
        default=0.5, description="Seconds after which either of them that is not heard is lost."
    )

    @model_validator(mode="after")
    def _have_a_way(self) -> Self:
        for side in ("leader", "follower"):
            if getattr(self, f"{side}_closed") == getattr(self, f"{side}_open"):
                raise ValueError(f"{side}_closed, {side}_open: are one and the same")
        return self


class TeleopSettings(Settings):
    """A leader and a follower."""

    leader: str = Field(
        min_length=1, description="A device of this file, or the namespace of any: /MTMR."
    )
    follower: str = Field(min_length=1, description="The same.")
    mode: Mode = Field(
        default="position",
        description="position: the follower goes the way of the leader (servo_cp). rate: it moves as fast as "
        "the leader is away from where it was coupled (servo_cv). velocity: as fast as the leader's "
        "measured_cv.",
    )
    scale: float = Field(
        default=1.0,
        gt=0.0,
        le=100.0,
        description="Metres of the follower for one of the leader; of `rate` metres a second.",
    )
    turn_scale: float = Field(
        default=1.0,
        gt=0.0,
        le=100.0,
        description="Of `rate` and `velocity`: rad/s for one rad, or one rad/s, of the leader.",
    )
    deadband: float = Field(
        default=0.005, ge=0.0, le=1.0, description="Of `rate`: metres that move nothing."
    )
    turn_deadband: float = Field(default=0.05, ge=0.0, le=3.0, description="The same in rad.")
    orientation: Orientation = Field(
        default="relative",
        description="relative: the follower turns as the leader turns. aligned: the same, and it begins when "
        "the leader has the orientation of the follower. locked: it keeps its own.",
    )
    translation: Translation = Field(
        default="follows", description="locked: the follower only turns."
    )
    leader_rpy: Angles = Field(
        default=(0.0, 0.0, 0.0),
        description="The leader's base axes in those of the follower: roll, pitch, yaw in rad, about fixed "
        "x, then y, then z.",
    )
    tool_rpy: Angles = Field(
        default=(0.0, 0.0, 0.0),
        description="Of `aligned`: the follower's tool in the leader's handle, in the same way.",
    )
    tolerance: float = Field(
        default=0.1, gt=0.0, le=3.0, description="Of `aligned`: how well, in rad, it must be."
    )
    clutch: PedalSettings | None = Field(
        default=None, description="Pressed, it uncouples, as on the dVRK."
    )
    engage: PedalSettings | None = Field(
        default=None, description="Only while it is pressed they are coupled: a dead-man's pedal."
    )
    limits: LimitsSettings = Field(default=LimitsSettings(), description="What is never sent.")
    force: ForceSettings | None = Field(
        default=None,
        description="Reflect what the follower feels (servo_cf of the leader). Without it the leader is held "
        "when something is wrong, and sent nothing else.",
    )
    gripper: GripperSettings | None = Field(
        default=None, description="Open and close the follower's jaw by the leader's gripper."
    )
    free_leader: bool = Field(
        default=False,
        description="Let the leader go by `free` whenever it is uncoupled: for one that is held otherwise.",
    )
    timeout: float = Field(
        default=0.1,
        gt=0.0,
        le=2.0,
        description="A side of which nothing newer than this, in s, is heard is lost.",
    )
    rate: float = Field(
        default=200.0,
        ge=10.0,
        le=1000.0,
        description="How often the follower is sent something, in Hz.",
    )

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.clutch is None and self.engage is None:
            raise ValueError("clutch or engage: there must be something that uncouples them")
        if self.leader == self.follower:
            raise ValueError(f"{self.leader} cannot follow itself")
        if self.timeout * self.rate < 2.0:
            raise ValueError("timeout: is shorter than two steps at this rate: every step is late")
        if self.mode != "position" and self.orientation == "aligned":
            raise ValueError("orientation: aligned is for the mode position")
        if self.orientation == self.translation == "locked":
            raise ValueError("orientation, translation: with both locked nothing follows")
        for mode, keys in _OF_MODES.items():
            wrong = keys & self.model_fields_set
            if self.mode not in mode and wrong:
                raise ValueError(f"{min(wrong)}: is of the mode {' and '.join(mode)}")
        return self

    @cached_property
    def leader_axes(self) -> Vector:
        """Quaternion (4,) that turns what is in the leader's base axes into those of the follower."""
        return quaternion_from_rpy(*self.leader_rpy)

    @cached_property
    def tool(self) -> Vector:
        """Quaternion (4,) of the follower's tool in the leader's handle."""
        return quaternion_from_rpy(*self.tool_rpy)


_OF_MODES: Final = {
    ("rate",): {"deadband", "turn_deadband"},
    ("rate", "velocity"): {"turn_scale"},
    ("position",): {"tool_rpy", "tolerance"},
}
"""Keys that mean something in some modes only."""
