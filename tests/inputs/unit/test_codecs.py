"""Bytes of the kernel and of spacenavd: known ones, cut anywhere, and anything at all."""

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_inputs import events, spacenav
from crtk_drivers.kit.decoding import BadData

PRESS_A = bytes.fromhex("e803000000000000 7017000000000000 0100 1e00 01000000".replace(" ", ""))
"""A of a keyboard (code 30) is pressed, 1000.006 s after 1970."""
JS_BUTTON_2 = bytes.fromhex("10270000 0100 81 02".replace(" ", ""))
"""Button 2 is pressed already when the device is opened."""
SHORT = st.integers(0, 0xFFFF)
LONG = st.integers(-(2**31), 2**31 - 1)


def fed(decoder, data: bytes, cuts: list[int]) -> list[object]:
    found, at = [], 0
    for cut in sorted(cut % (len(data) + 1) for cut in cuts):
        found += decoder.feed(data[at:cut])
        at = cut
    return found + decoder.feed(data[at:])


def test_known_bytes():
    assert events.event_decoder().feed(PRESS_A) == [events.Press(30, True)]
    assert events.js_decoder().feed(JS_BUTTON_2) == [events.Press(2, True)]
    axis = struct.pack("@IhBB", 5, -32767, 2, 1)
    assert events.js_decoder().feed(axis) == [events.Axis(1, -1.0)]
    assert events.get_keys_request() == 0x80604518, "EVIOCGKEY(96)"
    assert events.GRAB == 0x40044590
    assert events.pressed_keys(bytes((0, 0, 0, 0x40, 0, 1))) == {30, 40}
    assert struct.pack("@i", 0x7FAA5501) == spacenav.HELLO
    moved = struct.pack("@8i", 0, 1, -2, 3, -4, 5, -350, 16)
    assert spacenav.decoder().feed(moved) == [spacenav.Motion((1, -2, 3, -4, 5, -350))]
    assert spacenav.decoder().feed(struct.pack("@8i", 2, 7, *(0,) * 6)) == [
        spacenav.Press(7, False)
    ]
    gone = struct.pack("@8i", 3, 1, *(0,) * 6)
    assert spacenav.decoder().feed(gone) == [spacenav.Mouse(False)]
    none = struct.pack("@8i", 0x7FAA2005, *(0,) * 6, -1)
    assert spacenav.decoder().feed(none) == [spacenav.Mouse(False)]


def test_a_key_that_is_held_stays_pressed_and_what_was_lost_is_told():
    decoder = events.event_decoder()
    assert decoder.feed(events.EVENT.pack(0, 0, 1, 30, 2)) == [events.Press(30, True)]
    assert decoder.feed(events.EVENT.pack(0, 0, 0, 3, 0)) == [events.Dropped()]
    assert decoder.feed(events.EVENT.pack(0, 0, 0, 0, 0)) == [None]


@pytest.mark.parametrize(
    ("answer", "agreed"),
    [
        (struct.pack("@i", 0x7FAA5501), (1, b"")),
        (struct.pack("@i", 0x7FAA5500), (0, b"")),
        (struct.pack("@9i", 1, 3, *(0,) * 6, 0x7FAA5501), (1, struct.pack("@8i", 1, 3, *(0,) * 6))),
        (struct.pack("@8i", 1, 3, *(0,) * 6), None),
        (b"\x01", None),
        (b"", None),
    ],
)
def test_which_protocol_a_daemon_speaks(answer, agreed):
    assert spacenav.agreed(answer) == agreed


@given(
    st.lists(st.tuples(SHORT, SHORT, LONG), max_size=8), st.lists(st.integers(0, 500), max_size=6)
)
def test_events_may_be_cut_anywhere(given_events, cuts):
    data = b"".join(events.EVENT.pack(1, 2, *each) for each in given_events)
    whole = events.event_decoder().feed(data)
    assert fed(events.event_decoder(), data, cuts) == whole
    assert len(whole) == len(given_events)


@given(st.binary(max_size=300), st.lists(st.integers(0, 300), max_size=4))
def test_any_bytes_are_events_or_bad_data(data, cuts):
    fed(events.event_decoder(), data, cuts)
    for event in fed(events.js_decoder(), data, cuts):
        assert not isinstance(event, events.Axis) or -1.0 <= event.value <= 1.0
    with suppress(BadData):
        fed(spacenav.decoder(), data, cuts)
