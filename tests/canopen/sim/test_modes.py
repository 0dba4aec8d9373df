"""The modes of operation of the simulated drive, with its motor (CiA 402-2, 10 to 16)."""

import itertools
import math
import struct

import pytest

from crtk_sim_backends.canopen.plant import MotorConfig
from rigs.canopen_drive import COUNTS, CSP, CST, CSV, IP, NODE, PP, PV, TQ, Bench

REACHED, LIMIT, ACK, ERROR = 0x0400, 0x0800, 0x1000, 0x2000


@pytest.fixture
def bench():
    return Bench()


def go_to(bench, position, bits=0):
    """The handshake of a new set-point; the drive has acknowledged it when this returns."""
    bench.write(0x607A, 0, position, "i")
    bench.control(0x1F | bits)
    assert bench.statusword & ACK
    bench.control(0x0F | bits)


def test_supported_modes_are_those_that_can_be_chosen(bench):
    supported = bench.read(0x6502)
    for mode in range(1, 11):
        refused = bench.abort_of(bench.write, 0x6060, 0, mode, "b")
        assert bool(supported >> mode - 1 & 1) == (not refused)
        if not refused:
            assert bench.read(0x6061, 0, "b") == mode


# Profile position


def test_pp_goes_there_with_its_profile(bench):
    bench.enable(PP)
    go_to(bench, 10 * COUNTS)
    assert not bench.statusword & (ACK | REACHED)
    top = 0
    start = bench.now
    while not bench.statusword & REACHED:
        bench.run(0.002)
        top = max(top, bench.velocity())
    # 10 revolutions at 10 1/s with ramps of 0.1 s: 1.1 s
    assert bench.now - start == pytest.approx(1.1, abs=0.02)
    assert top == pytest.approx(10 * COUNTS, rel=0.03)
    assert bench.position() == pytest.approx(10 * COUNTS, abs=10)


def test_pp_waits_for_the_bit_to_fall_before_it_takes_the_next(bench):
    bench.enable(PP)
    bench.write(0x607A, 0, COUNTS, "i")
    bench.control(0x1F)
    bench.run(1.0)
    assert bench.statusword & ACK
    bench.write(0x607A, 0, 2 * COUNTS, "i")
    bench.control(0x1F)
    bench.run(1.0)
    assert bench.position() == pytest.approx(COUNTS, abs=10)
    bench.control(0x0F)
    assert not bench.statusword & ACK
    bench.control(0x1F)
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.position() == pytest.approx(2 * COUNTS, abs=10)


def test_pp_takes_a_bit_for_an_edge_that_was_set_before_it_was_enabled(bench):
    bench.mode(PP)
    bench.write(0x607A, 0, COUNTS, "i")
    for word in (0x06, 0x17, 0x1F):
        bench.control(word)
    assert bench.statusword & ACK
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.position() == pytest.approx(COUNTS, abs=10)


def test_pp_keeps_a_second_set_point_until_the_first_is_reached(bench):
    bench.enable(PP)
    go_to(bench, 2 * COUNTS)
    go_to(bench, 1 * COUNTS)
    assert bench.statusword & ACK  # no room for a third
    highest = 0
    while bench.statusword & ACK:
        bench.run(0.002)
        highest = max(highest, bench.position())
    assert highest == pytest.approx(2 * COUNTS, rel=0.01)
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.position() == pytest.approx(COUNTS, abs=10)


def test_pp_changes_at_once_when_told_so(bench):
    bench.enable(PP)
    go_to(bench, 20 * COUNTS)
    bench.run(0.3)
    go_to(bench, 0, bits=0x20)
    highest = 0
    while not bench.statusword & REACHED:
        bench.run(0.002)
        highest = max(highest, bench.position())
    assert highest < 4 * COUNTS
    assert bench.position() == pytest.approx(0, abs=10)


def test_pp_blends_into_the_next_set_point(bench):
    bench.enable(PP)
    go_to(bench, 2 * COUNTS)
    go_to(bench, 4 * COUNTS, bits=0x200)
    slowest = math.inf
    while bench.position() < 3 * COUNTS:
        bench.run(0.002)
        if bench.position() > COUNTS:
            slowest = min(slowest, bench.velocity())
    assert slowest > 9 * COUNTS


@pytest.mark.parametrize(("option", "end"), [(0, 3.0), (2, 2.0)])
def test_pp_relative(bench, option, end):
    bench.write(0x60F2, 0, option, "H")
    bench.enable(PP)
    go_to(bench, COUNTS)
    bench.until(lambda: bench.statusword & REACHED)
    bench.write(0x6040, 0, 0x0F, "H")
    go_to(bench, COUNTS, bits=0x40)
    bench.run(0.01)
    go_to(bench, COUNTS, bits=0x60)  # relative to the last target, or to where it is
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.position() == pytest.approx(end * COUNTS, rel=0.01)


