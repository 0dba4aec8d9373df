"""The lower layers of the CANopen driver against scripted nodes: bus, SDO, PDOs, heartbeats, cycle."""

from __future__ import annotations

import errno
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import can
import pytest

from crtk_driver_canopen.bus import BusAddress, CanLink
from crtk_driver_canopen.bus_state import BusLost, Condition
from crtk_driver_canopen.candump import CandumpLog
from crtk_driver_canopen.cycle import Cycle, KernelSync, SentSync
from crtk_driver_canopen.frames import Frame
from crtk_driver_canopen.heartbeat import (
    NmtCommand,
    NmtState,
    ensure_abort_option,
    ensure_heartbeat,
)
from crtk_driver_canopen.identity import Identity, WrongDevice, check_identity, read_identity
from crtk_driver_canopen.master import BootUp, Master
from crtk_driver_canopen.objects import OBJECTS, Entry, ObjectType
from crtk_driver_canopen.pdo import (
    Direction,
    Pdo,
    PdoGroup,
    PdoMismatch,
    configure,
    disable,
    read_back,
)
from crtk_driver_canopen.ports import MessagePort
from crtk_driver_canopen.sdo import ObjectIgnored, Sdo, SdoAborted, SdoSilent
from crtk_drivers.errors import ConfigError, ConnectionFailed, DataTimeout, DeviceError
from rigs.canopen_peer import ScriptedBus
from rigs.waiting import LONG

STATUS = (OBJECTS["statusword"], OBJECTS["position_actual"])
CONTROL = (OBJECTS["controlword"], OBJECTS["target_position"])


@pytest.fixture
def peers() -> Iterator[ScriptedBus]:
    with ScriptedBus(1, 2) as bus:
        yield bus


def address(channel: str, **options: object) -> BusAddress:
    return BusAddress("virtual", channel, 1_000_000, options)


@pytest.fixture
def link(peers: ScriptedBus) -> Iterator[CanLink]:
    with closing(CanLink(address(peers.channel))) as link:
        link.open()
        yield link


@pytest.fixture
def master(link: CanLink) -> Master:
    return Master(link, {1: 1.0, 2: 1.0}, sdo_timeout=LONG)


def deadline() -> float:
    return time.monotonic() + LONG


# Opening


@pytest.mark.parametrize(
    ("where", "error", "text"),
    [
        (BusAddress("nonsense", "x", 1), ConfigError, "interfaces: .*crtk"),
        (BusAddress("slcan", "/dev/nonesuch", 1_000_000), ConnectionFailed, "canopen slcan /dev"),
        (BusAddress("slcan", "/dev/null", 123), (ConfigError, ConnectionFailed), "canopen slcan"),
        (BusAddress("crtk", "/nonexistent.sock", 1_000_000), ConnectionFailed, "no CAN hub"),
        (BusAddress("socketcand", "can0", 1_000_000), ConfigError, "needs host and port"),
        (
            BusAddress("socketcand", "can0", 1_000_000, {"host": "127.77.0.1", "port": 1}),
            ConnectionFailed,
            "refused",
        ),
    ],
)
def test_a_bus_that_cannot_be_opened(where: BusAddress, error: type[Exception], text: str) -> None:
    link = CanLink(where)
    with pytest.raises(error, match=text):
        link.open()
    assert not link.is_open
    with pytest.raises(BusLost, match="not open"):
        link.send(Frame(0, b""))


# SDO


def test_objects_are_read_and_written(peers: ScriptedBus, master: Master) -> None:
    sdo = Sdo(master.sdo(1))
    assert sdo.read(OBJECTS["position_actual"]) == 100
    sdo.write(OBJECTS["target_position"], -5)
    assert peers[1].values[0x607A, 0] == -5
    assert sdo.read_text(OBJECTS["device_name"]) == "scripted servo drive"
    long = Entry(0x2000, 0, ObjectType.BYTES, "data")
    data = bytes(range(200))
    master.sdo(1).download(0x2000, 0, data)
    assert master.sdo(1).upload(long.index, 0) == data
    large = bytes(500)  # in blocks, which this node refuses: then in segments
    master.sdo(1).download(0x2000, 0, large)
    assert peers[1].values[0x2000, 0] == large


