"""A chain as a page draws it, and the chain of a URDF of which only joints are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.errors import ConfigError
from crtk_drivers.kinematics.chain import Chain, ChainJoint, JointKind, placed, turn
from crtk_drivers.kinematics.drawn import drawn, numbers_of
from crtk_drivers.kinematics.found_chain import tool_of
from crtk_drivers.kinematics.urdf import urdf_of_joints
from crtk_drivers.samples import Array, vector

NUMBER = st.floats(-1.0, 1.0)
ANGLE = st.floats(-math.pi, math.pi)
PLACEMENT = st.tuples(NUMBER, NUMBER, NUMBER, ANGLE, ANGLE)
AXES = ([1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0.6, 0, 0.8], [-1.0, 0, 0])


def at(place: tuple[float, float, float, float, float]) -> Array:
    x, y, z, roll, yaw = place
    return placed(turn(2, yaw) @ turn(0, roll), (x, y, z))


@given(
    st.lists(
        st.tuples(st.sampled_from(list(JointKind)), PLACEMENT, st.sampled_from(AXES), NUMBER),
        min_size=1,
        max_size=7,
    ),
    PLACEMENT,
)
def test_the_drawn_chain_leads_where_the_chain_does(
    joints: list[tuple[JointKind, tuple[float, ...], list[float], float]],
    tip: tuple[float, float, float, float, float],
) -> None:
    chain = Chain(
        tuple(
            ChainJoint(f"j{i}", kind, at(place), np.array(axis))  # type: ignore[arg-type]
            for i, (kind, place, axis, _) in enumerate(joints)
        ),
        at(tip),
    )
    q = vector([each for *_, each in joints])
    found, shown = drawn(chain), np.eye(4)
    for joint, slides, value in zip(found.joints, found.slides, q.tolist(), strict=True):
        move = placed(np.eye(3), (0, 0, value)) if slides else placed(turn(2, value), (0, 0, 0))
        shown = shown @ joint @ move
    assert np.allclose(shown @ found.tip, tool_of(chain, q), atol=1e-9)
    assert found.names == chain.names


def test_numbers_of_a_transform_are_its_rows() -> None:
    assert numbers_of(placed(np.eye(3), (7.0, 8.0, 9.0))) == [1, 0, 0, 7, 0, 1, 0, 8, 0, 0, 1, 9]


def link(name: str) -> str:
    return f'<link name="{name}"/>'


def joint(name: str, kind: str, parent: str, child: str, z: float = 0.0) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {z}"/><axis xyz="0 0 1"/><limit lower="-1" upper="1"/></joint>'
    )


def robot(*parts: str) -> str:
    return f"<robot name='r'>{''.join(parts)}</robot>"


ARM = (
    *map(link, ("world", "base", "upper", "hand")),
    joint("stand", "fixed", "world", "base", 0.5),
    joint("a", "revolute", "base", "upper", 0.1),
    joint("b", "revolute", "upper", "hand", 0.2),
)


@pytest.mark.parametrize(
    ("more", "height"),
    [
        ((), 0.8),
        ((link("tool"), joint("t", "fixed", "hand", "tool", 0.3)), 1.1),
        (
            (
                *map(link, ("ft", "x/tool0")),
                joint("f", "fixed", "hand", "ft", 5.0),
                joint("t", "fixed", "hand", "x/tool0", 0.3),
            ),
            1.1,
        ),
        (
            (
                *map(link, ("left", "right")),
                joint("l", "fixed", "hand", "left", 5.0),
                joint("r", "fixed", "hand", "right", 5.0),
            ),
            0.8,
        ),
        ((link("finger"), joint("g", "prismatic", "hand", "finger", 5.0)), 0.8),
    ],
)
def test_it_ends_at_the_last_joint_and_what_is_fixed_to_it(
    more: tuple[str, ...], height: float
) -> None:
    chain = urdf_of_joints(robot(*ARM, *more), ["b", "a"])
    assert chain.names == ("a", "b")
    assert tool_of(chain, vector([0.3, 0.4]))[2, 3] == pytest.approx(height)


def test_joints_of_another_robot_are_refused() -> None:
    with pytest.raises(ConfigError, match="none of the joints 'elbow'"):
        urdf_of_joints(robot(*ARM), ["elbow"])


def test_links_in_a_circle_end() -> None:
    circle = robot(
        link("x"), link("y"), joint("a", "revolute", "x", "y"), joint("b", "revolute", "y", "x")
    )
    with pytest.raises(ConfigError):
        urdf_of_joints(circle, ["a"])
