"""NMT, heartbeat and EMCY of the simulated drive (CiA 301, 7.2.7 and 7.2.8)."""

import pytest

from crtk_sim_backends.canopen.emcy import register_of
from rigs.canopen_drive import NODE, VALID_BIT, Bench

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 0x7F, 0x05, 0x04


@pytest.fixture
def bench():
    return Bench()


def beat(bench):
    """State that the next heartbeat tells."""
    bench.write(0x1017, 0, 10, "H")
    bench.take(0x700 + NODE)
    bench.run(0.02)
    return bench.take(0x700 + NODE)[-1][0]


def test_boots(bench):
    assert bench.sent == [(0x700 + NODE, b"\0")]
    assert beat(bench) == PRE_OPERATIONAL


@pytest.mark.parametrize("address", [0, NODE])
@pytest.mark.parametrize(("command", "state"), [(0x01, OPERATIONAL), (0x80, PRE_OPERATIONAL)])
def test_follows_commands(bench, command, state, address):
    bench.frame(0, bytes((command, address)))
    assert beat(bench) == state


@pytest.mark.parametrize("frame", ["01 06", "01", "01 05 00", "33 05", ""])
def test_is_not_meant_by(bench, frame):
    bench.frame(0, frame)
    assert beat(bench) == PRE_OPERATIONAL


def test_stopped_node_says_nothing_but_its_heartbeat(bench):
    bench.write(0x1017, 0, 10, "H")
    bench.frame(0, bytes((2, NODE)))
    bench.sent.clear()
    assert bench.frame(0x600 + NODE, "40 00 10 00 00 00 00 00") == []
    assert bench.frame(0x80) == []
    bench.axis.fault(0x2310)
    bench.run(0.05)
    assert {identifier for identifier, _ in bench.sent} == {0x700 + NODE}
    assert set(bench.take(0x700 + NODE)) == {bytes((STOPPED,))}


def test_heartbeat_keeps_its_period(bench):
    bench.write(0x1017, 0, 50, "H")
    bench.sent.clear()
    bench.run(1.0)
    assert len(bench.sent) in (20, 21)


def test_reset_of_the_node_forgets_everything(bench):
    bench.write(0x6065, 0, 77)
    bench.write(0x1017, 0, 100, "H")
    bench.axis.fault(0x2310)
    bench.sent.clear()
    bench.frame(0, bytes((0x81, NODE)))
    assert bench.frame(0x600 + NODE, "40 00 10 00 00 00 00 00") == []  # while it boots
    bench.run(0.2)
    assert bench.sent == [(0x700 + NODE, b"\0")]
    assert bench.read(0x6065) == 65536
    assert bench.read(0x1017, 0, "H") == 0
    assert bench.read(0x603F, 0, "H") == 0
    assert bench.read(0x1003, 0, "B") == 0
    assert bench.statusword & 0x6F == 0x40


def test_reset_of_communication_keeps_the_drive(bench):
    bench.write(0x6065, 0, 77)
    bench.write(0x1017, 0, 100, "H")
    bench.control(6)
    bench.frame(0, bytes((0x82, NODE)))
    bench.run(0.2)
    assert bench.read(0x6065) == 77
    assert bench.read(0x1017, 0, "H") == 0
    assert bench.statusword & 0x6F == 0x21


def lose_heartbeat(bench, option, behaviour):
    """Let the heartbeat of node 127 begin, and stay away."""
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.write(0x6007, 0, option, "h")
    bench.write(0x1029, 1, behaviour, "B")
    bench.start()
    bench.enable()
    for _ in range(5):
        bench.frame(0x77F, b"\x05")
        bench.run(0.05)
    assert bench.emergencies() == []
    assert bench.statusword & 0x6F == 0x27
    bench.run(0.5)


@pytest.mark.parametrize(("option", "status"), [(0, 0x27), (1, 0x08), (2, 0x40), (3, 0x40)])
def test_lost_heartbeat_stops_the_drive_as_6007_says(bench, option, status):
    lose_heartbeat(bench, option, behaviour=1)
    assert bench.emergencies()[0] == 0x8130
    assert bench.statusword & 0x6F & (0x6F if status == 0x27 else 0x4F) == status
    assert bench.drive.state == OPERATIONAL


