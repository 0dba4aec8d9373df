"""The bytes of RDT: known ones, and any others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft import rdt
from crtk_driver_ati_netft.profiles import AXIA, NETBOX, ONROBOT, PROFILES, Action, Mode

# rdt_sequence 1, ft_sequence 65536, status 0x80020000, Fx 1000000, Fy -1, Fz 2^31-1, Tx -2^31, Ty 0, Tz 2
RECORD = bytes.fromhex(
    "00000001 00010000 80020000 000F4240 FFFFFFFF 7FFFFFFF 80000000 00000000 00000002"
)

numbers = st.integers(0, 2**32 - 1)
counts = st.integers(-(2**31), 2**31 - 1)
records = st.lists(st.tuples(numbers, numbers, numbers, st.lists(counts, min_size=6, max_size=6)))


def decode(data: bytes) -> np.ndarray | None:
    """Return the records of one datagram, by the plain rule."""
    return np.frombuffer(data, rdt.RECORD) if data and len(data) % 36 == 0 else None


def in_batch(data: bytes) -> rdt.Decoded:
    """Return what a batch of this datagram alone holds."""
    slots = np.frombuffer(data, np.uint8).reshape(1, -1)
    return rdt.decode_batch(slots, np.array([len(data)], np.uint32))


def encoded(rows) -> bytes:
    return np.array([tuple(row) for row in rows], rdt.RECORD).tobytes()


@pytest.mark.parametrize(
    ("request_bytes", "expected"),
    [
        (rdt.encode_request(*NETBOX.actions[Action.STOP]), "1234 0000 00000000"),
        (rdt.encode_request(NETBOX.starts[Mode.REALTIME]), "1234 0002 00000000"),
        (rdt.encode_request(NETBOX.starts[Mode.BUFFERED], 7), "1234 0003 00000007"),
        (rdt.encode_request(*NETBOX.actions[Action.CLEAR_LATCH]), "1234 0041 00000000"),
        (rdt.encode_request(*NETBOX.actions[Action.BIAS]), "1234 0042 00000000"),
        (rdt.encode_request(AXIA.starts[Mode.SINGLE]), "1234 0001 00000000"),
        (rdt.encode_request(*ONROBOT.actions[Action.BIAS]), "1234 0042 000000FF"),
        (rdt.encode_request(*ONROBOT.actions[Action.UNBIAS]), "1234 0042 00000000"),
        (rdt.encode_request(ONROBOT.period_by_rdt or 0, 2), "1234 0082 00000002"),
    ],
)
def test_requests_are_those_of_the_manuals(request_bytes: bytes, expected: str) -> None:
    assert request_bytes == bytes.fromhex(expected)


@pytest.mark.parametrize("arguments", [(-1, 0), (0x10000, 0), (2, -1), (2, 2**32)])
def test_a_request_that_cannot_be_is_refused(arguments) -> None:
    with pytest.raises(ValueError, match="not a request"):
        rdt.encode_request(*arguments)


def test_a_known_record() -> None:
    (found,) = rdt.native(in_batch(RECORD).records)
    counts = [1000000, -1, 2**31 - 1, -(2**31), 0, 2]
    assert found.view(np.uint32)[:3].tolist() == [1, 65536, 0x80020000]
    assert found[3:].tolist() == counts


@given(records)
def test_records_survive_in_one_datagram(rows) -> None:
    found = in_batch(encoded(rows))
    numbers = rdt.native(found.records)
    assert numbers[:, :3].astype(np.uint32).tolist() == [list(row[:3]) for row in rows]
    assert numbers[:, 3:].tolist() == [row[3] for row in rows]
    assert found.malformed == (not rows)


@given(st.binary(max_size=200))
def test_what_is_no_whole_number_of_records_is_malformed(data: bytes) -> None:
    found = in_batch(data)
    whole = decode(data)
    assert found.malformed == (whole is None)
    assert found.records.tobytes() == (b"" if whole is None else data)


@given(st.lists(st.one_of(st.binary(max_size=120), records.map(encoded)), max_size=12))
def test_a_batch_holds_what_its_datagrams_hold_one_by_one(datagrams: list[bytes]) -> None:
    size = 128
    slots = np.zeros((len(datagrams), size), np.uint8)
    for row, data in zip(slots, datagrams, strict=True):
        row[: min(len(data), size)] = np.frombuffer(data[:size], np.uint8)
    lengths = np.array([len(data) for data in datagrams], np.uint32)
    found = rdt.decode_batch(slots, lengths)
    whole = [decode(data) if len(data) <= size else None for data in datagrams]
    assert found.records.tobytes() == b"".join(r.tobytes() for r in whole if r is not None)
    assert found.malformed == sum(r is None for r in whole)
    origin = [i for i, r in enumerate(whole) if r is not None for _ in r]
    source = found.source if found.source is not None else np.arange(len(found.records))
    assert source.tolist() == origin


@pytest.mark.parametrize("each", [1, 2, 40])
def test_a_batch_of_equal_datagrams(each: int) -> None:
    rows = [(i, 7 * i, 0, [i, -i, 0, 1, 2, 3]) for i in range(3 * each)]
    slots = np.frombuffer(encoded(rows), np.uint8).reshape(3, -1)
    found = rdt.decode_batch(slots, np.full(3, slots.shape[1], np.uint32))
    assert found.records["rdt_sequence"].tolist() == list(range(3 * each))
    assert found.malformed == 0
    assert (found.source is None) == (each == 1)


def test_a_batch_is_a_copy_of_memory_that_is_used_again() -> None:
    slots = np.frombuffer(bytearray(RECORD * 2), np.uint8).reshape(2, 36)
    found = rdt.decode_batch(slots, np.full(2, 36, np.uint32))
    slots[:] = 0
    assert found.records["rdt_sequence"].tolist() == [1, 1]


def test_every_profile_has_a_stream_and_can_end_it() -> None:
    for name, profile in PROFILES.items():
        assert profile.name == name
        assert Mode.REALTIME in profile.starts
        assert profile.actions[Action.STOP] == (0, 0)
        assert profile.rate == max(profile.internal_rates)
