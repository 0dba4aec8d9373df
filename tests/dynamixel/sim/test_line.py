"""When bytes cross a simulated line: reckoned on a clock that the tests hold, delivered on a real tty."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crtk_sim_backends.dynamixel.bus import make_servos
from crtk_sim_backends.dynamixel.config import parse_servos
from crtk_sim_backends.dynamixel.injection import KINDS, REPLIES
from crtk_sim_backends.dynamixel.line import Line
from crtk_sim_backends.faults import check_fault
from crtk_sim_backends.kit.tty import Tty
from rigs.dynamixel_clients import POSITION, Wire, instruction, read, statuses, sync_read

NOW = 10.0
MBPS = 1_000_000
BYTE = 10 / MBPS
NUMBERS = tuple(range(1, 13))
SERVOS = ",".join(f"{number}:xm430-w350" for number in NUMBERS)

Make = Callable[..., Line]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[Make]:
    lines = []

    def build(return_delay: int = 0, baud: int = MBPS, **options: object) -> Line:
        port = Tty(tmp_path / "bus")
        port.plug()
        servos = make_servos(parse_servos(SERVOS), baud, return_delay)
        settings: dict[str, object] = {"lead": 0.0, "latency": 0.0, "chain": "stalls", **options}
        line = Line("bus1", port, servos, seed=0, trace=lambda packet, at: None, **settings)  # type: ignore[arg-type]
        lines.append(line)
        return line

    yield build
    for line in lines:
        line.unplug()


def dues(line: Line) -> list[float]:
    """When everything that is under way will be handed over."""
    found = []
    while line.due < math.inf:
        found.append(line.due)
        line.deliver(line.due)
    return found


@pytest.mark.parametrize("baud", [57600, MBPS, 4_000_000])
@pytest.mark.parametrize("return_delay", [0, 250])
def test_one_answer(make: Make, baud: int, return_delay: int) -> None:
    line = make(return_delay, baud)
    request = read(1, POSITION, 4)
    line.receive(request, NOW, 1.0, baud)
    expected = NOW + (len(request) + 15) * 10 / baud + return_delay * 2e-6
    assert dues(line) == pytest.approx([expected], abs=1e-9)


def test_a_chain_of_answers_is_handed_over_every_millisecond_and_at_its_end(make: Make) -> None:
    line = make(return_delay=50)
    request = sync_read(POSITION, 4, *NUMBERS)
    line.receive(request, NOW, 1.0, MBPS)
    begin = NOW + len(request) * BYTE
    each = 100e-6 + 15 * BYTE
    found = dues(line)
    assert found[-1] == pytest.approx(begin + 12 * each, abs=1e-9)
    for due in found:
        assert (due - begin) / each == pytest.approx(round((due - begin) / each), abs=1e-6)
    gaps = [b - a for a, b in zip([begin, *found], found, strict=False)]
    assert max(gaps) < 1e-3 + each
    with Wire(str(line.port.link)):
        pass


def test_the_bytes_arrive(make: Make) -> None:
    line = make()
    with Wire(str(line.port.link)) as wire:
        line.receive(sync_read(POSITION, 4, 1, 2), NOW, 1.0, MBPS)
        dues(line)
        assert [s.number for s in statuses(wire.receive(30))] == [1, 2]


def test_the_lead_is_taken_off(make: Make) -> None:
    line = make(lead=80e-6)
    line.receive(read(1, POSITION, 4), NOW, 1.0, MBPS)
    assert dues(line) == pytest.approx([NOW - 80e-6 + 29 * BYTE], abs=1e-9)


def test_instructions_without_an_answer_occupy_the_wire(make: Make) -> None:
    line = make()
    write_all = instruction(254, 0x83, b"\x74\x00\x04\x00" + b"\x01\x00\x08\x00\x00" * 20)
    request = read(1, POSITION, 4)
    line.receive(write_all, NOW, 1.0, MBPS)
    line.receive(request, NOW + 20e-6, 1.0, MBPS)
    expected = NOW + (len(write_all) + len(request) + 15) * BYTE
    assert dues(line) == pytest.approx([expected], abs=1e-9)


def test_without_timing_all_is_due_at_once(make: Make) -> None:
    line = make(return_delay=250, lead=None)
    line.receive(sync_read(POSITION, 4, *NUMBERS), NOW, 1.0, MBPS)
    assert dues(line) == [NOW]


@pytest.mark.parametrize("latency", [1e-3, 16e-3])
def test_an_adapter_hands_over_at_multiples_of_its_latency(make: Make, latency: float) -> None:
    line = make(latency=latency)
    at = NOW + 0.3 * latency
    line.receive(read(1, POSITION, 4), at, 1.0, MBPS)
    (due,) = dues(line)
    assert due / latency == pytest.approx(round(due / latency), abs=1e-6)
    assert at + 29 * BYTE <= due < at + 29 * BYTE + latency


def test_those_behind_a_missing_one_wait_or_are_silent(make: Make) -> None:
    request = sync_read(POSITION, 4, 1, 99, 2)
    ends = {}
    for chain in ("stalls", "goes_on"):
        line = make(chain=chain)
        line.receive(request, NOW, 1.0, MBPS)
        ends[chain] = dues(line)[-1] - NOW - len(request) * BYTE
        line.unplug()
    assert ends["stalls"] == pytest.approx(15 * BYTE, abs=1e-9)
    assert ends["goes_on"] == pytest.approx(30 * BYTE + 1e-3, abs=1e-9)


def test_a_client_in_time_does_not_collide_and_one_too_early_does(make: Make) -> None:
    line = make()
    request = read(1, POSITION, 4)
    line.receive(request, NOW, 1.0, MBPS)
    end = NOW + 29 * BYTE
    line.deliver(end)
    line.receive(request, end, 1.0, MBPS)
    assert line.statistics.collisions == 0
    line.receive(request, end + 16 * BYTE, 1.0, MBPS)
    assert line.statistics.collisions == 1
    assert dues(line) == []


WIRE_KINDS = (*REPLIES, "lost", "late", "echo", "latency", "stall", "silent")
TALK = st.one_of(
    st.binary(max_size=30),
    st.builds(
        instruction,
        st.sampled_from([1, 2, 254]),
        st.sampled_from([1, 2, 3, 5, 8, 0x82, 0x83, 0x8A, 0x92]),
        st.binary(max_size=12),
    ),
    st.just(sync_read(POSITION, 10, 1, 2, 3)),
    st.just(sync_read(POSITION, 10, 1, 2, 3, code=0x8A)),
)


@given(
    kinds=st.lists(st.sampled_from(WIRE_KINDS), unique=True),
    numbers=st.lists(st.sampled_from([-1, 1, 2]), min_size=1, max_size=3),
    talk=st.lists(st.tuples(TALK, st.floats(0.0, 0.2)), max_size=10),
    timed=st.booleans(),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
def test_whatever_is_said_and_whatever_is_broken_the_line_lives(
    make: Make,
    kinds: list[str],
    numbers: list[int],
    talk: list[tuple[bytes, float]],
    timed: bool,
) -> None:
    line = make(lead=0.0 if timed else None)
    for kind in kinds:
        for number in numbers if "id" in KINDS[kind].parameters else [-1]:
            given_id = {"id": number} if number != -1 else {}
            line.begin(check_fault(KINDS, kind, given_id, "test"))
    now = NOW
    for data, pause in talk:
        line.receive(data, now, now, MBPS)
        now += pause
        line.deliver(now)
    line.deliver(math.inf)
    assert line.due == math.inf
    line.unplug()
