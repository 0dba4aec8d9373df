"""Values that can be recorded, any of them, for tests with hypothesis."""

import dataclasses

import numpy as np
from hypothesis import strategies as st

from crtk_drivers.samples import JointState, Pose, Text, Twist, Wrench, vector
from crtk_drivers.state import OperatingState, Status

NUMBERS = st.floats(allow_nan=True, allow_infinity=True)
WORDS = st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=12)
STAMPS = st.integers(0, 2_000_000_000 * 10**9)


def vectors(size):
    return st.lists(NUMBERS, min_size=size, max_size=size).map(vector)


@st.composite
def joint_states(draw):
    size = draw(st.integers(0, 9))
    parts = [draw(st.just(vector([])) | vectors(size)) for _ in range(3)]
    name = draw(st.just(()) | st.lists(WORDS, min_size=size, max_size=size).map(tuple))
    return JointState(*parts, name)


VALUES = st.one_of(
    joint_states(),
    st.builds(Pose, vectors(3), vectors(4), WORDS),
    st.builds(Twist, vectors(3), vectors(3), WORDS),
    st.builds(Wrench, vectors(3), vectors(3), WORDS),
    st.builds(Status, st.sampled_from(OperatingState), st.booleans(), st.booleans()),
    st.builds(Text, WORDS),
)


def fields(value):
    """Return a value as something that can be compared: its numbers by their bits."""
    return [
        part.tobytes() if isinstance(part, np.ndarray) else part
        for part in (getattr(value, field.name) for field in dataclasses.fields(value))
    ]