@pytest.mark.parametrize(
    ("behaviour", "state"), [(0, PRE_OPERATIONAL), (1, OPERATIONAL), (2, STOPPED)]
)
def test_lost_heartbeat_changes_the_state_as_1029_says(bench, behaviour, state):
    lose_heartbeat(bench, 0, behaviour)
    assert bench.drive.state == state


def test_heartbeat_that_returns_ends_the_error(bench):
    lose_heartbeat(bench, 0, behaviour=1)
    bench.emergencies()
    bench.frame(0x77F, b"\x05")
    bench.run(0.01)
    assert bench.read(0x1001, 0, "B") == 0


def test_drive_that_has_been_stalled_itself_does_not_miss_the_heartbeat(bench):
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.frame(0x77F, b"\x05")
    bench.now += 0.5  # nobody calls it; the heartbeats of this time are heard afterwards
    bench.run(0.01)
    bench.frame(0x77F, b"\x05")
    bench.run(0.09)
    assert bench.emergencies() == []
    bench.run(0.02)
    assert bench.emergencies() == [0x8130]


def test_heartbeat_that_has_never_come_is_not_missed(bench):
    bench.write(0x1016, 1, 127 << 16 | 100)
    bench.run(1.0)
    assert bench.emergencies() == []


def test_emcy_has_code_register_and_vendor_bytes(bench):
    bench.axis.fault(0x2310, b"\x01\x02\x03\x04\x05")
    bench.run(0.01)
    assert [d.hex(" ") for d in bench.take(0x80 + NODE)] == ["10 23 03 01 02 03 04 05"]
    assert bench.read(0x1001, 0, "B") == 0x03
    assert bench.read(0x1003, 0, "B") == 1
    assert bench.read(0x1003, 1) == 0x02012310
    assert bench.read(0x603F, 0, "H") == 0x2310


def test_emcy_tells_that_errors_are_gone(bench):
    bench.axis.fault(0x4310)
    bench.run(0.01)
    assert bench.emergencies() == [0x4310]
    bench.control(0x00)
    assert bench.statusword & 0x4F == 0x08
    answers = bench.frame(0x600 + NODE, "2b 40 60 00 80 00 00 00")
    assert (0x80 + NODE, "00 00 00 00 00 00 00 00") in answers
    assert bench.read(0x603F, 0, "H") == 0
    assert bench.read(0x1001, 0, "B") == 0


@pytest.mark.parametrize(
    ("code", "register"),
    [(0x1000, 0x01), (0x2310, 0x03), (0x3220, 0x05), (0x4310, 0x09), (0x8130, 0x11),
     (0x8611, 0x21), (0xFF01, 0x81), (0x7305, 0x01)],
)  # fmt: skip
def test_error_register_tells_the_class(code, register):
    assert register_of(code) == register


def test_history_is_newest_first_and_can_be_erased(bench):
    for code in range(0x1000, 0x100A):
        bench.drive.emergency.once(code)
    assert bench.read(0x1003, 0, "B") == 8
    assert [bench.read(0x1003, n) for n in (1, 8)] == [0x1009, 0x1002]
    assert bench.abort_of(bench.write, 0x1003, 0, 1, "B") == 0x06090030
    bench.write(0x1003, 0, 0, "B")
    assert bench.read(0x1003, 0, "B") == 0


def test_emcy_keeps_its_inhibit_time(bench):
    bench.write(0x1015, 0, 500, "H")  # 50 ms
    for code in (0x1000, 0x1001, 0x1002):
        bench.drive.emergency.once(code)
    bench.run(0.04)
    assert len(bench.emergencies()) == 1
    bench.run(0.1)
    assert len(bench.emergencies()) == 2


def test_emcy_can_have_another_identifier_or_none(bench):
    assert bench.abort_of(bench.write, 0x1014, 0, 0x181) == 0x06090030  # while it exists
    bench.write(0x1014, 0, VALID_BIT)
    bench.sent.clear()
    bench.axis.fault(0x1000)
    bench.run(0.01)
    assert bench.sent == []
    bench.write(0x1014, 0, 0x181)
    bench.axis.fault(0x2310)
    bench.run(0.01)
    assert bench.emergencies() == []
    assert len(bench.take(0x181)) == 1
