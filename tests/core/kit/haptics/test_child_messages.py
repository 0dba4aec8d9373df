"""Messages between a driver and the process of its haptic device: what goes in comes out."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.kit.haptics import Motion, child_messages
from crtk_drivers.kit.haptics.child_messages import Flags, Kind, State
from crtk_drivers.kit.haptics.triples import quaternion, turn

numbers = st.floats(allow_nan=False, allow_infinity=False)
triples = st.tuples(numbers, numbers, numbers)
masks = st.integers(0, 2**32 - 1)
counts = st.integers(0, 2**64 - 1)


@given(
    time=numbers,
    motion=st.builds(
        Motion, triples, st.tuples(numbers, numbers, numbers, numbers), triples, triples
    ),
    force=triples,
    torque=triples,
    gripper=triples,
    buttons=masks,
    flags=st.integers(0, 15),
    done=counts,
    counted=st.tuples(*[st.integers(0, 2**63)] * 5),
)
def test_a_state_comes_out_as_it_went_in(
    time: float,
    motion: Motion,
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
    gripper: tuple[float, float, float],
    buttons: int,
    flags: int,
    done: int,
    counted: tuple[int, ...],
) -> None:
    told = State(time, motion, force, torque, *gripper, buttons, Flags(flags), done, counted, 0.5)
    message = child_messages.state(told)
    assert Kind(message[:1]) is Kind.STATE
    assert child_messages.state_of(message) == told
    for cut in (message[:-1], message + b"x"):
        with pytest.raises(ValueError, match="unpack"):
            child_messages.state_of(cut)


@given(number=counts, values=st.lists(numbers, max_size=7))
def test_an_order_comes_out_as_it_went_in(number: int, values: list[float]) -> None:
    message = child_messages.order(Kind.WRENCH, number, values)
    assert Kind(message[:1]) is Kind.WRENCH
    assert child_messages.order_of(message) == (number, (*values, *(0.0,) * (7 - len(values))))


@given(number=counts, text=st.text(max_size=50))
def test_a_text_comes_out_as_it_went_in(number: int, text: str) -> None:
    assert child_messages.text_of(child_messages.text(Kind.OPENED, number, {"a": text})) == (
        number,
        {"a": text},
    )


@given(data=st.binary(max_size=200))
def test_any_bytes_are_a_message_or_a_value_error(data: bytes) -> None:
    for decode in (child_messages.text_of, child_messages.order_of, child_messages.state_of):
        with contextlib.suppress(ValueError):
            decode(data)


@given(axis=st.tuples(*[st.floats(0.1, 1.0)] * 3), angle=st.floats(-3.0, 3.0))
def test_a_rotation_matrix_becomes_its_quaternion(
    axis: tuple[float, float, float], angle: float
) -> None:
    length = math.hypot(*axis)
    x, y, z = (each / length for each in axis)
    s, c = math.sin(angle), math.cos(angle)
    v = 1.0 - c
    matrix = (
        (x * x * v + c, x * y * v - z * s, x * z * v + y * s),
        (x * y * v + z * s, y * y * v + c, y * z * v - x * s),
        (x * z * v - y * s, y * z * v + x * s, z * z * v + c),
    )
    turned = turn(quaternion(matrix), (0.0, 0.0, 0.0, 1.0))
    assert turned == pytest.approx([angle * each for each in (x, y, z)], abs=1e-6)


def test_what_is_no_rotation_is_no_number() -> None:
    assert not Motion((0.0, 0.0, 0.0), quaternion([(math.nan,) * 3] * 3)).is_possible
