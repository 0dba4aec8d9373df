"""PDOs and SYNC of the simulated drive: mapping, transmission types and timers (CiA 301, 7.2.2)."""

import struct

import pytest

from rigs.canopen_drive import CSP, NODE, VALID_BIT, Bench

STATUS = (0x6041, 0, 16)
POSITION = (0x6064, 0, 32)
CONTROL = (0x6040, 0, 16)
TARGET = (0x607A, 0, 32)
TPDO, RPDO = 0x1800, 0x1400


@pytest.fixture
def bench():
    return Bench()


def frames(bench, identifier, seconds):
    bench.take(identifier)
    bench.run(seconds)
    return bench.take(identifier)


def test_default_pdo_1(bench):
    bench.start()
    answers = bench.frame(0x200 + NODE, "06 00")
    assert answers == [(0x180 + NODE, "31 02")]
    assert bench.read(0x1800, 1) == 0x40000185
    assert bench.read(0x1801, 1) == 0xC0000285


def test_mapping_is_written_and_used(bench):
    bench.map(TPDO, 0, [STATUS, POSITION, (0x6061, 0, 8)], kind=1)
    bench.start()
    assert bench.frame(0x80) == [(0x180 + NODE, "50 02 00 00 00 00 00")]


@pytest.mark.parametrize(
    ("entry", "abort"),
    [
        (0x30000008, 0x06020000),  # no such object
        (0x60410110, 0x06090011),  # no such sub-index
        (0x605A0010, 0x06040041),  # not to be mapped
        (0x60400110, 0x06090011),
        (0x607D0020, 0x06040041),  # number of entries
        (0x60410020, 0x06040041),  # wrong length
        (0x00070020, 0x06020000),  # dummies are for RPDOs
    ],
)
def test_tpdo_refuses_to_map(bench, entry, abort):
    bench.write(0x1801, 1, VALID_BIT | 0x285)
    bench.write(0x1A01, 0, 0, "B")
    assert bench.abort_of(bench.write, 0x1A01, 1, entry) == abort


def test_rpdo_takes_dummies_and_refuses_what_cannot_be_written(bench):
    bench.map(RPDO, 1, [(0x0005, 0, 8), (0x0007, 0, 32), CONTROL], kind=255)
    bench.start()
    bench.frame(0x300 + NODE, "ff ff ff ff ff 06 00")
    assert bench.read(0x6040, 0, "H") == 6
    bench.frame(0, bytes((0x80, NODE)))
    bench.write(0x1401, 1, VALID_BIT | 0x305)
    bench.write(0x1601, 0, 0, "B")
    assert bench.abort_of(bench.write, 0x1601, 1, 0x60410010) == 0x06040041


def test_order_of_a_new_mapping_is_enforced(bench):
    write, abort_of = bench.write, bench.abort_of
    assert abort_of(write, 0x1A00, 0, 0, "B") == 0x06010000  # the PDO exists
    assert abort_of(write, 0x1800, 1, 0x186) == 0x06090030  # nor may its identifier change
    assert abort_of(write, 0x1800, 3, 10, "H") == 0x06090030  # nor its inhibit time
    write(0x1800, 1, VALID_BIT | 0x185)
    assert abort_of(write, 0x1A00, 1, 0x60640020) == 0x06010000  # while entries count
    write(0x1A00, 0, 0, "B")
    write(0x1A00, 1, 0x60640020)
    write(0x1A00, 2, 0x60640020)
    write(0x1A00, 3, 0x60410010)
    assert abort_of(write, 0x1A00, 0, 3, "B") == 0x06040042  # 80 bits
    assert abort_of(write, 0x1A00, 0, 9, "B") == 0x06040042
    write(0x1A00, 0, 2, "B")
    write(0x1800, 1, 0x185)


def test_mapping_stays_while_operational(bench):
    bench.start()
    bench.write(0x1800, 1, VALID_BIT | 0x185)
    assert bench.abort_of(bench.write, 0x1A00, 0, 0, "B") == 0x08000022


