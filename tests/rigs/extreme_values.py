"""Values for every command that a device offers, made of the numbers at which arithmetic breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from hypothesis import Phase
from hypothesis import strategies as st

from crtk_drivers.commands import Command, Kind, Payload
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Number,
    Pose,
    Twist,
    Value,
    Vector,
    Wrench,
    vector,
)

IN_REAL_TIME: Mapping[str, Any] = {
    "deadline": None,
    "phases": (Phase.explicit, Phase.reuse, Phase.generate),
}
"""Settings of hypothesis for examples that take their time: none is made smaller after a failure."""

EXTREME = (
    *(float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 1.7e308, 1e200, -1e154, 1e30),
    *(5e-324, -5e-324, 2.3e-308, -0.0, 1e-17),
)
"""Not finite, near the largest double, those whose squares or sums overflow, denormals."""

PLAIN = (0.0, 1e-3, -1e-3, 0.5, 1.0)

number = st.sampled_from((*EXTREME, *PLAIN))
quaternion = st.one_of(
    st.sampled_from(
        ((0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 5e-324, 1.0), (0.0, 0.0, 1.0, 0.0), (0.5, 0.5, 0.5, 0.5))
    ).map(vector),
    st.lists(number, min_size=4, max_size=4).map(vector),
)


def numbers(size: int) -> st.SearchStrategy[Vector]:
    """Vectors, most of them of `size`; of these most zero but for one element."""

    @st.composite
    def one_spoiled(draw: st.DrawFn) -> Vector:
        values = np.zeros(size)
        if size:
            values[draw(st.integers(0, size - 1))] = draw(number)
        return vector(values)

    right = st.lists(number, min_size=size, max_size=size).map(vector)
    wrong = st.lists(number, max_size=size + 2).map(vector)
    return st.one_of(one_spoiled(), right, wrong)


def frame(known: Sequence[str]) -> st.SearchStrategy[str]:
    """Frame ids, most of them none."""
    return st.sampled_from(("", "", "", *known, "moon"))


def poses(known: Sequence[str]) -> st.SearchStrategy[Pose]:
    """Poses of extreme places, with orientations that are mostly ones."""
    orientation = st.one_of(quaternion, quaternion, numbers(4))
    return st.builds(Pose, numbers(3), orientation, frame(known))


def near(pose: Pose) -> st.SearchStrategy[Pose]:
    """The pose with one coordinate replaced."""

    @st.composite
    def spoiled(draw: st.DrawFn) -> Pose:
        position = pose.position.copy()
        position[draw(st.integers(0, 2))] = draw(number)
        return Pose(vector(position), pose.orientation)

    return spoiled()


def values_of(
    command: Command, joints: Sequence[str], here: Pose, frames: Sequence[str]
) -> st.SearchStrategy[Value]:
    """What may be sent on `command` by a client that is broken."""
    size = len(joints)
    names = st.sampled_from(((), (), tuple(joints), tuple(reversed(joints))))

    def joint_state(fill: str) -> st.SearchStrategy[Value]:
        @st.composite
        def built(draw: st.DrawFn) -> JointState:
            values = draw(numbers(size))
            name = draw(names) if values.size == size else ()
            return JointState(**{fill: values}, name=name)

        return built()

    @st.composite
    def joint_servo(draw: st.DrawFn) -> JointServo:
        modes = draw(st.lists(st.sampled_from((0, 1, 2, 4, 3, 99)), min_size=size, max_size=size))
        if draw(st.booleans()):
            modes = [draw(st.sampled_from((1, 2, 4)))] * size
        right = st.lists(number, min_size=size, max_size=size).map(vector)
        fields = (draw(st.one_of(right, st.just(vector(())))) for _ in range(3))
        return JointServo(tuple(modes), *fields)

    @st.composite
    def cartesian_servo(draw: st.DrawFn) -> CartesianServo:
        modes = draw(st.lists(st.sampled_from((0, 1, 2, 4, 3)), min_size=5, max_size=7))
        if draw(st.booleans()):
            modes = [draw(st.sampled_from((1, 2, 4)))] * 6
        twist, wrench = (
            Twist(draw(numbers(3)), draw(numbers(3))),
            Wrench(draw(numbers(3)), draw(numbers(3))),
        )
        task = draw(st.one_of(st.just(here), poses(frames)))
        return CartesianServo(
            tuple(modes), draw(poses(())), twist, wrench, task, draw(frame(frames))
        )

    fill = {Kind.VELOCITY: "velocity", Kind.EFFORT: "effort"}.get(command.kind, "position")
    made = {
        Payload.JOINT_STATE: lambda: joint_state(fill),
        Payload.POSE: lambda: st.one_of(poses(frames), near(here)),
        Payload.TWIST: lambda: st.builds(Twist, numbers(3), numbers(3), frame(frames)),
        Payload.WRENCH: lambda: st.builds(Wrench, numbers(3), numbers(3), frame(frames)),
        Payload.JOINT_SERVO: joint_servo,
        Payload.CARTESIAN_SERVO: cartesian_servo,
        Payload.NUMBER: lambda: st.builds(Number, number),
        Payload.FLAG: lambda: st.builds(Flag, st.booleans()),
    }
    return made[command.payload]()
