"""Status words, by profile: what is an error for one is a notice for another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft.profiles import (
    AXIA,
    NETBOX,
    ONROBOT,
    PROFILES,
    SCHUNK,
    detect,
    reachable_rate,
)
from crtk_drivers.kit.sensing.status_words import Meaning, combined

OK, NOTICE, SATURATED, ERROR = "ok", "notice", "saturated", "error"

CASES = [
    (NETBOX, 0x00000000, OK, ""),
    (NETBOX, 0x80010000, NOTICE, "monitor condition"),
    (NETBOX, 0x00010000, NOTICE, "monitor condition"),
    (NETBOX, 0x80020000, SATURATED, "saturated"),
    (NETBOX, 0x80030000, SATURATED, "monitor condition"),
    (NETBOX, 0xC0000000, ERROR, "CPU or RAM"),
    (NETBOX, 0x80000004, ERROR, "temperature"),
    (NETBOX, 0x80004000, ERROR, "watchdog"),
    (NETBOX, 0x80000000, ERROR, "does not name"),
    (NETBOX, 0x00008000, NOTICE, "0x00008000"),
    (AXIA, 0x00000000, OK, ""),
    (AXIA, 0x00010000, NOTICE, "monitor condition"),
    (AXIA, 0x10000000, NOTICE, "simulated"),
    (AXIA, 0x00000008, NOTICE, "busy"),
    (AXIA, 0x10010008, NOTICE, "busy"),
    (AXIA, 0xC0000000, SATURATED, "out of range"),
    (AXIA, 0x88000000, SATURATED, "gage out of range"),
    (AXIA, 0x80000004, ERROR, "gage broken"),
    (AXIA, 0x80000002, ERROR, "supply"),
    (AXIA, 0x80010000, ERROR, "does not name"),
    (AXIA, 0xA0000080, ERROR, "checksum"),
    (SCHUNK, 0xC0000000, SATURATED, "out of range"),
    (ONROBOT, 0x00000000, OK, ""),
    (ONROBOT, 0x00000200, SATURATED, "Fx"),
    (ONROBOT, 0x00000010, SATURATED, "Tz"),
    (ONROBOT, 0x00000400, ERROR, "sensor"),
    (ONROBOT, 0x00004000, ERROR, "acquisition"),
]


@pytest.mark.parametrize(
    ("profile", "status", "verdict", "text"),
    CASES,
    ids=lambda v: f"{v:#x}" if type(v) is int else "",
)
def test_a_status_word_means_what_the_manual_of_the_sensor_says(
    profile, status, verdict, text
) -> None:
    table, words = profile.status, np.array([status], np.uint32)
    assert bool(table.is_error(words)[0]) == (verdict == ERROR)
    assert bool(table.is_saturated(words)[0]) == (verdict == SATURATED)
    texts = table.texts(status)
    assert bool(texts) == (verdict != OK)
    assert text in " ".join(texts)
    assert bool(table.texts(status, [Meaning.ERROR])) == (verdict == ERROR)


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
@given(words=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=5))
def test_blocks_and_words_agree_for_any_word(profile, words) -> None:
    table, array = profile.status, np.array(words, np.uint32)
    for word, error, saturated in zip(
        words, table.is_error(array), table.is_saturated(array), strict=True
    ):
        assert bool(table.texts(word, [Meaning.ERROR])) == error
        assert bool(table.texts(word, [Meaning.SATURATED])) == saturated
        assert bool(table.texts(word)) == (word != 0)
    assert combined(array) == np.bitwise_or.reduce(array)


@pytest.mark.parametrize("profile", PROFILES.values(), ids=PROFILES)
def test_no_bit_has_two_meanings(profile) -> None:
    seen = 0
    for bit in profile.status.bits:
        assert not seen & bit.mask
        seen |= bit.mask


@pytest.mark.parametrize(
    ("product", "name"),
    [
        ("ATI Net F/T", "netbox"),
        ("", "netbox"),
        ("Ethernet Axia80-M20", "axia"),
        ("SCHUNK FTN-AXIA80", "schunk"),
        ("FTN-Gamma", "schunk"),
    ],
)
def test_the_profile_follows_from_the_product(product: str, name: str) -> None:
    assert detect(product).name == name


@pytest.mark.parametrize(
    ("wanted", "internal", "reached"),
    [
        (150, 7000, 152),
        (7000, 7000, 7000),
        (1, 7000, 1),
        (0, 7000, 1),
        (9999, 7000, 7000),
        (3000, 7912, 3956),
        (500, 1000, 500),
        (3501, 7000, 7000),
    ],
)
def test_rates_are_rounded_up_to_a_fraction_of_the_internal_one(wanted, internal, reached) -> None:
    assert reachable_rate(wanted, internal) == reached