@pytest.mark.parametrize("identifier", [0x000, 0x080, 0x180, 0x581, 0x605, 0x705, 0x800])
def test_restricted_identifiers_are_refused(bench, identifier):
    bench.write(0x1800, 1, VALID_BIT | 0x185)
    assert bench.abort_of(bench.write, 0x1800, 1, identifier) == 0x06090030


@pytest.mark.parametrize("kind", [241, 251, 252, 253])
def test_reserved_transmission_types_are_refused(bench, kind):
    assert bench.abort_of(bench.write, 0x1800, 2, kind, "B") == 0x06090030


@pytest.mark.parametrize("every", [1, 2, 5, 240])
def test_tpdo_with_every_nth_sync(bench, every):
    bench.map(TPDO, 0, [STATUS], kind=every)
    bench.start()
    sent = [bool(bench.frame(0x80)) for _ in range(3 * every)]
    assert sent == ([False] * (every - 1) + [True]) * 3


def test_acyclic_synchronous_tpdo_is_sent_when_it_has_changed(bench):
    bench.map(TPDO, 0, [STATUS], kind=0)
    bench.start()
    assert len(bench.frame(0x80)) == 1
    assert bench.frame(0x80) == []
    bench.frame(0x200 + NODE, "06 00")
    assert bench.frame(0x80) == [(0x180 + NODE, "31 02")]
    assert bench.frame(0x80) == []


def test_synchronous_rpdo_is_applied_with_sync(bench):
    bench.map(RPDO, 0, [CONTROL, TARGET], kind=1)
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.start()
    bench.frame(0x200 + NODE, "06 00 39 30 00 00")
    assert bench.read(0x607A, 0, "i") == 0
    assert bench.frame(0x80) == [(0x180 + NODE, "50 02")]  # sampled before it is applied
    assert bench.read(0x607A, 0, "i") == 12345
    assert bench.frame(0x80) == [(0x180 + NODE, "31 02")]


def synchronous(bench):
    """The drive, with an RPDO and a TPDO that go with SYNC."""
    bench.map(RPDO, 1, [CONTROL], kind=1)
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.start()
    return bench.drive


def test_the_samples_leave_before_sync_is_acted_on(bench):
    drive = synchronous(bench)
    assert not drive.on_frame(0x300 + NODE, b"\x06\x00", bench.now)
    assert drive.on_frame(0x80, b"", bench.now) == [(0x180 + NODE, b"\x50\x02")]
    assert bench.axis.statusword() == 0x0250
    assert drive.act(bench.now) == []
    assert bench.axis.statusword() == 0x0231


@pytest.mark.parametrize("when", ["another SYNC", "an RPDO", "a timer"])
def test_what_sync_made_valid_is_done_before_anything_else(bench, when):
    drive = synchronous(bench)
    drive.on_frame(0x300 + NODE, b"\x06\x00", bench.now)
    drive.on_frame(0x80, b"", bench.now)
    match when:
        case "another SYNC":
            (sample,) = drive.on_frame(0x80, b"", bench.now)
            assert sample == (0x180 + NODE, b"\x31\x02")
        case "an RPDO":
            assert not drive.keep(0x300 + NODE, b"\x00\x00", bench.now)
            drive.on_frame(0x300 + NODE, b"\x00\x00", bench.now)
        case "a timer":
            drive.on_timer(bench.now)
    assert bench.axis.statusword() == 0x0231


def test_an_rpdo_is_kept_until_sync(bench):
    drive = synchronous(bench)
    assert drive.keep(0x300 + NODE, b"\x06\x00", bench.now)
    assert not drive.keep(0x300 + NODE, b"\x06", bench.now)
    assert not drive.keep(0x80, b"", bench.now)
    assert bench.axis.statusword() == 0x0250
    bench.frame(0x80)
    assert bench.axis.statusword() == 0x0231