def test_pp_needs_an_edge_after_a_change_of_the_mode(bench):
    bench.enable(PP)
    bench.write(0x607A, 0, COUNTS, "i")
    bench.control(0x1F)
    bench.until(lambda: bench.statusword & REACHED)
    bench.mode(PV)
    bench.mode(PP)
    bench.write(0x607A, 0, 5 * COUNTS, "i")
    bench.control(0x3F)
    bench.run(0.5)
    assert bench.position() == pytest.approx(COUNTS, abs=10)


def test_pp_stays_within_the_software_limits(bench):
    bench.write(0x607D, 2, COUNTS, "i")
    bench.enable(PP)
    go_to(bench, 5 * COUNTS)
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.statusword & LIMIT
    assert bench.position() == pytest.approx(COUNTS, abs=10)


# Profile velocity and torque


def test_pv_ramps_and_tells_when_it_is_there(bench):
    bench.write(0x60FF, 0, 10 * COUNTS, "i")
    bench.enable(PV)
    assert bench.statusword & ACK  # speed 0
    start = bench.now
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.now - start == pytest.approx(0.1, abs=0.02)
    assert not bench.statusword & ACK
    bench.write(0x60FF, 0, -10 * COUNTS, "i")
    bench.until(lambda: bench.velocity() < -9.9 * COUNTS)
    assert bench.now - start == pytest.approx(0.3, abs=0.05)


def test_pv_stops_before_a_software_limit(bench):
    bench.write(0x607D, 2, 2 * COUNTS, "i")
    bench.write(0x60FF, 0, 10 * COUNTS, "i")
    bench.enable(PV)
    bench.run(2.0)
    assert bench.position() <= 2 * COUNTS + 100
    assert bench.statusword & LIMIT
    bench.write(0x60FF, 0, -10 * COUNTS, "i")
    bench.until(lambda: bench.velocity() < -9 * COUNTS)


def test_pv_stops_at_a_limit_switch():
    bench = Bench(MotorConfig(positive_limit=2.0, stops=(-3.0, 3.0)))
    bench.write(0x60FF, 0, 5 * COUNTS, "i")
    bench.enable(PV)
    bench.run(2.0)
    assert 2.0 <= bench.axis.revolutions < 2.5
    assert bench.read(0x60FD) & 0b011 == 0b010


def test_tq_ramps_the_torque_and_the_speed_stays_limited(bench):
    bench.write(0x6071, 0, 500, "h")
    bench.write(0x6087, 0, 5000)
    bench.enable(TQ)
    bench.run(0.05)
    assert bench.read(0x6074, 0, "h") == pytest.approx(250, abs=10)
    bench.run(1.0)
    assert bench.velocity() == pytest.approx(50 * COUNTS, rel=0.02)  # 6080: 3000 rpm
    assert bench.statusword & LIMIT


def test_torque_limits(bench):
    bench.write(0x60E0, 0, 100, "H")
    bench.write(0x6071, 0, 500, "h")
    bench.enable(TQ)
    bench.run(0.2)
    assert bench.read(0x6077, 0, "h") == 100
    assert bench.statusword & LIMIT


# Cyclic modes


def cyclic(bench, mode, target, period=0.004):
    """Bring a drive to a cyclic mode, with one synchronous RPDO of controlword and target."""
    bits = 16 if target == 0x6071 else 32
    bench.map(0x1400, 0, [(0x6040, 0, 16), (target, 0, bits)], kind=1)
    bench.write(0x60C2, 1, round(period * 1000), "B")
    bench.mode(mode)
    bench.start()
    layout = "<Hh" if bits == 16 else "<Hi"
    bench.sync_period = period

    def send(value, word=0x0F):
        bench.frame(0x200 + NODE, struct.pack(layout, word, round(value)))
        bench.run(period)

    for word in (6, 7, 15):
        send(bench.position() if target == 0x607A else 0, word)
    send(bench.position() if target == 0x607A else 0)
    assert bench.statusword & 0x6F == 0x27
    return send


@pytest.mark.parametrize("period", [0.001, 0.004, 0.010])
def test_csp_follows_a_sine(period):
    bench = Bench(step=0.001)
    send = cyclic(bench, CSP, 0x607A, period)
    worst = 0.0
    for n in range(int(1.0 / period)):
        wanted = COUNTS * (1 - math.cos(2 * math.pi * n * period))
        send(wanted)
        worst = max(worst, abs(bench.read(0x60F4, 0, "i")))
        assert bench.statusword & ACK
    assert worst < COUNTS / 20
    bench.run(0.1)
    assert bench.position() == pytest.approx(wanted, abs=50)


