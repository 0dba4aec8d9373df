"""The data record: known bytes by model, and what is none."""

from __future__ import annotations

import struct
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_galil import codes
from crtk_driver_galil.record import (
    FORWARD_LIMIT,
    HOME,
    LAYOUTS,
    Layout,
    layout_of,
    parse,
)

FAMILIES = tuple(LAYOUTS)


def block(layout: Layout, *, position: int = 1234, velocity: int = 6400) -> bytes:
    """An axis: in motion, at its forward limit, stop code 0, 2 counts behind, 1 V or so."""
    head = struct.pack("<HBB", 0x8000, FORWARD_LIMIT | HOME, 0)
    head += struct.pack("<6iH", position + 2, position, 2, 0, velocity, 3277, 7)
    return head + bytes(layout.axis_size - 30)


def whole(layout: Layout, letters: int, sample: int = 0x1234, error: int = 22) -> bytes:
    """A record with the first `letters` axes."""
    head = bytearray(layout.axes_at)
    if layout.has_header:
        size = layout.axes_at + layout.axis_size * letters
        struct.pack_into("<BBH", head, 0, 0x87, (1 << letters) - 1, size)
    struct.pack_into("<H", head, layout.sample_at, sample)
    head[layout.error_at] = error
    return bytes(head) + b"".join(block(layout, position=1000 * n) for n in range(letters))


def test_the_header_of_a_real_4143_is_that_of_four_axes() -> None:
    """87 0F E2 00: blocks I, T and S, axes A to D, 226 bytes."""
    data = whole(LAYOUTS["4000"], 4)
    assert data[:4] == bytes.fromhex("87 0f e2 00")
    assert len(data) == 226


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("count", [1, 3, 8])
def test_values_of_each_family(family: str, count: int) -> None:
    layout = LAYOUTS[family]
    record = parse(whole(layout, count), layout, count)
    assert (record.sample, record.error_code) == (0x1234, 22)
    assert "".join(record.axes) == "ABCDEFGH"[:count]
    last = record.axes["ABCDEFGH"[count - 1]]
    assert last.position == 1000 * (count - 1)
    assert (last.reference, last.error) == (last.position + 2, 2)
    assert last.velocity == 100.0  # a sixty-fourth of what the record has
    assert last.torque == pytest.approx(1.0, abs=1e-3)
    assert last.is_moving
    assert not last.motor_off
    assert last.switches & FORWARD_LIMIT


def test_axes_that_are_left_out_are_told_by_the_mask() -> None:
    layout = LAYOUTS["4000"]
    data = bytearray(whole(layout, 2))
    data[1] = 0b1001
    assert "".join(parse(bytes(data), layout).axes) == "AD"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: data[:-1], "bytes, where a record"),
        (lambda data: data + b"\0", "bytes, where a record"),
        (lambda data: b"\x07" + data[1:], "does not begin with 0x07"),
        (lambda data: data[:1] + b"\x07" + data[2:], "its header tells"),
        (lambda data: data[:2] + b"\xe0\x00" + data[4:], "its header tells 224 bytes"),
        (lambda data: data[:3], "3 bytes are no data record"),
        (lambda data: b"", "0 bytes are no data record"),
    ],
)
def test_what_does_not_fit_is_refused(change, message: str) -> None:  # type: ignore[no-untyped-def]
    layout = LAYOUTS["4000"]
    with pytest.raises(ValueError, match=message):
        parse(change(whole(layout, 4)), layout)


@given(st.binary(max_size=400), st.sampled_from(FAMILIES))
def test_random_bytes_are_a_record_or_refused(data: bytes, family: str) -> None:
    try:
        record = parse(data, LAYOUTS[family])
    except ValueError:
        return
    assert len(data) == LAYOUTS[family].axes_at + LAYOUTS[family].axis_size * len(record.axes)


@pytest.mark.parametrize(
    ("revision", "family"),
    [
        ("DMC4143 Rev 1.3d", "4000"),
        ("DMC4080 Rev 1.2", "4000"),
        ("DMC50040 Rev 1.0", "4000"),
        ("DMC52040 Rev 1.0", "52000"),
        ("DMC30010 Rev 1.2c", "30000"),
        ("DMC2143 Rev 1.0p", "2103"),
        ("DMC1806 Rev 1.0", "1806"),
        ("DMC1802 Rev 1.0", "1802"),
        ("DMC9999 Rev 1.0", None),
        ("RIO47100 Rev 1.0", None),
        ("", None),
    ],
)
def test_the_family_follows_from_the_revision(revision: str, family: str | None) -> None:
    found = layout_of(revision)
    assert (None if found is None else found.name) == family


def test_the_simulator_and_the_driver_agree_without_sharing_code() -> None:
    from crtk_sim_backends.galil.models import MODELS
    from crtk_sim_backends.galil.models import record as simulated

    for name, model in MODELS.items():
        axis = SimpleNamespace(
            moving=True, homing=False, on=True, finding=False, forward_limit=True,
            reverse_limit=False, home_switch=False, reference=12.0, counts=10, stop_code=30,
            velocity=-50.0, volts=2.5,
        )  # fmt: skip
        layout = layout_of(model.revision)
        assert layout is not None, name
        read = parse(simulated(model, [axis] * 2, 70_000, 6, 1), layout, 2)  # type: ignore[list-item]
        assert read.sample == 70_000 & 0xFFFF
        assert read.axes["B"].velocity == pytest.approx(-50.0)
        assert read.axes["B"].torque == pytest.approx(2.5, abs=1e-3)
        assert read.axes["B"].stop_code == 30


def test_codes_are_words_with_a_remedy() -> None:
    assert codes.refusal(22).text == "begin is not possible due to a limit switch"
    assert "limit switch" in codes.refusal(22).remedy
    assert "not known" in codes.refusal(250).text
    assert codes.stop_text(8).startswith("stopped by off on error")
    assert "not known" in codes.stop_text(77)


@pytest.mark.parametrize(
    ("status", "axis", "text"),
    [
        (0, 0, ""),
        (0x1, 0, "over-current"),
        (0x8, 3, "under-voltage"),
        (0x10, 0, ""),  # that of E to H
        (0x10, 4, "over-current"),
        (0x200, 1, "hall error"),
        (0x200, 0, ""),
        (0x1_0000, 0, "peak current"),
        (0x0100_0000, 2, "electronic lock-out (ELO)"),
        (0x0200_0000, 2, ""),
    ],
)
def test_amplifier_bits(status: int, axis: int, text: str) -> None:
    assert codes.amplifier_text(status, axis) == text
