"""The RTDE codec: known answers built by hand from the protocol guide, and hostile bytes."""

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ur.rtde import codec
from crtk_driver_ur.rtde.codec import (
    MAX_PACKAGE,
    ControllerVersion,
    DataPackage,
    Malformed,
    MalformedReason,
    PackageType,
    Recipe,
    RtdeDecoder,
    RtdeFramingError,
    SetupReply,
    StateReply,
    TextMessage,
    VersionReply,
)
from crtk_driver_ur.rtde.variables import OUTPUTS, TYPES

RECIPE = Recipe(7, ("timestamp", "actual_q", "robot_mode"), ("DOUBLE", "VECTOR6D", "INT32"))
Q = (0.5, -1.5, 2.0, -0.25, 1.0, 3.0)

# 3 bytes of header, 1 of recipe id, 8 + 48 + 4 of data
DATA = (
    b"\x00\x40\x55\x07"
    + b"\x40\x29\x00\x00\x00\x00\x00\x00"  # 12.5
    + b"\x3f\xe0\x00\x00\x00\x00\x00\x00"  # 0.5
    + b"\xbf\xf8\x00\x00\x00\x00\x00\x00"  # -1.5
    + b"\x40\x00\x00\x00\x00\x00\x00\x00"  # 2.0
    + b"\xbf\xd0\x00\x00\x00\x00\x00\x00"  # -0.25
    + b"\x3f\xf0\x00\x00\x00\x00\x00\x00"  # 1.0
    + b"\x40\x08\x00\x00\x00\x00\x00\x00"  # 3.0
    + b"\xff\xff\xff\xff"  # -1
)

REPLIES_V2 = [
    (b"\x00\x04\x56\x01", VersionReply(True)),
    (b"\x00\x04\x56\x00", VersionReply(False)),
    (
        b"\x00\x13\x76\x00\x00\x00\x05\x00\x00\x00\x0c\x00\x00\x00\x04\x00\x00\x00\x09",
        ControllerVersion(5, 12, 4, 9),
    ),
    (
        b"\x00\x13\x4f\x01DOUBLE,VECTOR6D",
        SetupReply(PackageType.SETUP_OUTPUTS, 1, ("DOUBLE", "VECTOR6D")),
    ),
    (b"\x00\x0a\x49\x02INT32,", SetupReply(PackageType.SETUP_INPUTS, 2, ("INT32",))),
    (b"\x00\x0d\x4f\x00NOT_FOUND", SetupReply(PackageType.SETUP_OUTPUTS, 0, ("NOT_FOUND",))),
    (b"\x00\x04\x53\x01", StateReply(PackageType.START, True)),
    (b"\x00\x04\x50\x01", StateReply(PackageType.PAUSE, True)),
]
TEXT = b"\x00\x0b\x4d\x02hi\x03ctl\x02"


def decoder(version: int = 2) -> RtdeDecoder:
    result = RtdeDecoder()
    result.protocol_version = version
    result.add_recipe(RECIPE)
    result.add_recipe(Recipe(0, RECIPE.names, RECIPE.types))
    return result


@pytest.mark.parametrize(("data", "expected"), REPLIES_V2)
def test_replies_of_version_2(data, expected):
    assert decoder().feed(data) == [expected]


def test_text_message_of_version_2():
    assert decoder().feed(TEXT) == [TextMessage(2, "ctl", "hi")]


def test_replies_of_version_1():
    one = decoder(1)
    assert one.feed(b"\x00\x09\x4fDOUBLE") == [
        SetupReply(PackageType.SETUP_OUTPUTS, None, ("DOUBLE",))
    ]
    assert one.feed(b"\x00\x06\x4d\x01hi") == [TextMessage(1, "", "hi")]


def test_data_package_of_version_2():
    (message,) = decoder().feed(DATA)
    assert isinstance(message, DataPackage)
    assert message.recipe is not None
    assert message.values() == (12.5, Q, -1)


def test_data_package_of_version_1_has_no_recipe_id():
    body = b"\x00\x3f\x55" + DATA[4:]
    (message,) = decoder(1).feed(body)
    assert isinstance(message, DataPackage)
    assert message.values() == (12.5, Q, -1)


def test_requests():
    assert codec.encode_protocol_version(2) == b"\x00\x05\x56\x00\x02"
    assert codec.encode_controller_version() == b"\x00\x03\x76"
    assert codec.encode_start() == b"\x00\x03\x53"
    assert codec.encode_pause() == b"\x00\x03\x50"
    frequency = b"\x40\x5f\x40\x00\x00\x00\x00\x00"  # 125.0
    assert codec.encode_output_setup(["a", "bc"], 125.0, 2) == b"\x00\x0f\x4f" + frequency + b"a,bc"
    assert codec.encode_output_setup(["a", "bc"], 125.0, 1) == b"\x00\x07\x4fa,bc"
    assert codec.encode_input_setup(["a"]) == b"\x00\x04\x49a"
    assert codec.encode_data(RECIPE, (12.5, Q, -1)) == DATA


@pytest.mark.parametrize("type_name", sorted(TYPES))
def test_every_type_has_the_size_of_the_guide(type_name):
    sizes = {
        "BOOL": 1,
        "UINT8": 1,
        "UINT32": 4,
        "UINT64": 8,
        "INT32": 4,
        "DOUBLE": 8,
        "VECTOR3D": 24,
        "VECTOR6D": 48,
        "VECTOR6INT32": 24,
        "VECTOR6UINT32": 24,
    }
    recipe = Recipe(1, ("x",), (type_name,))
    assert recipe.layout.size == sizes[type_name]
    (value,) = recipe.unpack(bytes(sizes[type_name]))
    assert value in (0, False) or set(value) == {0}


