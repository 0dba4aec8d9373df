"""Loads that act on the simulated transducer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.kit.loads import GRAVITY, LoadError, Sum, parse_load

T = np.linspace(0.0, 2.0, 201)


def wrench(text: str, t: np.ndarray = T) -> np.ndarray:
    values = parse_load(text).wrench(t)
    assert values.shape == (t.size, 6)
    return values


def test_nothing_is_no_load():
    assert not wrench("").any()
    assert not wrench("none").any()


def test_a_constant_is_constant():
    assert (wrench("constant:fx=1,tz=-2") == [1, 0, 0, 0, 0, -2]).all()


def test_options_go_by_order_too():
    assert parse_load("sine:2,5,1") == parse_load("sine:axis=2,amplitude=5,frequency=1")


def test_a_sine():
    values = wrench("sine:axis=4,amplitude=3,frequency=0.5,offset=1,phase=0.2")
    np.testing.assert_allclose(values[:, 4], 1 + 3 * np.sin(np.pi * T + 0.2))
    assert not np.delete(values, 4, axis=1).any()


def test_loads_add_up():
    both = wrench("constant:fz=-20 + sine:2,5,1+constant:fx=1e+1")
    np.testing.assert_allclose(
        both, wrench("constant:fz=-20") + wrench("sine:2,5,1") + wrench("constant:fx=10")
    )


def test_a_spring_pushes_and_never_pulls():
    values = wrench("spring:axis=0,stiffness=1000,amplitude=0.01,gap=0.002,frequency=1,length=0.1")
    x = 0.01 * np.sin(2 * np.pi * T)
    np.testing.assert_allclose(values[:, 0], -1000 * np.maximum(x - 0.002, 0.0), atol=1e-12)
    np.testing.assert_allclose(values[:, 4], 0.1 * values[:, 0], atol=1e-12)
    damped = wrench("spring:axis=2,damping=50,frequency=1")
    assert (damped[:, 2] <= 0.0).all()


def test_gravity_pulls_down_in_the_world():
    upright = wrench("gravity:mass=2,x=0.1")
    np.testing.assert_allclose(upright[0], [0, 0, -2 * GRAVITY, 0, 0.2 * GRAVITY, 0], atol=1e-9)
    lying = wrench(f"gravity:mass=1,rx={np.pi / 2}")
    np.testing.assert_allclose(lying[0, :3], [0, -GRAVITY, 0], atol=1e-9)


@given(st.lists(st.floats(-3, 3), min_size=3, max_size=3), st.integers(0, 2), st.floats(0, 1.5))
def test_a_weight_is_the_same_however_the_sensor_is_turned(vector, axis, swing):
    rx, ry, rz = vector
    values = wrench(f"gravity:mass=1.5,z=0.1,rx={rx},ry={ry},rz={rz},axis={axis},swing={swing}")
    np.testing.assert_allclose(np.linalg.norm(values[:, :3], axis=1), 1.5 * GRAVITY, rtol=1e-9)
    np.testing.assert_allclose(values[:, 3:], np.cross([0, 0, 0.1], values[:, :3]), atol=1e-9)
    # About its own axis the sensor swings: what pulls along it stays.
    np.testing.assert_allclose(values[:, axis], values[0, axis], atol=1e-9)


def test_noise_is_that_of_its_seed():
    load = "noise:force=0.5,torque=0.01,seed=3"
    t = np.arange(20_000) / 7000
    np.testing.assert_array_equal(wrench(load, t), wrench(load, t))
    np.testing.assert_allclose(wrench(load, t).std(axis=0), [0.5] * 3 + [0.01] * 3, rtol=0.03)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("sinus:1", "unknown load 'sinus'; did you mean 'sine'"),
        ("sine:ampl=3", "unknown option 'ampl'; did you mean 'amplitude'"),
        ("sine:axis=6", "axis must be 0 to 5"),
        ("sine:axis=two", "axis must be int, not 'two'"),
        ("constant:fx=nan", "fx must be finite"),
        ("constant:fx=1,fx=2", "fx is given twice"),
        ("sine:1,2,3,4,5,6", "has 5 options"),
        ("gravity:mass=-1", "mass must not be negative"),
        ("noise:force=-1", "must not be negative"),
        ("spring:axis=3", "axis must be 0 to 2"),
        ("constant:fx=1 + ", "fx must be float"),
    ],
)
def test_what_is_no_load_is_refused_with_its_reason(text, told):
    with pytest.raises(LoadError, match=told):
        parse_load(text)


@given(st.text(max_size=40))
def test_any_text_is_a_load_or_refused(text):
    try:
        load = parse_load(text)
    except LoadError:
        return
    assert isinstance(load, Sum) or load.wrench(T[:2]).shape == (2, 6)
