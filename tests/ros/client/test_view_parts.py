"""Parts of the view that need no graph: places, traces."""

from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped

from crtk_drivers.client.view.drawable import traces_of
from crtk_drivers.client.view.places import Frames, in_a_row
from crtk_drivers.samples import (
    Flag,
    JointState,
    Number,
    Numbers,
    Pose,
    Text,
    Twist,
    Value,
    Wrench,
    vector,
)


def told(*rows: tuple[str, str, float]) -> Any:
    """Return transforms along y from parent to child, as /tf_static has them."""
    transforms = []
    for parent, child, y in rows:
        each = TransformStamped()
        each.header.frame_id, each.child_frame_id = parent, child
        each.transform.translation.y, each.transform.rotation.w = float(y), 1.0
        transforms.append(each)
    return SimpleNamespace(transforms=transforms)


def test_devices_under_one_root_stand_where_it_tells() -> None:
    frames = Frames()
    frames.take(
        told(("table", "left/base", 1.0), ("room", "table", 2.0), ("room", "right/base", -1))
    )
    places = frames.places({"/left": "left/base", "/right": "right/base", "/alone": "alone/base"})
    assert {name: at[1, 3] for name, at in places.items()} == {"/left": 3.0, "/right": -1.0}


def test_of_several_roots_the_most_common_counts() -> None:
    frames = Frames()
    frames.take(told(("room", "a", 1), ("moon", "b", 2), ("room", "c", 3)))
    assert set(frames.places({"/a": "a", "/b": "b", "/c": "c"})) == {"/a", "/c"}


def test_a_circle_of_frames_has_an_end() -> None:
    frames = Frames()
    frames.take(told(("a", "b", 1), ("b", "a", 1)))
    assert frames.root("a")[0] in ("a", "b")


@pytest.mark.parametrize(
    ("part", "field", "value"),
    [("translation", "x", math.nan), ("rotation", "w", 3.0), ("rotation", "w", 0.0)],
)
def test_a_transform_that_is_none_is_passed_over(part: str, field: str, value: float) -> None:
    frames, message = Frames(), told(("room", "a", 1.0))
    setattr(getattr(message.transforms[0].transform, part), field, value)
    frames.take(message)
    assert frames.root("a")[0] == "a"


def test_in_a_row_nobody_reaches_the_next() -> None:
    reaches = [1.3, 0.4, 0.9]
    y = [float(at[1, 3]) for at in in_a_row(reaches, behind=2.0)]
    assert y[0] > 2.0
    for (a, b), (r, s) in zip(pairwise(y), pairwise(reaches), strict=True):
        assert b - a > 0.5 * (r + s)


THREE = vector([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("value", "parts"),
    [
        (JointState(THREE[:2], name=("a", "b")), ["position"]),
        (JointState(THREE, THREE), ["position", "velocity"]),
        (JointState(velocity=THREE), ["velocity"]),
        (Pose(THREE, vector([0, 0, 0, 1])), ["position", "rotation"]),
        (Twist(THREE, THREE), ["linear", "angular"]),
        (Wrench(THREE, THREE), ["force", "torque"]),
        (Number(4.0), [""]),
        (Flag(True), [""]),
        (Numbers((1.0, 2.0)), [""]),
        (Text("no number"), []),
    ],
)
def test_every_value_has_its_traces(value: Value, parts: list[str]) -> None:
    traces = traces_of(value, "V")
    assert [each.part for each in traces] == parts
    for each in traces:
        assert len(each.names) == len(each.values) > 0
        assert np.isfinite(each.values).all()
        assert each.unit