def test_an_abort_names_node_object_and_reason(master: Master) -> None:
    sdo = Sdo(master.sdo(1))
    with pytest.raises(SdoAborted) as caught:
        sdo.write(OBJECTS["statusword"], 1)
    assert caught.value.code == 0x06010002
    assert "canopen virtual" in str(caught.value)
    assert "node 1: write of 6041h:00 statusword refused: object can only be read" in str(
        caught.value
    )
    assert sdo.find(OBJECTS["home_offset"]) is None
    with pytest.raises(SdoAborted, match="no such object"):
        Sdo(master.sdo(1), axis=1).read(OBJECTS["statusword"])


def test_a_node_that_does_not_answer(peers: ScriptedBus, link: CanLink) -> None:
    peers[2].silent = True
    with pytest.raises(SdoSilent, match="node 2: read of 1018h:01 vendor id: no answer"):
        Sdo(Master(link, sdo_timeout=0.1).sdo(2)).read(OBJECTS["vendor_id"])


def test_a_value_that_is_not_kept_is_told(peers: ScriptedBus, master: Master) -> None:
    peers[1].ignore.add((0x605A, 0))
    with pytest.raises(
        ObjectIgnored, match="605Ah:00 quick stop option: 6 was acknowledged, but the node holds 2"
    ):
        Sdo(master.sdo(1)).ensure(OBJECTS["quick_stop_option"], 6)


def test_other_threads_transfer_while_the_owner_polls(master: Master) -> None:
    found: list[int] = []

    def read() -> None:
        found.extend(Sdo(master.sdo(node)).read(OBJECTS["position_actual"]) for node in (1, 2))

    thread = threading.Thread(target=read)
    thread.start()
    assert master.poll(deadline(), lambda: len(found) == 2)
    thread.join()
    assert found == [100, 200]


def test_what_was_asked_before_a_reconnect_is_not_written_after_it(
    peers: ScriptedBus, link: CanLink, master: Master
) -> None:
    """A job of several writes has a thread of its own, and goes on while the bus is opened anew."""
    is_open, errors = threading.Event(), list[Exception]()
    sdo = Sdo(master.sdo(1))
    sdo.write(OBJECTS["target_position"], -5)

    def write() -> None:
        is_open.wait(LONG)
        try:
            sdo.write(OBJECTS["target_position"], 7)
        except DeviceError as error:
            errors.append(error)

    thread = threading.Thread(target=write)
    thread.start()
    master.close()
    link.close()
    link.open()
    again = Master(link, sdo_timeout=LONG)
    assert Sdo(again.sdo(1)).read(OBJECTS["position_actual"]) == 100
    is_open.set()
    assert again.poll(deadline(), lambda: not thread.is_alive()) or not thread.is_alive()
    thread.join()
    assert [type(error) for error in errors] == [BusLost]
    assert Sdo(again.sdo(1)).read(OBJECTS["target_position"]) == -5


# Identity


def test_who_a_node_is(master: Master) -> None:
    found = read_identity(Sdo(master.sdo(2)))
    assert (found.profile, found.vendor, found.product, found.serial) == (402, 0x1234, 0x402, 1002)
    assert "scripted servo drive" in str(found)
    check_identity(found, Identity(vendor=0x1234, serial=1002), "node 2")
    with pytest.raises(WrongDevice, match="serial number is 1002, not 7") as caught:
        check_identity(found, Identity(serial=7, product=0x403), "node 2")
    assert "product is 0x00000402, not 0x00000403" in str(caught.value)
    with pytest.raises(WrongDevice, match="profile 401, not 402"):
        check_identity(Identity(device_type=401), Identity(), "node 2")


# PDO configuration


def pdo(node: int, direction: Direction, entries: tuple[Entry, ...], **more: int) -> Pdo:
    return Pdo(node, direction, 1, entries, **more)


