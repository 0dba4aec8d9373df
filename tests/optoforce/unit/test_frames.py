"""The frames of an OptoForce unit: known answers, and whatever else a line may bring."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_optoforce import frames
from crtk_driver_optoforce.config import OptoForceConfig
from crtk_driver_optoforce.frames import (
    STATUS,
    Acknowledgement,
    Measurement,
    Message,
    SerialNumber,
    stream_decoder,
)
from crtk_drivers.kit import SeekingDecoder

KNOWN = {
    "AA07080A 0005 0000 0064 FF38 0BB8 0326": Measurement(5, 0, (100, -200, 3000)),
    "AA070810 0102 0200 0001 0002 0003 0004 0005 0006 00E3": Measurement(
        258, 0x200, (1, 2, 3, 4, 5, 6)
    ),
    "AA07081C FFFF 0000" + 12 * "0000" + "02D3": Measurement(65535, 0, (0,) * 12),
    "AA005001 00 00FB": Acknowledgement(0),
    "AA005001 03 00FE": Acknowledgement(3),
    "AA001208 4953453041313239 02B2": SerialNumber("ISE0A129"),
}
numbers = st.integers(0, 0xFFFF)
measurements = st.sampled_from((3, 6, 12)).flatmap(
    lambda axes: st.builds(
        Measurement,
        numbers,
        numbers,
        st.tuples(*[st.integers(-0x8000, 0x7FFF)] * axes),
    )
)


def encoded(measured: Measurement) -> bytes:
    body = [measured.number, measured.status, *(count % 0x10000 for count in measured.counts)]
    head = [0xAA, 7, 8, 2 * len(body)]
    data = bytes(head) + b"".join(value.to_bytes(2) for value in body)
    return data + (sum(data) % 0x10000).to_bytes(2)


def fed(data: bytes, cuts: list[int]) -> tuple[SeekingDecoder[Message], list[Message]]:
    decoder, found = stream_decoder(), []
    for cut in cuts:
        piece, data = data[:cut], data[cut:]
        found += decoder.feed(piece)
    return decoder, found + decoder.feed(data)


SOUND = Measurement(7, 0, (1, 2, 3))


@pytest.mark.parametrize("text", KNOWN)
def test_known_frames(text: str) -> None:
    assert stream_decoder().feed(bytes.fromhex(text)) == [KNOWN[text]]


CONFIGURATIONS = {
    "AA003203 01 00 FF 01DF": (1000, None, True),
    "AA003203 03 01 00 00E3": (333, 500.0, False),
    "AA003203 0A 02 00 00EB": (100, 150.0, False),
    "AA003203 21 03 00 0103": (30, 50.0, False),
    "AA003203 0A 04 00 00ED": (100, 15.0, False),
    "AA003203 64 04 00 0147": (10, 15.0, False),
    "AA003203 0A 05 00 00EE": (100, 5.0, False),
    "AA003203 0A 06 00 00EF": (100, 1.5, False),
}


@pytest.mark.parametrize("text", CONFIGURATIONS)
def test_known_configurations(text: str) -> None:
    rate, low_pass, zero = CONFIGURATIONS[text]
    assert frames.configuration(rate, low_pass, zero=zero) == bytes.fromhex(text)


def test_known_question_for_the_serial_number() -> None:
    assert frames.ASK_SERIAL.hex() == "ab00120800c5"


def test_an_unknown_rate_is_refused() -> None:
    with pytest.raises(KeyError):
        frames.configuration(500, 15.0, zero=False)


@given(st.lists(measurements, min_size=1, max_size=5), st.lists(st.integers(1, 50), max_size=8))
def test_it_may_be_cut_anywhere(measured: list[Measurement], cuts: list[int]) -> None:
    decoder, found = fed(b"".join(map(encoded, measured)), cuts)
    assert found == measured
    assert (decoder.strange, decoder.corrupt, decoder.pending) == (0, 0, 0)


@given(measurements, st.data())
def test_a_damaged_frame_is_none_and_the_next_is_found(
    measured: Measurement, data: st.DataObject
) -> None:
    damaged = bytearray(encoded(measured))
    at = data.draw(st.integers(4, len(damaged) - 1))
    damaged[at] ^= data.draw(st.integers(1, 255))
    decoder, found = fed(encoded(SOUND) + bytes(damaged) + 2 * encoded(SOUND), [])
    assert measured not in found
    assert found[0] == found[-1] == SOUND
    assert decoder.strange > 0


@given(measurements, st.data())
def test_a_truncated_frame_costs_nothing_but_itself(
    measured: Measurement, data: st.DataObject
) -> None:
    part = encoded(measured)[: data.draw(st.integers(1, len(encoded(measured)) - 1))]
    _, found = fed(encoded(SOUND) + part + 5 * encoded(SOUND), [])
    assert found.count(SOUND) >= 5


@given(st.binary(max_size=80), st.lists(st.integers(1, 20), max_size=5))
def test_random_bytes_are_survived(noise: bytes, cuts: list[int]) -> None:
    decoder, found = fed(noise + 5 * encoded(SOUND), cuts)
    assert found[-1] == SOUND
    assert decoder.pending <= 34


def test_the_status_word() -> None:
    assert STATUS.texts(0x4000 | 0x0800) == (
        "the unit cannot talk to the sensor",
        "sensor failure",
    )
    assert STATUS.texts(0x0220) == ("Fx is overloaded", "Ty is overloaded")
    assert STATUS.is_error(np.array([0, 0x0200, 0x2000, 0x0400], np.uint32)).tolist() == [
        False,
        False,
        True,
        True,
    ]
    assert [frames.sensor_concerned(word) for word in (0, 0x0203, 0x020A, 0x0207)] == [
        "",
        "sensor 3",
        "several sensors",
        "",
    ]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"low_pass": 20.0}, "no filter of 20 Hz"),
        ({"scale": (0.1, 0.1)}, "2 values for 3-axis"),
        ({"sensor": "6-axis", "scale": (0.1,) * 3}, "3 values for 6-axis"),
        ({"sensor": "4x3-axis", "bias": (1.0, 0, 0, 0, 0, 0)}, "of which of four"),
        ({"scale": (0.1, 0.0, 0.1)}, "greater than 0"),
    ],
)
def test_what_cannot_be_is_refused(values: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        OptoForceConfig(**values)


def test_each_of_four_sensors_has_its_scale() -> None:
    each = tuple(0.001 * (number + 1) for number in range(12))
    four = OptoForceConfig(sensor="4x3-axis", scale=each)
    assert [four.scale_of(number) for number in range(4)] == [
        each[3 * at : 3 * at + 3] for at in range(4)
    ]
    assert OptoForceConfig(sensor="4x3-axis", scale=each[:3]).scale_of(2) == each[:3]
