"""Frames between the driver and its control process."""

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.control_requests import CallError, Reply, Request
from crtk_driver_ur.library.packets import (
    MAX_FRAME,
    Alive,
    Calling,
    Event,
    EventKind,
    FrameError,
    Heartbeat,
    MotionCommand,
    MotionKind,
    decode,
    encode,
    six,
)

numbers = st.floats(allow_nan=False, allow_infinity=False)
sequences = st.integers(0, 2**32 - 1)
texts = st.text(max_size=50)
errors = st.builds(CallError, texts, texts, texts)
frames = st.one_of(
    st.just(Alive()),
    st.builds(
        MotionCommand,
        sequences,
        st.sampled_from(MotionKind),
        st.tuples(*[numbers] * 6),
        numbers,
        numbers,
    ),
    st.builds(Request, sequences, texts, st.dictionaries(texts, numbers | texts, max_size=4)),
    st.builds(
        Heartbeat,
        sequences,
        st.sampled_from(MotionKind),
        st.booleans(),
        st.booleans(),
        st.booleans(),
        st.integers(-(2**31), 2**31 - 1),
        numbers,
    ),
    st.builds(Calling, texts, numbers),
    st.builds(Reply, sequences, texts, st.none() | texts | st.booleans(), st.none() | errors),
    st.builds(Event, st.sampled_from(EventKind), sequences, errors),
)


@given(frames)
def test_every_frame_comes_back_as_it_was(frame):
    data = encode(frame)
    assert len(data) <= MAX_FRAME
    assert decode(data) == frame


@given(frames, st.data())
def test_a_truncated_frame_is_refused_or_another_valid_one(frame, data):
    packet = encode(frame)
    cut = data.draw(st.integers(0, len(packet) - 1))
    with pytest.raises(FrameError):
        decode(packet[:cut])


@given(st.binary(max_size=200))
def test_random_bytes_raise_nothing_but_frame_errors(data):
    with contextlib.suppress(FrameError):
        decode(data)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(8))
def test_motion_with_a_value_that_is_not_finite_is_refused(bad, place):
    values = [0.0] * 8
    values[place] = bad
    packet = encode(
        MotionCommand(1, MotionKind.SERVO_JOINT, tuple(values[:6]), values[6], values[7])
    )
    with pytest.raises(FrameError, match="SERVO_JOINT with a value that is not finite"):
        decode(packet)


@pytest.mark.parametrize("values", [(), (1.0,) * 5, (1.0,) * 7])
def test_motion_of_another_size_is_refused(values):
    with pytest.raises(FrameError, match="SPEED_JOINT"):
        encode(MotionCommand(1, MotionKind.SPEED_JOINT, values))
    with pytest.raises(FrameError, match="six finite numbers"):
        six(values)


def test_a_frame_that_is_too_long_is_refused():
    with pytest.raises(FrameError, match="longer than"):
        encode(Request(1, "popup", {"text": "x" * MAX_FRAME}))


@pytest.mark.parametrize(
    "content", [b"[]", b"{}", b'{"sequence": "1", "name": "a", "arguments": {}}', b"\xff", b"{"]
)
def test_a_request_with_other_content_is_refused(content):
    with pytest.raises(FrameError):
        decode(encode(Request(1, "a", {}))[:1] + content)