def test_a_pdo_is_written_in_order_and_only_when_it_differs(
    peers: ScriptedBus, master: Master
) -> None:
    sdo = Sdo(master.sdo(1))
    wanted = pdo(1, Direction.TRANSMIT, STATUS, event_timer=20)
    assert read_back(sdo, wanted)
    assert configure(sdo, wanted)
    assert not read_back(sdo, wanted)
    written = peers[1].log
    assert written == [
        (0x1800, 1),
        (0x1A00, 0),
        (0x1A00, 1),
        (0x1A00, 2),
        (0x1A00, 0),
        (0x1800, 2),
        (0x1800, 5),
        (0x1800, 1),
    ]
    assert not configure(sdo, wanted)
    assert peers[1].log is written
    assert len(written) == 8
    disable(sdo, 1, Direction.TRANSMIT, 1)
    assert "not valid" in read_back(sdo, wanted)[0]
    disable(sdo, 1, Direction.TRANSMIT, 4)  # it has none


def test_a_pdo_that_the_node_does_not_keep_is_named(peers: ScriptedBus, master: Master) -> None:
    peers[1].ignore.add((0x1A00, 2))
    with pytest.raises(PdoMismatch) as caught:
        configure(Sdo(master.sdo(1)), pdo(1, Direction.TRANSMIT, STATUS))
    text = str(caught.value)
    assert "node 1 TPDO 1 was written, but" in text
    assert "1A00h:02 object 2 in TPDO 1" in text
    assert "wanted 0x60640020 (6064h:00 position actual, 32 bit)" in text
    assert "found 0x00000000" in text


def test_an_object_that_cannot_be_mapped(master: Master) -> None:
    entries = (OBJECTS["statusword"], OBJECTS["digital_inputs"])
    with pytest.raises(SdoAborted, match="cannot be mapped"):
        configure(Sdo(master.sdo(1)), pdo(1, Direction.TRANSMIT, entries))


# Heartbeats


def test_heartbeats_are_written_and_watched(peers: ScriptedBus, master: Master) -> None:
    sdo = Sdo(master.sdo(1))
    peers[1].values[0x1016, 1] = 5 << 16 | 100  # it watches another node already
    ensure_heartbeat(sdo, produced_ms=20, watched=127, watched_ms=300)
    assert peers[1].values[0x1016, 2] == 127 << 16 | 300
    ensure_heartbeat(sdo, produced_ms=20, watched=127, watched_ms=200)  # in the same entry
    assert peers[1].values[0x1016, 1] == 5 << 16 | 100
    peers[1].values[0x1016, 1] = 0
    ensure_heartbeat(sdo, produced_ms=20, watched=127, watched_ms=300)
    assert (peers[1].values[0x1016, 1], peers[1].values[0x1016, 2]) == (0, 127 << 16 | 300)
    peers[1].values[0x1016, 1] = 5 << 16 | 100
    assert master.poll(deadline(), lambda: master.watch.nodes[1].heartbeats >= 3)
    assert master.watch.nodes[1].state == NmtState.PRE_OPERATIONAL
    assert master.watch.lost(time.monotonic()) == []
    peers[1].silent = True
    assert master.poll(deadline(), lambda: master.watch.lost(time.monotonic()) == [1])
    peers[1].values[0x1016, 2] = 6 << 16 | 100
    peers[1].silent = False
    with pytest.raises(ObjectIgnored, match="none of its 2 entries is free"):
        ensure_heartbeat(sdo, produced_ms=20, watched=127, watched_ms=300)


def test_a_drive_that_ignores_its_watching_is_refused(peers: ScriptedBus, master: Master) -> None:
    sdo = Sdo(master.sdo(1))
    ensure_abort_option(sdo, 3)
    assert peers[1].values[0x6007, 0] == 3
    peers[1].ignore |= {(0x1017, 0), (0x6007, 0)}
    with pytest.raises(ObjectIgnored, match="nothing stops the drive"):
        ensure_heartbeat(sdo, produced_ms=50, watched=127, watched_ms=300)
    with pytest.raises(ObjectIgnored, match="1 was acknowledged"):
        ensure_abort_option(sdo, 1)
    peers[1].abort[0x6007, 0] = 0x06020000
    with pytest.raises(DeviceError, match="no such object, so 'quick stop'"):
        ensure_abort_option(sdo, 3)


def test_our_heartbeat_goes_on_while_we_wait(peers: ScriptedBus, link: CanLink) -> None:
    master = Master(link, node=100, period=0.01)
    assert master.poll(
        deadline(), lambda: sum(frame == (0x764, b"\x05") for frame in peers.seen) >= 5
    )


