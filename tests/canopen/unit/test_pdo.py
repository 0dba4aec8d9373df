"""PDOs as data, and what they take of the bus."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_canopen.busload import (
    BusLoad,
    check_load,
    cycle_load,
    exact_bits,
    plain_bits,
    worst_bits,
)
from crtk_driver_canopen.objects import OBJECTS, ObjectType, object_text, object_type
from crtk_driver_canopen.pdo import Direction, Pdo, PdoGroup, check_cob_ids, default_cob_id
from crtk_drivers.errors import ConfigError, ProtocolError
from crtk_sim_backends.can import frames

STATUS = (OBJECTS["statusword"], OBJECTS["position_actual"])
CONTROL = (OBJECTS["controlword"], OBJECTS["target_position"])


def tpdo(node: int, number: int = 1, **more: int) -> Pdo:
    return Pdo(node, Direction.TRANSMIT, number, STATUS, **more)


@pytest.mark.parametrize(
    ("direction", "number", "node", "cob_id"),
    [
        (Direction.TRANSMIT, 1, 1, 0x181),
        (Direction.TRANSMIT, 4, 127, 0x4FF),
        (Direction.RECEIVE, 1, 1, 0x201),
        (Direction.RECEIVE, 2, 5, 0x305),
        (Direction.RECEIVE, 4, 16, 0x510),
    ],
)
def test_the_predefined_connection_set(
    direction: Direction, number: int, node: int, cob_id: int
) -> None:
    assert default_cob_id(direction, number, node) == cob_id


def test_a_fifth_pdo_needs_a_cob_id_of_its_own() -> None:
    with pytest.raises(ValueError, match="no predefined COB-ID"):
        _ = tpdo(1, 5)
    assert tpdo(1, 5, cob_id=0x6A0).id == 0x6A0


def test_what_a_frame_carries() -> None:
    pdo = tpdo(3)
    assert pdo.size == 6
    assert pdo.unpack(bytes.fromhex("3712feffffff")) == (0x1237, -2)
    assert pdo.unpack(bytes.fromhex("3712feffffff0000")) == (0x1237, -2)
    assert Pdo(3, Direction.RECEIVE, 1, CONTROL).pack(0x0F, -2) == bytes.fromhex("0f00feffffff")
    assert [entry.mapping for entry in pdo.entries] == [0x60410010, 0x60640020]
    assert (pdo.communication, pdo.mapping) == (0x1800, 0x1A00)
    with pytest.raises(ProtocolError, match="node 3 TPDO 1: 5 bytes, where 6 are mapped"):
        pdo.unpack(bytes(5))


def test_objects_of_the_second_axis_lie_800_higher() -> None:
    entry = OBJECTS["position_actual"].on_axis(1)
    assert entry.mapping == 0x68640020
    assert object_text(entry.index, 0) == "6864h:00 position actual of axis 1"
    assert OBJECTS["vendor_id"].on_axis(1) == OBJECTS["vendor_id"]
    assert object_text(0x2000, 3) == "2000h:03"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pdo(0, Direction.RECEIVE, 1, CONTROL), "ids are 1 to 127"),
        (lambda: Pdo(1, Direction.RECEIVE, 0, CONTROL), "numbers are"),
        (lambda: Pdo(1, Direction.RECEIVE, 1, ()), "fixed size"),
        (lambda: Pdo(1, Direction.RECEIVE, 1, (OBJECTS["device_name"],)), "fixed size"),
        (lambda: Pdo(1, Direction.RECEIVE, 1, CONTROL + CONTROL), "12 bytes do not fit into 8"),
        (lambda: Pdo(1, Direction.RECEIVE, 1, CONTROL, cob_id=0x800), "11 bits"),
    ],
)
def test_impossible_pdos_are_refused(make: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


def test_a_group_is_packed_and_unpacked_at_once() -> None:
    group = PdoGroup(
        [tpdo(1), tpdo(2), Pdo(2, Direction.TRANSMIT, 2, (OBJECTS["velocity_actual"],))]
    )
    values = (0x37, 100, 0x40, -100, 7)
    frames = group.pack(values)
    assert [len(frame) for frame in frames] == list(group.sizes) == [6, 6, 4]
    assert group.unpack(frames) == values
    assert group.slots == {0x181: 0, 0x182: 1, 0x282: 2}
    assert group.places(OBJECTS["position_actual"]) == {(1, 0): 1, (2, 0): 3}
    with pytest.raises(struct.error):
        group.pack(values[:-1])
    with pytest.raises(ValueError, match="0x181"):
        PdoGroup([tpdo(1), tpdo(1)])


def test_places_tell_axes_apart() -> None:
    second = tuple(entry.on_axis(1) for entry in STATUS)
    group = PdoGroup([tpdo(1), Pdo(1, Direction.TRANSMIT, 2, second)])
    assert group.places(OBJECTS["statusword"]) == {(1, 0): 0, (1, 1): 2}


def test_one_cob_id_in_both_directions_is_refused() -> None:
    receive = Pdo(9, Direction.RECEIVE, 1, CONTROL, cob_id=0x181)
    with pytest.raises(ConfigError, match="node 1 TPDO 1 and node 9 RPDO 1 have one COB-ID, 0x181"):
        check_cob_ids([tpdo(1), receive])


FIXED = [kind for kind in ObjectType if kind.format in ("b", "h", "i", "q", "B", "H", "I", "Q")]


@given(st.sampled_from(FIXED), st.data())
def test_whole_numbers_come_back_as_they_were(kind: ObjectType, data: st.DataObject) -> None:
    signed = kind.format.islower()
    low, high = (
        (-(1 << kind.bits - 1), (1 << kind.bits - 1) - 1) if signed else (0, (1 << kind.bits) - 1)
    )
    value = data.draw(st.integers(low, high))
    packed = kind.pack(value)
    assert packed == value.to_bytes(kind.bits // 8, "little", signed=signed)
    assert kind.unpack(packed + b"junk") == value
    with pytest.raises(ValueError, match="does not fit"):
        kind.pack(high + 1)
    with pytest.raises(ValueError, match="bytes for"):
        kind.unpack(packed[:-1])


def test_text_and_numbers_of_types() -> None:
    assert ObjectType.TEXT.unpack(b"EPOS4\0\0") == "EPOS4"
    assert ObjectType.TEXT.pack("abc") == b"abc"
    assert object_type(0x07) is ObjectType.U32
    assert object_type(0x1234) is ObjectType.BYTES
    with pytest.raises(ValueError, match="is no domain"):
        ObjectType.DOMAIN.pack(3)


# Bus load: the figures of docs and facts, 6 axes.


def pdos(size_out: int, sizes_in: tuple[int, ...]) -> list[Pdo]:
    six = (OBJECTS["statusword"], OBJECTS["position_actual"])
    eight = (OBJECTS["velocity_actual"], OBJECTS["position_actual"])
    by_size = {6: six, 8: eight}
    out = [Pdo(node, Direction.RECEIVE, 1, by_size[size_out]) for node in range(1, 7)]
    return out + [
        Pdo(node, Direction.TRANSMIT, number, by_size[size])
        for node in range(1, 7)
        for number, size in enumerate(sizes_in, start=1)
    ]


@pytest.mark.parametrize(
    ("size_out", "sizes_in", "frames", "least", "most"),
    [(6, (6,), 13, 1.187, 1.435), (8, (8,), 13, 1.379, 1.675), (6, (6, 8), 19, 1.853, 2.245)],
)
def test_the_time_of_a_cycle_of_six_axes(
    size_out: int, sizes_in: tuple[int, ...], frames: int, least: float, most: float
) -> None:
    load = cycle_load(pdos(size_out, sizes_in), period=0.004, bitrate=1_000_000)
    assert load.frames == frames
    assert load.bits / 1000 == pytest.approx(least)
    assert load.worst / 1000 == pytest.approx(most)


def test_frames_with_every_other_sync_count_half() -> None:
    slow = cycle_load([tpdo(1, transmission=2)], period=0.001, bitrate=1_000_000)
    assert slow.frames == 1.5
    assert slow.bits == plain_bits(0) + plain_bits(6) / 2


def test_a_cycle_that_does_not_fit_is_refused_with_the_arithmetic() -> None:
    load = cycle_load(pdos(6, (6,)), period=0.001, bitrate=1_000_000, heartbeats=[0.1] * 6)
    with pytest.raises(ConfigError) as caught:
        check_load(load, 0.8, "can0")
    text = str(caught.value)
    assert "13 frames of 1.19 to 1.44 ms in a period of 1 ms at 1000 kbit/s" in text
    assert "119% to 144% of the bus" in text
    assert "80% are allowed" in text
    assert "A period of 1.80 ms would fit" in text
    check_load(cycle_load(pdos(6, (6,)), period=0.0018, bitrate=1_000_000), 0.8)


def test_heartbeats_alone_can_be_too_many() -> None:
    with pytest.raises(ConfigError, match="Heartbeats alone"):
        check_load(BusLoad(1, 47, 55, 20_000.0, 10_000, 1.0), 0.8)


def test_the_bits_of_known_frames() -> None:
    # Identifier 0 without data is 34 zeros with its CRC: every fifth is followed by a stuff bit.
    assert exact_bits(0x000, b"") == plain_bits(0) + 6
    assert plain_bits(0) == 47
    assert plain_bits(8) == 111
    assert worst_bits(8) == 135
    assert exact_bits(0x555, b"\x55" * 8) < exact_bits(0x555, bytes(8))


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_a_frame_is_between_its_bounds(cob_id: int, data: bytes) -> None:
    assert plain_bits(len(data)) <= exact_bits(cob_id, data) <= worst_bits(len(data))


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_the_virtual_bus_counts_the_same_bits(cob_id: int, data: bytes) -> None:
    assert exact_bits(cob_id, data) == frames.exact_bits(frames.pack(cob_id, data))