def test_an_error_that_sync_brings_is_told_at_once(bench):
    bench.map(RPDO, 1, [(0x6060, 0, 8)], kind=1)
    bench.start()
    bench.drive.on_frame(0x300 + NODE, b"\x7f", bench.now)
    assert not bench.drive.on_frame(0x80, b"", bench.now)
    ((identifier, data),) = bench.drive.act(bench.now)
    assert (identifier, data[:2]) == (0x80 + NODE, b"\x20\x63")


def test_only_the_last_rpdo_before_sync_counts(bench):
    bench.map(RPDO, 0, [TARGET], kind=1)
    bench.start()
    for value in (1, 2, 3):
        bench.frame(0x200 + NODE, struct.pack("<i", value))
    bench.frame(0x80)
    assert bench.read(0x607A, 0, "i") == 3


@pytest.mark.parametrize("state", [0x80, 0x02])
def test_no_pdo_unless_operational(bench, state):
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.start()
    bench.frame(0, bytes((state, NODE)))
    assert bench.frame(0x80) == []
    assert bench.frame(0x200 + NODE, "06 00") == []
    bench.start()
    assert bench.read(0x6040, 0, "H") == 0


def test_event_timer(bench):
    bench.write(0x1800, 5, 20, "H")
    bench.start()
    assert len(frames(bench, 0x185, 1.0)) in (49, 50, 51)


def test_inhibit_time(bench):
    bench.write(0x1800, 1, VALID_BIT | 0x185)
    bench.write(0x1800, 3, 1000, "H")  # 100 ms
    bench.write(0x1800, 1, 0x185)
    bench.start()
    bench.take(0x185)
    sent = []
    for word in ("06 00", "00 00") * 5:
        sent += [data for i, data in bench.frame(0x200 + NODE, word) if i == 0x185]
        bench.run(0.01)
    assert sent == []  # the first has been sent when the node became operational
    assert len(frames(bench, 0x185, 0.2)) <= 1
    bench.frame(0x200 + NODE, "06 00")
    bench.frame(0x200 + NODE, "00 00")
    bench.run(0.2)
    last = bench.take(0x185)
    assert not last or last[-1].hex(" ") == "50 02"


def test_inhibited_change_is_sent_when_the_time_is_over(bench):
    bench.write(0x1800, 1, VALID_BIT | 0x185)
    bench.write(0x1800, 3, 1000, "H")
    bench.write(0x1800, 1, 0x185)
    bench.start()
    bench.take(0x185)
    assert bench.frame(0x200 + NODE, "06 00") == []
    bench.run(0.09)
    assert bench.take(0x185) == []
    bench.run(0.02)
    assert [d.hex(" ") for d in bench.take(0x185)] == ["31 02"]


def test_sync_counter_and_start_value(bench):
    bench.write(0x1019, 0, 10, "B")
    bench.write(0x1801, 6, 4, "B")
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.map(TPDO, 1, [STATUS], kind=2)
    bench.start()
    with_2 = [n for n in range(1, 11) if len(bench.frame(0x80, bytes((n,)))) == 2]
    assert with_2 == [4, 6, 8, 10]


def test_sync_of_the_wrong_length_is_reported_once(bench):
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.start()
    assert bench.frame(0x80, b"\1") == [(0x80 + NODE, "40 82 11 01 00 00 00 00")]
    assert bench.frame(0x80, b"\1") == []
    assert (0x80 + NODE, "00 00 00 00 00 00 00 00") in bench.frame(0x80)


def test_sync_counter_can_be_set_last_and_is_gone_after_a_reset(bench):
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.write(0x1019, 0, 10, "B")
    bench.start()
    assert bench.frame(0x80, b"\1") == [(0x180 + NODE, "50 02")]
    bench.frame(0, bytes((0x82, NODE)))
    bench.run(1.0)
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.start()
    assert bench.frame(0x80) == [(0x180 + NODE, "50 02")]