def test_nodes_follow_commands_and_boot(peers: ScriptedBus, master: Master) -> None:
    for node in (1, 2):
        ensure_heartbeat(Sdo(master.sdo(node)), produced_ms=10, watched=127, watched_ms=0)
    master.command_and_wait(NmtCommand.START, [1, 2], deadline())
    assert [peers[node].state for node in (1, 2)] == [5, 5]
    peers[2].silent = True
    # A heartbeat of before may have been on its way.
    told = r"'stop' these did not follow: node 2 \((unknown|operational)\)"
    with pytest.raises(DataTimeout, match=told):
        master.command_and_wait(NmtCommand.STOP, [1, 2], time.monotonic() + 1.0)
    peers[2].silent = False
    master.take_events()
    master.command_and_wait(NmtCommand.RESET_NODE, [1, 2], deadline())
    assert master.take_events() == [BootUp(1), BootUp(2)]
    assert master.watch.nodes[1].state == NmtState.PRE_OPERATIONAL


def test_emergencies_are_told_and_end(peers: ScriptedBus, master: Master) -> None:
    peers[1].emergency(0x8611, 0x21, b"\1\2\0\0\0")
    assert master.poll(deadline(), lambda: bool(master.emergencies))
    assert "following error (0x8611)" in str(master.emergencies[1])
    peers[1].emergency(0x0000, 0)
    assert master.poll(deadline(), lambda: not master.emergencies)
    assert [str(event)[:6] for event in master.take_events()] == ["node 1", "node 1"]


# Cycle


def groups() -> tuple[PdoGroup, PdoGroup]:
    tpdos = PdoGroup(pdo(node, Direction.TRANSMIT, STATUS) for node in (1, 2))
    rpdos = PdoGroup(pdo(node, Direction.RECEIVE, CONTROL) for node in (1, 2))
    return tpdos, rpdos


def started(master: Master, overflow: int = 0) -> Cycle:
    tpdos, rpdos = groups()
    for each in (*tpdos.pdos, *rpdos.pdos):
        configure(Sdo(master.sdo(each.node)), each)
    master.command(NmtCommand.START)
    cycle = Cycle(master, tpdos, rpdos, SentSync(master.link, overflow))
    cycle.start()
    return cycle


def run(cycle: Cycle) -> bool:
    assert cycle.begin(deadline())
    return cycle.collect(deadline())


def run_without_the_first(cycle: Cycle) -> None:
    """Begin a cycle, and end it when the PDO of the second node has come."""
    assert cycle.begin(deadline())
    cycle.serve(deadline(), 0.01, lambda: cycle.ages[1] > 0)
    assert not cycle.collect(time.monotonic())


def test_values_go_both_ways(peers: ScriptedBus, master: Master) -> None:
    cycle = started(master, overflow=3)
    assert not cycle.complete
    for n in range(5):
        peers[1].values[0x6064, 0] = n
        assert run(cycle)
        assert cycle.complete
        assert cycle.values == (0x250, n, 0x250, 200)
        assert cycle.send((0x06, n, 0x0F, -n))
    assert master.poll(deadline(), lambda: len(peers[2].received) == 5)
    assert peers[2].received[-1] == bytes.fromhex("0f00fcffffff")
    assert cycle.ages == [0, 0]
    assert [data for cob_id, data in peers.seen if cob_id == 0x80] == [
        b"\1",
        b"\2",
        b"\3",
        b"\1",
        b"\2",
    ]


@pytest.mark.real_time  # a period of 1 us: all time goes into looks at the clock
def test_nothing_is_sent_before_the_sync(peers: ScriptedBus) -> None:
    sent: list[int] = []
    link = CanLink(address(peers.channel), lambda frame: sent.append(frame.can_id))
    with closing(link):
        link.open()
        cycle = started(Master(link, node=100, sdo_timeout=LONG, period=1e-6))
        sent.clear()
        assert run(cycle)
        assert sent[:2] == [0x080, 0x764]
        assert sorted(sent[2:]) == [0x181, 0x182]


