"""The bus against simulated servos: every instruction, both protocols on one line, faults of a wire."""

import itertools
import struct
import time
from contextlib import suppress

import pytest

from crtk_driver_dynamixel.bus import Bus, ServoLink
from crtk_driver_dynamixel.groups import TRY_EVERY
from crtk_driver_dynamixel.replies import Failure, ServoRefused, ServoSilent
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.kit.serial_port import SerialPort
from crtk_sim_backends.dynamixel import SIM
from crtk_sim_backends.dynamixel.injection import stuffing_values
from rigs.waiting import LONG

MODERN = (1, 2, 3, 4)
LEGACY = (7, 8)
SERVOS = (
    "1:xm430-w350,2:xm430-w350,3:xl430-w250,4:xl330-m288,7:mx-28-1.0,8:mx-28-1.0;"
    "1:xm430-w350,2:xm430-w350,3:xm430-w350"
)
SHORT = 0.5
"""Seconds of patience with a servo that answers, where silence is waited for, too."""
BRIEF = 0.05
"""The same with one whose answer may be missing."""


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(servos=SERVOS, baud=1_000_000, return_delay=0) as running:
        yield running


def open_bus(sim, number=1, *, budget=LONG):
    links = dict.fromkeys(MODERN, ServoLink(return_delay=0.0))
    if number == 1:
        links |= dict.fromkeys(LEGACY, ServoLink(1, 0.0))
    bus = Bus(SerialPort(sim.ttys[f"bus{number}"]), links, latency_budget=budget)
    bus.open()
    return bus


@pytest.fixture
def mixed(sim):
    bus = open_bus(sim)
    yield bus
    bus.close()


@pytest.fixture
def chain(sim):
    """Three servos alike; faults are cleared when the test is over."""
    bus = open_bus(sim, 2)
    yield bus
    bus.close()
    sim.control.clear()


def inject(sim, kind, **parameters):
    sim.control.inject(kind, bus=2, **parameters)


def failures(result):
    return {reply.id: reply.failure for reply in result.replies if reply.failure}


def test_who_is_there(mixed):
    found = {ping.id: ping.model for ping in mixed.ping_many([*MODERN, *LEGACY], attempts=3)}
    assert found == {1: 1020, 2: 1020, 3: 1060, 4: 1200, 7: 0, 8: 0}
    assert mixed.ping(1).firmware > 40


def test_nobody_is_there(mixed):
    patient(mixed).set_link(99, return_delay=0.0)
    with pytest.raises(ServoSilent, match="id 99"):
        mixed.ping(99)


def test_a_register_is_written_and_read(mixed):
    mixed.write(1, 116, struct.pack("<i", 2100))
    assert mixed.read(1, 116, 4) == struct.pack("<i", 2100)
    mixed.write(7, 30, struct.pack("<H", 2100))
    assert mixed.read(7, 30, 2) == struct.pack("<H", 2100)


def test_refusals(mixed):
    with pytest.raises(ServoRefused, match="access error") as caught:
        mixed.write(1, 132, bytes(4))
    assert caught.value.error == 7
    with pytest.raises(ServoRefused, match=r"data (range|limit) error"):
        mixed.write(1, 11, b"\x63")


def test_a_servo_is_restarted(mixed):
    mixed.write(2, 65, b"\1")
    patient(mixed).reboot(2)
    deadline = time.monotonic() + LONG
    while not mixed.ping_many([2]) and time.monotonic() < deadline:
        pass
    assert mixed.read(2, 65, 1) == b"\0"


def test_groups_of_both_protocols_on_one_line(mixed):
    sync = mixed.sync_group(MODERN, 126, 10)
    fast = mixed.sync_group(MODERN, 126, 10, fast=True)
    bulk = mixed.bulk_group([(1, 126, 10), (3, 132, 4), (4, 146, 1)])
    fast_bulk = mixed.bulk_group([(1, 126, 10), (3, 132, 4), (4, 146, 1)], fast=True)
    legacy = mixed.bulk_group([(7, 36, 2), (8, 36, 8)])
    single = mixed.single_group([(7, 36, 2), (8, 36, 2)])
    for _ in range(5):
        for group in (sync, fast, bulk, fast_bulk, legacy, single):
            result = group.run()
            assert result.complete, failures(result)
            assert len(result.block) == sum(item.length for item in group.items)
    assert fast.is_fast
    assert fast_bulk.is_fast
    counters = mixed.line_counters
    assert (counters.garbage, counters.bad_crc, counters.strays) == (0, 0, 0)


def test_groups_are_written(mixed):
    write = mixed.write_group(MODERN, 116, 4)
    read = mixed.sync_group(MODERN, 116, 4)
    goals = struct.pack("<4i", 2000, 2001, 2002, 2003)
    write.run(goals)
    assert read.run().block == goals
    legacy = mixed.write_group(LEGACY, 30, 2)
    legacy.run(struct.pack("<2H", 1000, 1001))
    assert mixed.bulk_read([(7, 30, 2), (8, 30, 2)]).block == struct.pack("<2H", 1000, 1001)


@pytest.mark.parametrize("fast", [False, True])
def test_values_that_need_stuffing_arrive_as_they_are(sim, chain, fast):
    known = {struct.pack("<hii", *v) for v in itertools.islice(stuffing_values(3), 4000)}
    inject(sim, "stuffing", seed=3)
    group = chain.sync_group([1, 2, 3], 126, 10, fast=fast)
    for _ in range(60):
        result = group.run()
        assert result.complete, failures(result)
        assert set(result.data) <= known


