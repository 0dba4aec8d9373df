"""The state machine of the simulated drive, its options, its supply and its faults (CiA 402-2, 8.4)."""

import pytest

from rigs.canopen_drive import COUNTS, PV, Bench

SOD, RTSO, SO, OE, QSA, FRA, FAULT = 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08
MASKS = {SOD: 0x4F, FRA: 0x4F, FAULT: 0x4F}
SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP, OFF, RESET = 0x06, 0x07, 0x0F, 0x02, 0x00, 0x80


@pytest.fixture
def bench():
    return Bench()


def state_of(bench):
    word = bench.read(0x6041, 0, "H")
    return next(
        state
        for state in (SOD, FRA, FAULT, RTSO, SO, OE, QSA)
        if word & MASKS.get(state, 0x6F) == state
    )


def bring_to(bench, state):
    words = {
        SOD: (), RTSO: (SHUTDOWN,), SO: (SHUTDOWN, SWITCH_ON),
        OE: (SHUTDOWN, SWITCH_ON, ENABLE), QSA: (SHUTDOWN, SWITCH_ON, ENABLE, QUICK_STOP),
    }  # fmt: skip
    if state == FAULT:
        bench.axis.fault(0x1000)
        return
    if state == QSA:
        bench.write(0x605A, 0, 6, "h")
    for word in words[state]:
        bench.control(word)
    assert state_of(bench) == state


@pytest.mark.parametrize(
    ("before", "word", "after"),
    [
        (SOD, SHUTDOWN, RTSO),  # 2
        (SOD, SWITCH_ON, SOD),
        (SOD, ENABLE, SOD),
        (SOD, QUICK_STOP, SOD),
        (RTSO, SWITCH_ON, SO),  # 3
        (RTSO, ENABLE, OE),  # 3 and 4
        (RTSO, OFF, SOD),  # 7
        (RTSO, QUICK_STOP, SOD),
        (SO, ENABLE, OE),  # 4
        (SO, SHUTDOWN, RTSO),  # 6
        (SO, OFF, SOD),  # 10
        (SO, QUICK_STOP, SOD),
        (OE, SWITCH_ON, SO),  # 5
        (OE, SHUTDOWN, RTSO),  # 8
        (OE, OFF, SOD),  # 9
        (OE, QUICK_STOP, QSA),  # 11, with option 6
        (QSA, OFF, SOD),  # 12
        (QSA, ENABLE, OE),  # 16
        (QSA, SHUTDOWN, QSA),
        (FAULT, SHUTDOWN, FAULT),
        (FAULT, ENABLE, FAULT),
        (FAULT, RESET, SOD),  # 15
        (OE, RESET | ENABLE, OE),  # a reset is for faults
    ],
)
def test_transition(bench, before, word, after):
    bring_to(bench, before)
    bench.write(0x605A, 0, 6, "h")
    bench.control(word)
    bench.run(0.05)
    assert state_of(bench) == after


def test_fault_is_reset_by_an_edge(bench):
    bench.control(RESET)
    bench.axis.fault(0x1000)
    bench.control(RESET)
    assert state_of(bench) == FAULT  # the bit was set before
    bench.control(OFF)
    bench.control(RESET)
    assert state_of(bench) == SOD


def moving(bench, revolutions=20.0):
    """Turn with a constant velocity, revolutions a second."""
    bench.write(0x60FF, 0, int(revolutions * COUNTS), "i")
    bench.enable(PV)
    bench.until(lambda: bench.velocity() > 0.99 * revolutions * COUNTS)


def time_until(bench, state):
    start = bench.now
    bench.until(lambda: state_of(bench) == state)
    return bench.now - start


# From 20 revolutions/s: 0.2 s with 6084 (100 1/s²), 0.05 s with 6085 (400 1/s²).
RAMPS = {"none": (0.0, 0.03), "quick": (0.045, 0.08), "slow": (0.19, 0.25), "limit": (0.015, 0.09)}


@pytest.mark.parametrize(
    ("option", "ramp"), [(0, "none"), (1, "slow"), (2, "quick"), (3, "limit"), (4, "limit")]
)
def test_quick_stop_option_that_disables(bench, option, ramp):
    bench.write(0x605A, 0, option, "h")
    moving(bench)
    bench.control(QUICK_STOP)
    low, high = RAMPS[ramp]
    assert low <= time_until(bench, SOD) <= high


@pytest.mark.parametrize(("option", "ramp"), [(5, "slow"), (6, "quick"), (7, "limit")])
def test_quick_stop_option_that_stays(bench, option, ramp):
    bench.write(0x605A, 0, option, "h")
    moving(bench)
    bench.control(QUICK_STOP)
    start = bench.now
    bench.until(lambda: abs(bench.velocity()) < 0.02 * COUNTS)
    low, high = RAMPS[ramp]
    assert low <= bench.now - start <= high
    bench.run(0.5)
    assert state_of(bench) == QSA
    where = bench.position()
    bench.run(0.2)
    assert abs(bench.position() - where) < 5