def test_sync_counter_stays_while_there_is_a_cycle(bench):
    bench.write(0x1006, 0, 4000)
    assert bench.abort_of(bench.write, 0x1019, 0, 10, "B") == 0x08000022


def test_short_pdo_is_an_error_and_has_no_effect(bench):
    bench.map(RPDO, 0, [CONTROL, TARGET], kind=255)
    bench.start()
    assert bench.frame(0x200 + NODE, "06 00 01") == [(0x80 + NODE, "10 82 11 03 06 00 00 00")]
    assert bench.read(0x6040, 0, "H") == 0


def test_error_of_the_length_ends_with_the_next_right_pdo(bench):
    bench.map(RPDO, 0, [CONTROL], kind=1)
    bench.start()
    bench.frame(0x200 + NODE, "06")
    assert (0x80 + NODE, "00 00 00 00 00 00 00 00") in bench.frame(0x200 + NODE, "06 00")
    bench.frame(0x80)
    assert bench.read(0x6040, 0, "H") == 6


def test_long_pdo_is_an_error_and_has_its_effect(bench):
    bench.start()
    assert (0x80 + NODE, "20 82 11 03 02 00 00 00") in bench.frame(0x200 + NODE, "06 00 01")
    assert bench.read(0x6040, 0, "H") == 6


def test_value_out_of_range_in_a_pdo_is_reported_and_has_no_effect(bench):
    bench.map(RPDO, 0, [(0x6060, 0, 8)], kind=255)
    bench.start()
    assert bench.frame(0x200 + NODE, "02") == [(0x80 + NODE, "20 63 01 60 60 00 00 00")]
    assert bench.read(0x6060, 0, "b") == 0


def test_rpdo_that_stays_away_is_reported(bench):
    bench.write(0x1400, 5, 50, "H")
    bench.start()
    bench.run(0.2)
    assert bench.emergencies() == []  # it has not begun
    bench.frame(0x200 + NODE, "06 00")
    bench.run(0.2)
    assert bench.emergencies() == [0x8250]
    assert (0x80 + NODE, "00 00 00 00 00 00 00 00") in bench.frame(0x200 + NODE, "06 00")


def test_an_rpdo_that_is_kept_until_sync_keeps_its_deadline(bench):
    bench.map(RPDO, 1, [CONTROL], kind=1)
    bench.write(RPDO + 1, 5, 50, "H")
    bench.start()
    drive = bench.drive
    assert not drive.keep(0x300 + NODE, b"\x06\x00", bench.now)  # the first begins the deadline
    bench.frame(0x300 + NODE, "06 00")
    for _ in range(5):
        bench.run(0.03)
        assert drive.keep(0x300 + NODE, b"\x06\x00", bench.now)
    assert bench.emergencies() == []
    bench.run(0.06)
    assert bench.emergencies() == [0x8250]
    assert not drive.keep(0x300 + NODE, b"\x06\x00", bench.now)  # it ends the error


def test_cyclic_mode_faults_when_sync_stays_away(bench):
    bench.map(RPDO, 0, [CONTROL, TARGET], kind=1)
    bench.mode(CSP)
    bench.start()
    bench.sync_period = 0.004
    for word in (6, 7, 15):
        bench.frame(0x200 + NODE, struct.pack("<Hi", word, 0))
        bench.run(0.01)
    assert bench.statusword & 0x6F == 0x27
    bench.sync_period = None
    bench.run(0.45)
    assert bench.emergencies() == []
    bench.run(0.1)
    assert bench.emergencies() == [0x8700]
    assert bench.statusword & 0x4F == 0x08


def test_identifier_of_sync_can_be_changed(bench):
    bench.map(TPDO, 0, [STATUS], kind=1)
    bench.write(0x1005, 0, 0x81)
    bench.start()
    assert bench.frame(0x80) == []
    assert len(bench.frame(0x81)) == 1
    assert 0x81 in bench.drive.interests
    assert 0x80 not in bench.drive.interests