@pytest.mark.sweep(3)
@pytest.mark.parametrize("behaviour", ["stalls", "goes_on"])
@pytest.mark.parametrize(("id", "fast"), [(1, False), (2, False), (2, True), (3, False), (3, True)])
def test_a_silent_servo_costs_its_own_data(sim, chain, behaviour, id, fast):
    group = chain.sync_group([1, 2, 3], 126, 10, fast=fast)
    assert group.run().complete
    inject(sim, "silent", id=id, chain=behaviour)
    patient(chain, but_for=[id])
    for _ in range(12):
        assert set(failures(group.run())) == {id}
    sim.control.clear()
    patient(chain)
    assert any(group.run().complete for _ in range(2 * TRY_EVERY))


def patient(bus, but_for=()):
    """A bus whose deadlines are short enough to wait for many of them, and long enough for a busy machine.

    But for servos whose answers may be missing. Those behind them are asked anew, and have a time of their
    own; so have those that are asked for one packet between them.
    """
    bus._latency_budget = BRIEF
    for id in MODERN:
        bus.set_link(id, return_delay=0.0 if id in but_for else SHORT)
    return bus


@pytest.mark.parametrize("fast", [False, True])
@pytest.mark.parametrize("kind", ["crc", "truncate", "drop", "noise", "duplicate_id"])
def test_a_fault_of_replies_costs_no_other_data(sim, chain, kind, fast):
    """Nothing wrong is taken, and what is not hit is there."""
    group = chain.sync_group([1, 2, 3], 0, 7, fast=fast)  # model, firmware: they never change
    right = group.run().block
    inject(sim, kind, id=2, every=3)
    patient(chain, but_for=[2])
    for _ in range(7):
        result = group.run()
        assert set(failures(result)) <= {2}
        for index, data in enumerate(result.data):
            assert data in (None, right[7 * index : 7 * index + 7])
    sim.control.clear()
    patient(chain)
    assert any(group.run().complete for _ in range(12))


def test_any_byte_may_be_damaged(sim, chain):
    group = chain.sync_group([1, 2, 3], 0, 7)
    right = group.run().block
    inject(sim, "corrupt", every=4)
    patient(chain, but_for=[1, 2, 3])
    for _ in range(40):
        for index, data in enumerate(group.run().data):
            assert data in (None, right[7 * index : 7 * index + 7])
    assert chain.line_counters.garbage > 0


def test_an_adapter_that_echoes(sim, chain):
    inject(sim, "echo")
    group = chain.sync_group([1, 2, 3], 126, 10)
    for _ in range(5):
        assert group.run().complete
    assert chain.ping(1).model == 1020
    assert chain.line_counters.echoes >= 6


def test_an_adapter_with_a_slow_timer_is_seen(sim, chain):
    """Shorter deadlines than the timer: replies are late, counted, and never taken for others."""
    chain._latency_budget = 0.004
    chain.revision += 1
    inject(sim, "latency", milliseconds=16.0)
    deadline = time.monotonic() + LONG
    # Who is held up for longer than the timer finds the reply there.
    while not sum(chain.counters(id).strays + chain.counters(id).timeouts for id in (1, 2, 3)):
        assert time.monotonic() < deadline
        for id, address in itertools.product((1, 2, 3), (7, 9)):
            with suppress(ServoSilent):
                data = chain.read(id, address, 1, attempts=1)
                assert address != 7 or data == bytes((id,))


def test_alerts_come_with_every_reply(sim, chain):
    inject(sim, "hardware_error", id=2, bit=5)
    group = chain.sync_group([1, 2, 3], 126, 10)
    result = group.run()
    assert [reply.alert for reply in result.replies] == [False, True, False]
    assert chain.sync_group([1, 2, 3], 126, 10, fast=True).run().alert
    assert chain.read(2, 70, 1) == bytes((1 << 5,))
    patient(chain).reboot(2)
    deadline = time.monotonic() + LONG
    while not chain.ping_many([2]) and time.monotonic() < deadline:
        pass
    assert not group.run().alert


def test_unplugged_and_plugged_in_again(sim, chain):
    group = chain.sync_group([1, 2, 3], 126, 10)
    assert group.run().complete
    inject(sim, "unplug")
    with pytest.raises(ConnectionLost):
        run_until_lost(group)
    sim.control.clear()
    chain.open()
    assert group.run().complete


def run_until_lost(group):
    deadline = time.monotonic() + LONG
    while time.monotonic() < deadline:
        group.run()


def test_another_rate_is_silence(chain):
    chain._latency_budget = SHORT
    chain.set_baud(57_600)
    assert chain.ping_many([1, 2]) == []
    chain.set_baud(1_000_000)
    assert [ping.id for ping in chain.ping_many([1, 2], attempts=3)] == [1, 2]


def test_the_reason_is_told_for_each_servo(sim, chain):
    chain = patient(chain)
    inject(sim, "silent", id=2)
    inject(sim, "crc", id=3)
    result = chain.sync_read([1, 2, 3], 126, 10)
    assert failures(result) == {2: Failure.SILENT, 3: Failure.CORRUPT}
