"""Values that are messages, any of them, for tests with hypothesis."""

import dataclasses
import struct

import numpy as np
from hypothesis import strategies as st

from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Joy,
    Number,
    Numbers,
    Pose,
    Poses,
    Text,
    Twist,
    Wrench,
    vector,
)
from crtk_drivers.state import OperatingState, Status

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
SINGLES = st.floats(-(2.0**127), 2.0**127, width=32) | st.sampled_from((np.nan, np.inf, -np.inf))
"""ROS takes the largest for too large: it compares with ten digits of it."""
WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=12)
STAMPS = st.integers(0, 2_000_000_000 * 10**9)
MODES = st.integers(0, 255)


def vectors(size):
    return st.lists(NUMBERS, min_size=size, max_size=size).map(vector)


def joint_fields(draw, size):
    parts = [draw(st.just(vector([])) | vectors(size)) for _ in range(3)]
    return *parts, draw(st.just(()) | st.lists(WORDS, min_size=size, max_size=size).map(tuple))


@st.composite
def joint_states(draw):
    return JointState(*joint_fields(draw, draw(st.integers(0, 9))))


@st.composite
def joint_servos(draw):
    size = draw(st.integers(0, 9))
    modes = draw(st.lists(MODES, min_size=size, max_size=size).map(tuple))
    return JointServo(modes, *joint_fields(draw, size))


POSES = st.builds(Pose, vectors(3), vectors(4))
TWISTS = st.builds(Twist, vectors(3), vectors(3))
WRENCHES = st.builds(Wrench, vectors(3), vectors(3))

RECORDED = st.one_of(
    joint_states(),
    POSES,
    st.lists(POSES, max_size=5).map(tuple).map(Poses),
    TWISTS,
    WRENCHES,
    st.builds(Status, st.sampled_from(OperatingState), st.booleans(), st.booleans()),
    st.builds(Text, WORDS),
    st.builds(
        Joy,
        st.lists(SINGLES, max_size=7).map(tuple),
        st.lists(st.integers(-(2**31), 2**31 - 1), max_size=7).map(tuple),
    ),
)
"""Without a frame, which a message names."""

SIX_MODES = st.lists(MODES, min_size=6, max_size=6).map(tuple)

VALUES = st.one_of(
    RECORDED,
    joint_servos(),
    st.builds(CartesianServo, SIX_MODES, POSES, TWISTS, WRENCHES, POSES),
    st.builds(Number, NUMBERS),
    st.builds(Flag, st.booleans()),
    st.builds(Numbers, st.lists(NUMBERS, max_size=9).map(tuple)),
)


def fields(value):
    """Return a value as something that can be compared: numbers by their bits, and no frames."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, tuple):
        return [fields(part) for part in value]
    if dataclasses.is_dataclass(value):
        names = (field.name for field in dataclasses.fields(value) if field.name != "frame_id")
        return [type(value), *(fields(getattr(value, name)) for name in names)]
    return value