def test_what_does_not_come_is_told(peers: ScriptedBus, master: Master) -> None:
    cycle = started(master)
    assert run(cycle)
    peers[1].silent = True
    before = cycle.values
    for age in (1, 2, 3):
        run_without_the_first(cycle)
        assert cycle.ages == [age, 0]
    assert cycle.values == before
    assert [each.node for each in cycle.stale(2)] == [1]
    assert cycle.stale(3) == []
    assert cycle.counters.missed == 3
    peers[1].silent = False
    assert run(cycle)
    assert cycle.ages == [0, 0]


def test_late_short_and_foreign_frames_are_counted(peers: ScriptedBus, master: Master) -> None:
    cycle = started(master)
    assert run(cycle)
    peers.send(0x181, bytes.fromhex("370201000000"))
    peers.send(0x182, b"\1\2")
    peers.send(0x080, b"")
    peers.send(0x7F0, b"")
    peers[1].silent = True
    run_without_the_first(cycle)
    assert cycle.values[:2] == (0x237, 1)  # newer than what there was, but of the last cycle
    assert cycle.ages == [1, 0]
    counters = cycle.counters
    assert (counters.late, counters.short, counters.foreign_syncs) == (1, 1, 1)
    assert master.link.counters.unknown == 1


def test_sdo_of_another_thread_goes_on_during_cycles(peers: ScriptedBus, master: Master) -> None:
    cycle = started(master)
    found: list[int] = []
    sdo = Sdo(master.sdo(2))
    thread = threading.Thread(
        target=lambda: found.extend(sdo.read(OBJECTS["serial_number"]) for _ in range(5))
    )
    thread.start()
    end = deadline()
    while len(found) < 5:
        assert time.monotonic() < end
        assert run(cycle)
    thread.join()
    assert found == [1002] * 5


def test_sdo_of_another_thread_goes_on_while_a_pdo_is_awaited(
    peers: ScriptedBus, master: Master
) -> None:
    cycle = started(master)
    assert run(cycle)
    peers[1].silent = True
    sdo, found = Sdo(master.sdo(2)), list[int]()

    def read() -> None:
        found.extend(sdo.read(OBJECTS["serial_number"]) for _ in range(5))
        peers.send(0x181, bytes.fromhex("370201000000"))

    thread = threading.Thread(target=read)
    thread.start()
    cycle.begin(0.0)
    assert cycle.collect(deadline(), 0.001), "what is sent last has come"
    thread.join()
    assert found == [1002] * 5


def test_sdo_of_another_thread_goes_on_when_all_pdos_are_there(
    peers: ScriptedBus, master: Master
) -> None:
    cycle = started(master)
    sdo, found = Sdo(master.sdo(2)), list[int]()
    thread = threading.Thread(
        target=lambda: found.extend(sdo.read(OBJECTS["serial_number"]) for _ in range(5))
    )
    assert run(cycle)
    peers.send(0x181, bytes.fromhex("370201000000"))
    thread.start()
    cycle.serve(deadline(), 0.001, thread.is_alive)
    assert found == [1002] * 5
    assert cycle.values[:2] == (0x237, 1), "a PDO that comes meanwhile is taken"


def test_a_sync_that_somebody_else_times_begins_the_cycle(peers: ScriptedBus) -> None:
    """The kernel's, on SocketCAN; here python-can's own thread plays that part."""
    with closing(CanLink(address(peers.channel, receive_own_messages=True))) as link:
        link.open()
        master = Master(link, sdo_timeout=LONG)
        tpdos, rpdos = groups()
        for each in (*tpdos.pdos, *rpdos.pdos):
            configure(Sdo(master.sdo(each.node)), each)
        master.command(NmtCommand.START)
        cycle = Cycle(master, tpdos, rpdos, KernelSync(link, 0.02, overflow=4))
        assert not cycle.begin(time.monotonic() + 0.05)
        cycle.start()
        for _ in range(5):
            assert run(cycle)
        assert cycle.values == (0x250, 100, 0x250, 200)
        cycle.stop()
        counts = [data for cob_id, data in peers.seen if cob_id == 0x80]
        assert counts[:5] == [b"\1", b"\2", b"\3", b"\4", b"\1"]


# A bus in trouble