def test_csp_interpolates_between_two_sync():
    bench = Bench(step=0.001)
    send = cyclic(bench, CSP, 0x607A, 0.010)
    for n in range(20):
        send(1000 * n)
    bench.frame(0x200 + NODE, struct.pack("<Hi", 0x0F, 20000))
    demands = []
    for _ in range(20):
        bench.run(0.001)
        demands.append(bench.read(0x6062, 0, "i"))
    steps = {b - a for a, b in itertools.pairwise(demands) if b != a}
    assert steps <= set(range(99, 102))


def test_csp_jump_is_a_following_error(bench):
    send = cyclic(bench, CSP, 0x607A)
    bench.write(0x6065, 0, COUNTS // 4)
    send(50 * COUNTS)
    bench.run(0.2)
    assert bench.statusword & 0x4F == 0x08
    assert 0x8611 in bench.emergencies()


def test_following_error_can_be_switched_off(bench):
    send = cyclic(bench, CSP, 0x607A)
    bench.write(0x6065, 0, 0xFFFFFFFF)
    send(50 * COUNTS)
    bench.run(0.2)
    assert bench.statusword & 0x6F == 0x27


def test_csp_stays_within_the_software_limits(bench):
    bench.write(0x607D, 2, COUNTS // 100, "i")
    send = cyclic(bench, CSP, 0x607A)
    for n in range(50):
        send(n * 100)
    bench.run(0.1)
    assert bench.position() == pytest.approx(COUNTS // 100, abs=10)
    assert bench.statusword & LIMIT


def test_csp_adds_its_offset(bench):
    bench.write(0x60B0, 0, 300, "i")
    send = cyclic(bench, CSP, 0x607A)
    for _ in range(20):
        send(0)
    bench.run(0.2)
    assert bench.position() == pytest.approx(300, abs=5)


def test_csv_follows_and_adds_its_offset(bench):
    bench.write(0x60B1, 0, COUNTS, "i")
    send = cyclic(bench, CSV, 0x60FF)
    for _ in range(100):
        send(4 * COUNTS)
    assert bench.velocity() == pytest.approx(5 * COUNTS, rel=0.01)
    assert bench.statusword & ACK


def test_cst_accelerates_the_motor_with_its_inertia():
    bench = Bench(MotorConfig(viscous=0.0, coulomb=0.0, inertia=1e-3))
    send = cyclic(bench, CST, 0x6071)
    start = bench.velocity()
    for _ in range(50):
        send(100)
    expected = 0.1 / 1e-3 * 50 * 0.004 / (2 * math.pi) * COUNTS  # 0.1 N·m
    assert bench.velocity() - start == pytest.approx(expected, rel=0.05)


def test_cst_holds_a_load_that_hangs():
    bench = Bench(MotorConfig(gravity=0.2, coulomb=0.02, brake=False))
    send = cyclic(bench, CST, 0x6071)
    for _ in range(200):
        send(200)
    assert abs(bench.velocity()) < 5 * COUNTS
    for _ in range(100):
        send(100)
    assert bench.velocity() < -5 * COUNTS


def test_position_is_held_against_gravity():
    bench = Bench(MotorConfig(gravity=0.5))
    bench.enable(PP)
    bench.run(0.5)
    assert abs(bench.position()) < COUNTS / 100
    assert bench.read(0x6077, 0, "h") == pytest.approx(500, abs=20)


def test_ip_interpolates_while_it_is_active(bench):
    bench.enable(IP)
    assert not bench.statusword & ACK
    bench.write(0x60C1, 1, 1000, "i")
    bench.run(0.1)
    assert abs(bench.position()) < 5
    bench.control(0x1F)
    assert bench.statusword & ACK
    bench.write(0x60C1, 1, 2000, "i")
    bench.run(0.2)
    assert bench.position() == pytest.approx(2000, abs=5)


# Changes and faults


@pytest.mark.parametrize("mode", [PP, CSP, IP])
def test_change_of_the_mode_in_motion_stops_it_where_it_is(bench, mode):
    bench.write(0x60FF, 0, 5 * COUNTS, "i")
    bench.enable(PV)
    bench.run(0.5)
    here = bench.position()
    bench.mode(mode)
    bench.run(0.5)
    assert abs(bench.position() - here) < COUNTS
    assert bench.statusword & 0x6F == 0x27


def test_change_to_csv_does_not_use_an_old_target(bench):
    bench.write(0x60FF, 0, 5 * COUNTS, "i")
    bench.enable(CSV)
    bench.run(0.2)
    assert abs(bench.velocity()) < 10


def test_stuck_motor_is_a_following_error_in_pp(bench):
    bench.enable(PP)
    bench.axis.motor.stuck = True
    go_to(bench, 5 * COUNTS)
    bench.until(lambda: bench.statusword & 0x4F == 0x08, 2.0)
    assert bench.read(0x603F, 0, "H") == 0x8611
    assert bench.statusword & 0x4F == 0x08


@pytest.mark.parametrize("reaction", [0, 2])
def test_motor_that_was_stuck_does_not_catch_up_when_enabled_again(bench, reaction):
    bench.write(0x605E, 0, reaction, "h")
    bench.enable(PP)
    bench.axis.motor.stuck = True
    go_to(bench, 5 * COUNTS)
    bench.until(lambda: bench.statusword & 0x4F == 0x08, 2.0)
    bench.axis.motor.stuck = False
    bench.run(0.1)
    here = bench.position()
    bench.control(0)
    bench.control(0x80)
    bench.enable()
    bench.run(0.5)
    assert bench.position() == pytest.approx(here, abs=10)


def test_stuck_motor_is_blocked_in_pv(bench):
    bench.write(0x60FF, 0, 5 * COUNTS, "i")
    bench.enable(PV)
    bench.axis.motor.stuck = True
    bench.write(0x60F8, 0, COUNTS, "i")
    bench.run(0.5)
    assert bench.statusword & ERROR  # slippage
    bench.until(lambda: bench.read(0x603F, 0, "H") == 0x7121, 3.0)


def test_position_beyond_a_limit_switch_is_a_fault():
    bench = Bench(MotorConfig(positive_limit=2.0))
    bench.enable(PP)
    go_to(bench, 5 * COUNTS)
    bench.until(lambda: bench.statusword & 0x4F == 0x08, 3.0)
    assert bench.read(0x603F, 0, "H") == 0x8612


# Units and axes


@pytest.mark.parametrize("polarity", [0, 0xC0])
def test_units_are_those_of_608f_6091_6092_and_607e(polarity):
    bench = Bench(MotorConfig(start=3.0))
    bench.write(0x608F, 1, 4000)
    bench.write(0x6091, 1, 50)  # gear 50:1
    bench.write(0x6092, 1, 360_000)  # millidegrees of the shaft
    bench.write(0x607E, 0, polarity, "B")
    sign = -1 if polarity else 1
    assert bench.position() == sign * round(3 / 50 * 360_000)
    assert bench.read(0x6063, 0, "i") == 12_000
    bench.write(0x6081, 0, 36_000)
    bench.write(0x6083, 0, 360_000)
    bench.write(0x6084, 0, 360_000)
    bench.enable(PP)
    go_to(bench, sign * 72_000)
    bench.until(lambda: bench.statusword & REACHED)
    assert bench.axis.revolutions == pytest.approx(10.0, abs=0.02)


def test_velocity_factor(bench):
    bench.write(0x6096, 1, 60)
    bench.write(0x6096, 2, COUNTS)  # velocities in rpm
    bench.write(0x60FF, 0, 300, "i")
    bench.enable(PV)
    bench.run(1.0)
    assert bench.velocity() == pytest.approx(300, abs=2)
    assert bench.axis.velocity == pytest.approx(5 * COUNTS, rel=0.01)


def test_axes_of_a_node_are_independent():
    bench = Bench(MotorConfig(), MotorConfig(start=1.0), MotorConfig(start=2.0))
    assert bench.read(0x1000) == 0xFFFF0192
    assert [bench.read(0x67FF + 0x800 * n) for n in range(3)] == [0x00020192] * 3
    assert [bench.read(0x6064 + 0x800 * n, 0, "i") for n in range(3)] == [0, COUNTS, 2 * COUNTS]
    bench.map(0x1400, 1, [(0x6840, 0, 16), (0x6860, 0, 8), (0x687A, 0, 32)], kind=255)
    bench.map(0x1800, 1, [(0x6841, 0, 16), (0x6864, 0, 32)], kind=1)
    bench.start()
    for word in (6, 7, 15, 31):
        bench.frame(0x300 + NODE, struct.pack("<Hbi", word, PP, 3 * COUNTS))
    bench.run(1.0)
    assert [a.machine.state.value for a in bench.drive.axes] == [0x40, 0x27, 0x40]
    answers = dict(bench.frame(0x80))
    status, position = struct.unpack("<Hi", bytes.fromhex(answers[0x280 + NODE]))
    assert status & 0x046F == 0x0427
    assert position == pytest.approx(3 * COUNTS, abs=10)
    bench.drive.axes[2].fault(0x4310)
    assert bench.read(0x703F, 0, "H") == 0x4310
    assert bench.read(0x603F, 0, "H") == 0
