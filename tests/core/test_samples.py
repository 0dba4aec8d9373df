"""Frozen values."""

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers import samples
from crtk_drivers.commands import Kind
from crtk_drivers.samples import (
    EMPTY,
    AxisMode,
    JointServo,
    JointState,
    Matrix,
    Pose,
    Sample,
    Stamp,
    Twist,
    Wrench,
    joint_state,
    joint_values,
    vector,
)


@pytest.mark.parametrize(
    "values", [[1, 2, 3], (1.0, 2.0, 3.0), np.arange(1, 4), np.array([1, 2, 3], dtype=np.float32)]
)
def test_a_vector_is_a_read_only_copy_of_floats(values: Any) -> None:
    made = vector(values)
    assert made.dtype == np.float64
    assert made.tolist() == [1.0, 2.0, 3.0]
    with pytest.raises(ValueError, match="read-only"):
        made[0] = 9.0
    if isinstance(values, np.ndarray):
        values[0] = 9
        assert made[0] == 1.0


@pytest.mark.parametrize("values", ["text", 3.0, [[1.0], [2.0]], [1.0, "x"], [1j], object()])
def test_what_is_no_list_of_numbers_is_no_vector(values: Any) -> None:
    with pytest.raises((TypeError, ValueError)):
        vector(values)


@pytest.mark.parametrize(
    ("cls", "fields"),
    [
        (JointState, {"position": 2, "velocity": 2, "effort": 2}),
        (Pose, {"position": 3, "orientation": 4}),
        (Twist, {"linear": 3, "angular": 3}),
        (Wrench, {"force": 3, "torque": 3}),
    ],
)
def test_a_value_cannot_be_changed_through_the_array_that_it_was_made_of(
    cls: Any, fields: dict[str, int]
) -> None:
    arrays = {name: np.ones(size) for name, size in fields.items()}
    value = cls(**arrays)
    for name, array in arrays.items():
        array[:] = np.nan
        assert np.isfinite(getattr(value, name)).all()
        with pytest.raises(ValueError, match="read-only"):
            getattr(value, name)[0] = 0.0


def test_lists_and_whole_numbers_are_welcome_and_frozen_vectors_are_not_copied() -> None:
    assert JointState(position=[1, 2]).position.dtype == np.float64  # type: ignore[arg-type]
    mine = vector((1.0, 2.0))
    assert JointState(position=mine).position is mine


@given(st.lists(st.sampled_from([0, 2, 3]), min_size=4, max_size=4))
def test_non_empty_vectors_of_a_joint_state_have_one_size(sizes: list[int]) -> None:
    position, velocity, effort = (vector([0.0] * size) for size in sizes[:3])
    name = tuple("abc"[: sizes[3]])
    fits = len({size for size in sizes if size}) <= 1
    if fits:
        JointState(position, velocity, effort, name)
    else:
        with pytest.raises(ValueError, match="different sizes"):
            JointState(position, velocity, effort, name)


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        (Kind.POSITION, "position"),
        (Kind.RELATIVE, "position"),
        (Kind.VELOCITY, "velocity"),
        (Kind.EFFORT, "effort"),
    ],
)
def test_a_command_fills_the_field_of_its_kind_and_leaves_the_others_empty(
    kind: Kind, field: str
) -> None:
    values = vector((1.0, 2.0))
    state = joint_state(kind, values)
    assert joint_values(kind, state) is values
    for name in ("position", "velocity", "effort"):
        assert getattr(state, name).size == (2 if name == field else 0)


def test_linear_comes_before_angular_and_force_before_torque() -> None:
    first, second = vector((1, 2, 3)), vector((4, 5, 6))
    assert Twist(first, second).vector.tolist() == [1, 2, 3, 4, 5, 6]
    assert Wrench(first, second).vector.tolist() == [1, 2, 3, 4, 5, 6]


def test_what_is_not_known_is_empty() -> None:
    state = JointState()
    assert state.position is EMPTY
    assert not EMPTY.flags.writeable


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (JointState(), "JointState()"),
        (
            JointState(position=vector([0.1, -1.57079632]), name=("a", "b")),
            "JointState(position=[0.1, -1.5708] rad|m, name=['a', 'b'])",
        ),
        (
            Pose(vector([1e-12, -0.0, np.nan]), vector([0, 0, 0, 1]), "base"),
            "Pose(position=[0, 0, nan] m, orientation=[0, 0, 0, 1] xyzw, frame_id='base')",
        ),
        (Twist(np.ones(3), np.zeros(3)), "Twist(linear=[1, 1, 1] m/s, angular=[0, 0, 0] rad/s)"),
        (
            Wrench(vector([12345.678, 0, -0.25]), np.zeros(3), "tool"),
            "Wrench(force=[12345.7, 0, -0.25] N, torque=[0, 0, 0] N·m, frame_id='tool')",
        ),
        (Matrix(np.eye(2)), "Matrix(values=[[1, 0], [0, 1]])"),
        (
            JointServo((AxisMode.POSITION, 7), position=vector([1, 2])),
            "JointServo(modes=[1, 7], position=[1, 2] rad|m)",
        ),
    ],
    ids=lambda each: type(each).__name__,
)
def test_a_value_shows_itself_in_one_line_with_units(value: Any, shown: str) -> None:
    assert repr(value) == shown


def test_a_sample_shows_its_age() -> None:
    values = {"measured_js": JointState()}
    now = Stamp.now()
    old = Sample(Stamp(now.wall_ns, now.monotonic - 2.0), values)
    assert re.fullmatch(r"Sample\([2-9]\.\d{3} s old: measured_js\)", repr(old))
    assert repr(Sample(Stamp(0, now.monotonic), values)) == "Sample(not valid: measured_js)"


class HeldUp:
    """Clocks of a thread that has to wait between two looks, so many times."""

    def __init__(self, times: int) -> None:
        self._now, self._looks, self._times = 100.0, 0, times

    def monotonic(self) -> float:
        self._looks += 1
        self._now += 0.02 if self._looks % 2 == 0 and self._looks <= 2 * self._times else 1e-7
        return self._now

    def time_ns(self) -> int:
        return round(1e9 * (self._now + 1e-7 + 1000.0))


@pytest.mark.parametrize("times", [0, 1, 4])
def test_stamp_has_both_clocks_of_one_moment(times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(samples, "time", HeldUp(times))
    now, then = Stamp.now(), Stamp.at(99.5)
    assert 1e-9 * now.wall_ns - now.monotonic == pytest.approx(1000.0, abs=1e-6)
    assert then == Stamp(pytest.approx(round(1e9 * 1099.5), abs=1000), 99.5)