def test_recipe_with_unknown_type_is_refused():
    with pytest.raises(ValueError, match=r"foo has the unknown type 'NOT_FOUND'"):
        Recipe(1, ("foo",), ("NOT_FOUND",))
    with pytest.raises(ValueError, match="1 variables with 2 types"):
        Recipe(1, ("foo",), ("DOUBLE", "DOUBLE"))


def test_values_that_do_not_fit_are_refused():
    for values in ((12.5, Q), (12.5, Q[:5], -1), (12.5, Q, 2**31)):
        with pytest.raises(ValueError, match="do not fit"):
            codec.encode_data(RECIPE, values)


MALFORMED = [
    (b"\x00\x03\x58", MalformedReason.UNKNOWN_TYPE),
    (b"\x00\x03\x56", MalformedReason.WRONG_LENGTH),
    (b"\x00\x05\x56\x01\x01", MalformedReason.WRONG_LENGTH),
    (b"\x00\x04\x76\x05", MalformedReason.WRONG_LENGTH),
    (b"\x00\x03\x4f", MalformedReason.WRONG_LENGTH),
    (b"\x00\x03\x55", MalformedReason.WRONG_LENGTH),
    (b"\x00\x04\x55\x09", MalformedReason.UNKNOWN_RECIPE),
    (b"\x00\x3f\x55" + DATA[3:-1], MalformedReason.WRONG_LENGTH),
    (b"\x00\x06\x4d\x09hi", MalformedReason.WRONG_LENGTH),
    (b"\x00\x08\x4d\x01\xff\x01a\x02", MalformedReason.NOT_TEXT),
    (b"\x00\x05\x4f\x01\xc3", MalformedReason.NOT_TEXT),
]


@pytest.mark.parametrize(("data", "reason"), MALFORMED)
def test_malformed_package_is_counted_and_the_next_is_read(data, reason):
    one = decoder()
    first, second = one.feed(data + DATA)
    assert isinstance(first, Malformed)
    assert first.reason is reason
    assert isinstance(second, DataPackage)
    assert one.malformed == {reason: 1}


@pytest.mark.parametrize("size", [0, 1, 2, MAX_PACKAGE + 1, 0xFFFF])
def test_impossible_size_ends_the_stream(size):
    one = decoder()
    with pytest.raises(RtdeFramingError, match=f"claims {size} bytes"):
        one.feed(struct.pack(">HB", size, PackageType.DATA))
    with pytest.raises(RtdeFramingError, match="connect again"):
        one.feed(DATA)


messages = st.lists(
    st.sampled_from([DATA, TEXT, *(data for data, _ in REPLIES_V2), MALFORMED[0][0]]),
    max_size=8,
).map(b"".join)


@given(messages, st.lists(st.integers(1, 70), max_size=60))
def test_any_splitting_gives_the_same_messages(data, sizes):
    pieces, rest = [], data
    for size in sizes:
        pieces.append(rest[:size])
        rest = rest[size:]
    split = decoder()
    assert [m for piece in [*pieces, rest] for m in split.feed(piece)] == decoder().feed(data)


@given(messages.filter(bool), st.data())
def test_a_truncated_stream_gives_a_prefix(data, draw):
    cut = draw.draw(st.integers(0, len(data) - 1))
    whole, part = decoder().feed(data), decoder().feed(data[:cut])
    assert part == whole[: len(part)]


@given(messages.filter(bool), st.data())
def test_a_corrupt_byte_ends_in_messages_or_a_framing_error(data, draw):
    place = draw.draw(st.integers(0, len(data) - 1))
    corrupt = bytearray(data)
    corrupt[place] ^= draw.draw(st.integers(1, 255))
    with contextlib.suppress(RtdeFramingError):
        decoder().feed(bytes(corrupt))


@given(st.binary(max_size=3 * MAX_PACKAGE), st.sampled_from([1, 2]))
def test_random_bytes_never_leave_a_growing_buffer(data, version):
    one = decoder(version)
    try:
        read = one.feed(data)
    except RtdeFramingError:
        return
    # What is kept is less than one package, so one more byte at the end of it must release it.
    consumed = sum(3 + len(m.payload) for m in read if isinstance(m, Malformed))
    kept = len(data) - consumed
    if len(read) == sum(isinstance(m, Malformed) for m in read):
        assert kept < MAX_PACKAGE


@given(st.data())
def test_values_round_trip_for_the_whole_state_recipe(data):
    by_type = {
        "DOUBLE": st.floats(allow_nan=False),
        "VECTOR3D": st.tuples(*[st.floats(allow_nan=False)] * 3),
        "VECTOR6D": st.tuples(*[st.floats(allow_nan=False)] * 6),
        "INT32": st.integers(-(2**31), 2**31 - 1),
        "VECTOR6INT32": st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 6),
        "UINT32": st.integers(0, 2**32 - 1),
        "UINT64": st.integers(0, 2**64 - 1),
    }
    recipe = Recipe(7, tuple(OUTPUTS), tuple(OUTPUTS.values()))
    values = tuple(data.draw(by_type[kind]) for kind in OUTPUTS.values())
    one = RtdeDecoder()
    one.protocol_version = 2
    one.add_recipe(recipe)
    (message,) = one.feed(codec.encode_data(recipe, values))
    assert isinstance(message, DataPackage)
    assert message.values() == values