def test_quick_stop_that_disables_cannot_be_left(bench):
    bench.write(0x605A, 0, 1, "h")
    moving(bench)
    bench.control(QUICK_STOP)
    bench.control(ENABLE)
    assert state_of(bench) == QSA
    time_until(bench, SOD)


@pytest.mark.parametrize(
    ("index", "option", "word", "after", "ramp"),
    [
        (0x605B, 0, SHUTDOWN, RTSO, "none"),
        (0x605B, 1, SHUTDOWN, RTSO, "slow"),
        (0x605C, 0, SWITCH_ON, SO, "none"),
        (0x605C, 1, SWITCH_ON, SO, "slow"),
    ],
)
def test_shutdown_and_disable_options(bench, index, option, word, after, ramp):
    bench.write(index, 0, option, "h")
    moving(bench)
    bench.control(word)
    low, high = RAMPS[ramp]
    assert low <= time_until(bench, after) <= high


@pytest.mark.parametrize(("option", "ramp"), [(0, "none"), (1, "slow"), (2, "quick")])
def test_fault_reaction_option(bench, option, ramp):
    bench.write(0x605E, 0, option, "h")
    moving(bench)
    bench.axis.fault(0x4310)
    if option:
        assert state_of(bench) == FRA
    low, high = RAMPS[ramp]
    assert low <= time_until(bench, FAULT) <= high


def test_enable_ends_a_ramp_that_would_disable(bench):
    moving(bench)
    bench.control(SWITCH_ON)
    bench.run(0.05)
    bench.control(ENABLE)
    bench.run(0.5)
    assert state_of(bench) == OE
    assert bench.velocity() > 19 * COUNTS


def test_halt_stops_and_goes_on(bench):
    moving(bench)
    bench.control(ENABLE | 0x100)
    bench.until(lambda: abs(bench.velocity()) < 0.02 * COUNTS)
    bench.run(0.1)
    assert state_of(bench) == OE
    assert bench.statusword & 0x0400
    bench.control(ENABLE)
    bench.until(lambda: bench.velocity() > 19 * COUNTS)


def test_without_supply_it_can_be_reached_and_not_switched_on(bench):
    assert bench.statusword & 0x0010
    bench.axis.set_supply(False)
    assert not bench.statusword & 0x0010
    assert bench.read(0x6079) == 0
    bench.control(SHUTDOWN)
    bench.control(SWITCH_ON)
    assert state_of(bench) == RTSO
    bench.axis.set_supply(True)
    bench.control(SWITCH_ON)
    assert state_of(bench) == SO


def test_losing_the_supply_while_enabled_is_a_fault(bench):
    bench.enable()
    bench.axis.set_supply(False)
    bench.run(0.01)
    assert state_of(bench) == FAULT
    assert bench.emergencies() == [0x3220]
    assert bench.read(0x603F, 0, "H") == 0x3220
    bench.control(RESET)
    assert state_of(bench) == FAULT  # the cause is there still
    bench.axis.set_supply(True)
    bench.control(OFF)
    bench.control(RESET)
    assert state_of(bench) == SOD


@pytest.mark.parametrize("state", [SOD, RTSO, SO])
def test_safe_torque_off_disables_without_a_fault(bench, state):
    bring_to(bench, state)
    bench.axis.set_safe_torque_off(True)
    bench.run(0.01)
    assert state_of(bench) == SOD
    assert bench.statusword & 0x0080
    assert bench.emergencies() == [0xFF01]
    assert bench.read(0x60FD) & 8
    bench.control(SHUTDOWN)
    assert state_of(bench) == SOD
    bench.axis.set_safe_torque_off(False)
    bench.run(0.01)
    assert bench.emergencies() == [0]
    bench.control(SHUTDOWN)
    assert state_of(bench) == RTSO


def test_safe_torque_off_in_motion_lets_the_brake_stop_the_motor(bench):
    moving(bench)
    bench.axis.set_safe_torque_off(True)
    assert state_of(bench) == FAULT
    bench.run(0.05)
    assert bench.velocity() == 0
    assert bench.read(0x6077, 0, "h") == 0
    bench.control(RESET)
    assert state_of(bench) == FAULT


def test_stopped_node_does_what_6007_says(bench):
    bench.write(0x6007, 0, 2, "h")
    bench.start()
    bench.enable()
    bench.frame(0, bytes((2, bench.node)))
    assert bench.statusword & 0x4F == SOD


def test_nothing_moves_because_of_enable(bench):
    bench.write(0x607A, 0, 5 * COUNTS, "i")
    before = bench.position()
    bench.enable(1)
    bench.run(0.3)
    assert abs(bench.position() - before) < 5
