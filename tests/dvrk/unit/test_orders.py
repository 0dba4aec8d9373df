"""What boards are told: known quadlets and bytes, and what the simulator's own codec makes of them."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crtk_driver_dvrk import packets
from crtk_driver_dvrk.orders import LONGEST_WATCHDOG, Motor, order, watchdog_counts
from crtk_sim_backends.dvrk import wire

MOTORS = st.builds(Motor, st.integers(0, 0xFFFF), st.sampled_from([None, True, False]))
SWITCH = st.sampled_from([None, True, False])


def test_currents_alone_touch_no_amplifier_and_no_power() -> None:
    told = order(7, {0: Motor(0x8000), 2: Motor(0x9234)})
    assert told == (0x706, 0x80008000, 0, 0x80009234, 0, 0)


def test_amplifiers_power_and_relay_are_masked_bits() -> None:
    told = order(6, {1: Motor(0x8000, True), 3: Motor(0x7FFF, False)}, power=True, relay=True)
    assert told == (0x606, 0, 0xB0008000, 0, 0xA0007FFF, 0x000F0000)
    assert order(6, {}, power=False)[-1] == 0x00080000
    assert order(6, {}, relay=False)[-1] == 0x00020000


def test_the_bytes_of_a_block() -> None:
    """Board 7 at node 1: 0.39 A on its first motor; both CRCs are those of CRC-32/BZIP2."""
    packet = packets.write_block(1, 0, order(7, {0: Motor(0x8800)}), 0)
    assert packet[:16] == bytes.fromhex("ff c1 00 10 ff d0 00 00 00 00 00 00 00 18 00 00")
    assert packet[16:20] == packets.crc(packet[:16]).to_bytes(4)
    assert packet[20:44] == bytes.fromhex("00 00 07 06 80 00 88 00" + " 00" * 16)
    assert packet[44:] == packets.crc(packet[20:44]).to_bytes(4)


@settings(max_examples=60)
@given(st.integers(0, 15), st.dictionaries(st.integers(0, 3), MOTORS), SWITCH, SWITCH, st.data())
def test_a_board_reads_what_was_written_and_nothing_that_was_damaged(
    board: int,
    motors: dict[int, Motor],
    power: bool | None,
    relay: bool | None,
    data: st.DataObject,
) -> None:
    told = order(board, motors, power=power, relay=relay)
    sent = packets.datagram(packets.write_block(3, 0, told, 0), 9, forward=True)
    found = wire.request(sent)
    assert found is not None
    assert (found.node, found.generation, found.code, found.data) == (3, 9, wire.BLOCK_WRITE, told)
    at = data.draw(st.integers(2, len(sent) - 1))
    change = data.draw(st.integers(1, 255))
    assert wire.request(sent[:at] + bytes([sent[at] ^ change]) + sent[at + 1 :]) is None
    assert wire.request(sent[: data.draw(st.integers(0, len(sent) - 1))]) is None


@pytest.mark.parametrize(
    "motors", [{4: Motor(0)}, {-1: Motor(0)}, {0: Motor(65536)}, {0: Motor(-1)}]
)
def test_what_no_board_has_is_not_written(motors: dict[int, Motor]) -> None:
    with pytest.raises(ValueError, match=r"axis|current"):
        order(7, motors)


def test_a_watchdog_is_counted_in_steps_of_5_microseconds() -> None:
    assert watchdog_counts(0.03) == 5760
    assert watchdog_counts(LONGEST_WATCHDOG) == 0xFFFF


@pytest.mark.parametrize("seconds", [0.0, 1e-6, -1.0, 0.4])
def test_no_watchdog_is_none(seconds: float) -> None:
    with pytest.raises(ValueError, match="watchdog"):
        watchdog_counts(seconds)
