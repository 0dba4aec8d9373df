"""The pace of the serial line to the tool, in virtual time."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.ur.signals.tool_line import BAUD_RATES, LineSettings, ToolLine

DT = 0.002


def settings(**changes):
    return LineSettings(enabled=True, **changes)


def run(line, seconds, start=0.0):
    """Advance in control periods; what each side got, with the time at which it was complete."""
    tool, client = [], []
    for tick in range(1, round(seconds / DT) + 1):
        now = start + tick * DT
        for got, to in zip(line.advance(now), (tool, client), strict=True):
            if got:
                to.append((now, got))
    return tool, client


@pytest.mark.parametrize(
    ("parity", "stop_bits", "bits"), [(0, 1, 10), (1, 1, 11), (2, 1, 11), (0, 2, 11), (2, 2, 12)]
)
def test_a_character_has_all_its_bits(parity, stop_bits, bits):
    line = settings(baud=9600, parity=parity, stop_bits=stop_bits)
    assert line.character == pytest.approx(bits / 9600)


@given(
    baud=st.sampled_from(BAUD_RATES),
    sizes=st.lists(st.integers(1, 300), min_size=1, max_size=5),
)
def test_no_byte_is_lost_reordered_or_too_early(baud, sizes):
    line = ToolLine(settings(baud=baud))
    sent = bytes(range(256)) * 6
    offset = 0
    for size in sizes:
        line.put(sent[offset : offset + size], to_tool=True)
        offset += size
    duration = offset * line.settings.character
    tool, client = run(line, duration + 0.1)
    assert b"".join(data for _, data in tool) == sent[:offset]
    assert client == []
    assert tool[-1][0] >= duration - 1e-9
    arrived = 0
    for now, data in tool:
        arrived += len(data)
        assert arrived <= now / line.settings.character + 1e-3


def test_bytes_pass_one_after_the_other():
    line = ToolLine(settings(baud=9600))
    line.put(bytes(96), to_tool=True)  # 0.1 s
    tool, _ = run(line, 0.05)
    assert sum(len(data) for _, data in tool) == pytest.approx(44, abs=2)


def test_an_answer_waits_until_the_line_is_free_and_comes_as_one_message():
    line = ToolLine(settings(baud=9600, rx_idle=40.0))
    line.put(bytes(48), to_tool=True)
    line.put(b"answer", to_tool=False)
    tool, client = run(line, 0.3)
    ((now, data),) = client
    assert data == b"answer"
    assert now >= tool[-1][0] + (6 + 40) * line.settings.character - DT


def test_silence_parts_two_messages_of_the_tool():
    line = ToolLine(settings(rx_idle=10.0))
    line.put(b"one", to_tool=False)
    _, first = run(line, 0.02)
    line.put(b"two", to_tool=False)
    _, second = run(line, 0.02, start=0.02)
    assert [data for _, data in first + second] == [b"one", b"two"]


def test_a_tool_that_never_pauses_is_heard_all_the_same():
    line = ToolLine(settings(baud=115200, rx_idle=40.0))
    line.put(bytes(5000), to_tool=False)
    _, client = run(line, 0.3)
    assert sum(len(data) for _, data in client) > 3000


def test_the_line_rests_before_a_message_to_the_tool():
    line = ToolLine(settings(baud=9600, tx_idle=40.0))
    line.put(b"ab", to_tool=False)
    line.put(b"cd", to_tool=True)
    tool, _ = run(line, 0.2)
    assert tool[-1][0] >= (2 + 40 + 2) * line.settings.character


def test_what_no_line_can_carry_is_lost_not_kept():
    line = ToolLine(settings(baud=9600))
    for _ in range(100):
        line.put(bytes(65536), to_tool=True)
    assert line._waiting == 65536