@pytest.mark.parametrize(
    ("identifier", "data", "condition"),
    [
        (0x004, b"\0\x20", Condition.PASSIVE),
        (0x004, b"\0\x40", Condition.GOOD),
        (0x020, b"", Condition.NO_ACK),
    ],
)
def test_error_frames_tell_the_condition(
    peers: ScriptedBus, link: CanLink, identifier: int, data: bytes, condition: Condition
) -> None:
    peers.send(identifier, data, is_error_frame=True)
    assert link.poll(deadline(), lambda: link.counters.error_frames == 1)
    assert link.condition is condition


def test_bus_off_ends_the_bus(peers: ScriptedBus, link: CanLink) -> None:
    peers.send(0x040, bytes(8), is_error_frame=True)
    with pytest.raises(BusLost, match="restart-ms") as caught:
        link.poll(deadline())
    assert caught.value.condition is Condition.BUS_OFF
    assert link.counters.bus_off == 1


class FailingBus:
    """What python-can raises when the operating system does, in place of an adapter that fails."""

    recv = can.BusABC.recv

    def __init__(self, send: Callable[[], None]) -> None:
        self._send = send

    def send(self, message: can.Message) -> None:
        self._send()

    def fileno(self) -> int:
        raise NotImplementedError


@pytest.mark.parametrize(
    ("number", "condition"),
    [
        (errno.ENETDOWN, Condition.DOWN),
        (errno.ENODEV, Condition.GONE),
        (errno.EIO, Condition.GONE),
    ],
)
def test_an_interface_that_fails_is_given_up(
    link: CanLink, number: int, condition: Condition
) -> None:
    def fail() -> None:
        raise can.CanOperationError("Failed to transmit", number)

    link.bus.shutdown()
    link._port = MessagePort(FailingBus(fail))
    with pytest.raises(BusLost, match=str(condition)) as caught:
        link.send(Frame(0x80, b""))
    assert caught.value.condition is condition


def test_no_room_is_borne_for_two_cycles(master: Master) -> None:
    cycle = started(master)
    assert run(cycle)
    master.link.bus.shutdown()

    room = False

    def full() -> None:
        if not room:
            raise can.CanOperationError("Failed to transmit: No buffer space", errno.ENOBUFS)

    master.link._port = MessagePort(FailingBus(full))
    values = (0, 0, 0, 0)
    assert not cycle.send(values)
    assert not cycle.send(values)
    room = True
    assert cycle.send(values)
    room = False
    assert not cycle.send(values)
    assert not cycle.send(values)
    with pytest.raises(BusLost, match="txqueuelen"):
        cycle.send(values)
    assert cycle.counters.unsent == 5


# The log


def test_frames_are_logged_as_candump_does(peers: ScriptedBus, tmp_path: Path) -> None:
    path = tmp_path / "frames.log"
    with (
        CandumpLog(path, "can0") as log,
        closing(CanLink(address(peers.channel), log.put)) as link,
    ):
        link.open()
        sdo = Sdo(Master(link, sdo_timeout=LONG).sdo(1))
        assert sdo.read(OBJECTS["serial_number"]) == 1001
    lines = [line.split() for line in path.read_text().splitlines()]
    assert [line[1:] for line in lines] == [
        ["can0", "601#4018100400000000"],
        ["can0", "581#43181004E9030000"],
    ]
    assert len(list(can.CanutilsLogReader(path))) == 2
    with pytest.raises(ConfigError, match="cannot be written"):
        CandumpLog(tmp_path).open()


@pytest.mark.parametrize("late", ["an abort", "a value", "an acknowledgement"])
def test_a_late_answer_to_what_was_asked_before_is_none_to_what_is_asked_now(
    peers: ScriptedBus, master: Master, late: str
) -> None:
    frames = {
        "an abort": b"\x80\x18\x10\x04\x00\x00\x02\x06",
        "a value": b"\x43\x18\x10\x04\x07\x00\x00\x00",
        "an acknowledgement": b"\x60\x64\x60\x00\x00\x00\x00\x00",
    }
    node = peers[1]
    answers = node._sdo

    def answer_both(data: bytes) -> None:
        peers.send(0x581, frames[late])
        answers(data)

    node._sdo = answer_both  # type: ignore[method-assign]
    assert Sdo(master.sdo(1)).read(OBJECTS["position_actual"]) == 100
