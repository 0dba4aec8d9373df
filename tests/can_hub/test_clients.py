"""Unmodified python-can at every door of a hub in another process."""

import asyncio
import errno
import select
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import can
import pytest

from crtk_sim_backends.can import SIM
from rigs.can_hub_doors import DOORS, frame, ids, listening, open_bus, receive
from rigs.waiting import LONG, eventually

FRAMES = [
    frame(0x000, b""),
    frame(0x123, b"\x01"),
    frame(0x7FF, bytes(range(8))),
    frame(0x12345678, b"\xff" * 8),
    frame(0x001, b"\x00\x0d\x07<>", is_extended_id=True),
]


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(socketcand_port=0, terminals=2) as running:
        yield running


@pytest.fixture
def at(sim):
    """Opens buses, and closes them."""
    buses = []

    def opened(door, **options):
        buses.append(open_bus(sim, door, **options))
        return buses[-1]

    yield opened
    for bus in buses:
        bus.shutdown()
    eventually(lambda: not any(listening(sim, door) for door in DOORS))


@pytest.mark.parametrize("to", DOORS)
@pytest.mark.parametrize("sender", DOORS)
def test_frames_pass_from_every_door_to_every_door(at, sender, to):
    one, other = at(sender), at(to)
    for message in FRAMES:
        one.send(message, timeout=LONG)
    for sent, got in zip(FRAMES, receive(other, len(FRAMES)), strict=True):
        assert got.equals(sent, timestamp_delta=None, check_channel=False)
    assert one.recv(0.02) is None, "a frame returned to its sender"


@pytest.mark.parametrize(("sender", "to"), [("crtk", "slcan"), ("slcan", "crtk"), ("crtk", "crtk")])
def test_remote_frames_pass_where_the_protocol_has_them(at, sender, to):
    one, other = at(sender), at(to)
    for can_id in (0x123, 0x1234567):
        one.send(frame(can_id, None, is_remote_frame=True, dlc=4), timeout=LONG)
        (got,) = receive(other)
        assert (got.arbitration_id, got.is_remote_frame, got.dlc) == (can_id, True, 4)


def test_everybody_but_the_sender_gets_a_frame(at):
    buses = [at(door) for door in ("crtk", "crtk", "socketcand", "slcan")]
    buses[0].send(frame(0x42))
    for bus in buses[1:]:
        assert ids(receive(bus)) == [0x42]
    assert buses[0].recv(0.02) is None


def test_own_frames_come_back_when_asked_for_and_are_marked(at):
    one, other = at("crtk", receive_own_messages=True), at("crtk")
    one.send(frame(0x42))
    (own,), (got,) = receive(one), receive(other)
    assert (own.arbitration_id, own.is_rx, got.is_rx) == (0x42, False, True)


def test_filters_let_only_matching_frames_through(at):
    one = at("crtk")
    other = at("crtk", can_filters=[{"can_id": 0x200, "can_mask": 0x700, "extended": False}])
    for can_id in (0x100, 0x201, 0x12345, 0x2FF):
        one.send(frame(can_id))
    assert ids(receive(other, 2)) == [0x201, 0x2FF]


def test_the_file_descriptor_is_readable_exactly_while_a_frame_waits(at):
    one, other = at("crtk"), at("crtk")
    assert select.select([other.fileno()], [], [], 0.0)[0] == []
    for can_id in (1, 2, 3):
        one.send(frame(can_id))
    for can_id in (1, 2, 3):
        assert select.select([other.fileno()], [], [], LONG)[0]
        assert other.recv(0.0).arbitration_id == can_id
    assert select.select([other.fileno()], [], [], 0.0)[0] == []


def test_waiting_for_a_frame_ends_with_the_time_given(at):
    bus = at("crtk")
    began = time.monotonic()
    assert bus.recv(0.05) is None
    assert time.monotonic() - began >= 0.05
    assert bus.recv(0.0) is None


def test_a_notifier_and_periodic_tasks_work(at):
    one, other = at("crtk"), at("crtk")
    reader = can.BufferedReader()
    notifier = can.Notifier(other, [reader])
    task = one.send_periodic(frame(0x80, b""), period=0.01)
    got = [reader.get_message(LONG) for _ in range(3)]
    task.stop()
    notifier.stop()
    assert ids(got) == [0x80] * 3


def test_a_notifier_works_in_an_event_loop(at):
    """It reads one frame each time that the file descriptor is readable."""
    one, other = at("crtk"), at("crtk")

    async def collect():
        reader = can.AsyncBufferedReader()
        notifier = can.Notifier(other, [reader], loop=asyncio.get_running_loop())
        try:
            for number in range(20):
                one.send(frame(number))
            return [await asyncio.wait_for(reader.get_message(), LONG) for _ in range(20)]
        finally:
            notifier.stop()

    assert ids(asyncio.run(collect())) == list(range(20))


def test_what_a_classic_interface_cannot_send_is_refused(at):
    bus = at("crtk")
    for message in (frame(0x1, is_fd=True), can.Message(is_error_frame=True)):
        with pytest.raises(can.CanOperationError, match="cannot send") as caught:
            bus.send(message)
        assert caught.value.error_code == errno.EINVAL


def test_a_bus_that_was_shut_down_says_so(at):
    bus = at("crtk")
    bus.shutdown()
    bus.shutdown()
    with pytest.raises(can.CanOperationError):
        bus.send(frame())
    with pytest.raises(can.CanOperationError):
        bus.recv(0.0)
    assert bus.state is can.BusState.ERROR


def test_a_plain_socket_needs_no_library(sim, at):
    bus = at("crtk")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as plain:
        plain.connect(sim.paths["crtk"])
        plain.settimeout(LONG)
        head = bytes.fromhex("23010000 02 000000")
        plain.send(head + b"ab" + bytes(6) + head + b"cd" + bytes(6))
        assert [bytes(message.data) for message in receive(bus, 2)] == [b"ab", b"cd"]
        bus.send(frame(0x1234567, b"xyz"))
        assert plain.recv(4096) == bytes.fromhex("67452381 03 000000") + b"xyz" + bytes(5)


def test_a_bus_is_readable_as_long_as_frames_of_one_packet_are_left(sim, at):
    bus = at("crtk")
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as plain,
        socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as other,
    ):
        for each in (plain, other):
            each.connect(sim.paths["crtk"])
            each.settimeout(LONG)
        eventually(lambda: listening(sim, "crtk") == 3)
        one = bytes.fromhex("23010000 01 000000") + bytes(8)
        plain.send(one * 256)
        for _ in range(256):
            assert select.select([bus], [], [], LONG)[0]
            assert bus.recv(0.0) is not None
            assert other.recv(4096) == one  # who has not asked for more gets one frame a packet
        assert not select.select([bus], [], [], 0.0)[0]
        assert bus.recv(0.0) is None


def test_threads_that_receive_at_one_bus_share_its_frames(at):
    sender, bus = at("crtk"), at("crtk")
    with ThreadPoolExecutor(4) as pool:
        found = [pool.submit(receive, bus, 100) for _ in range(4)]
        for number in range(400):
            sender.send(frame(number))
        received = [each for future in found for each in ids(future.result(LONG))]
    assert sorted(received) == list(range(400))


def test_a_client_has_the_name_that_it_asks_for(sim, at):
    at("crtk", name="native-driver")
    assert "native-driver" in sim.control.status()["nodes"]


def test_slcan_answers_as_an_adapter_does(sim, at):
    bus = at("slcan")
    assert bus.get_version(LONG) == (10, 13)
    assert bus.get_serial_number(LONG) == "A123"


def test_a_named_hub_is_found_by_its_name(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with SIM.spawn(socket="can7", socketcand_port=0, terminals=0):
        assert can.detect_available_configs(["crtk"]) == [{"interface": "crtk", "channel": "can7"}]
        can.Bus(interface="crtk", channel="can7").shutdown()
    assert can.detect_available_configs(["crtk"]) == []


def test_without_a_hub_the_error_says_how_to_start_one(tmp_path):
    with pytest.raises(can.CanInitializationError, match="crtk-driver sim can") as caught:
        can.Bus(interface="crtk", channel=str(tmp_path / "nobody.sock"))
    assert caught.value.error_code == errno.ENOENT


def test_a_hub_that_dies_is_noticed():
    with SIM.spawn(socketcand_port=0, terminals=0) as sim:
        bus = can.Bus(interface="crtk", channel=sim.paths["crtk"])
        sim.kill()
        with pytest.raises(can.CanOperationError, match="has ended"):
            bus.recv(LONG)
        with pytest.raises(can.CanOperationError, match="cannot send"):
            bus.send(frame())
        bus.shutdown()


def test_a_hub_that_hangs_does_not_hang_its_clients():
    with SIM.spawn(socketcand_port=0, terminals=0, bitrate=1_000_000, queue=16) as sim:
        bus = can.Bus(interface="crtk", channel=sim.paths["crtk"])
        sim.suspend()
        for _ in range(16):
            bus.send(frame())
        with pytest.raises(can.CanOperationError) as caught:
            bus.send(frame())
        assert caught.value.error_code == errno.ENOBUFS
        assert bus.recv(0.01) is None
        sim.resume()
        bus.send(frame(), timeout=LONG)
        bus.shutdown()


OTHER_PROCESS = """
import sys, can
with can.Bus(interface="crtk", channel=sys.argv[1]) as bus:
    bus.send(can.Message(arbitration_id=0x700, is_extended_id=False))
    message = bus.recv(15.0)
    message.arbitration_id += 1
    bus.send(message)
"""


def test_two_processes_talk_to_each_other(sim, at):
    bus = at("crtk")
    other = subprocess.Popen([sys.executable, "-c", OTHER_PROCESS, sim.paths["crtk"]])
    try:
        assert ids(receive(bus)) == [0x700]
        bus.send(frame(0x123, b"ping"))
        (reply,) = receive(bus)
        assert (reply.arbitration_id, bytes(reply.data)) == (0x124, b"ping")
        assert other.wait(LONG) == 0
    finally:
        other.kill()
        other.wait()


def test_many_threads_may_send_at_one_bus():
    """The hub may have read a frame before the thread that sent it has counted it."""
    interval = sys.getswitchinterval()
    with (
        SIM.spawn(socketcand_port=0, terminals=0, bitrate=1_000_000, queue=100_000) as sim,
        open_bus(sim, "crtk", name="native-a") as bus,
    ):
        sys.setswitchinterval(1e-6)
        try:
            with ThreadPoolExecutor(4) as pool:
                for done in [pool.submit(send_many, bus, 500) for _ in range(4)]:
                    done.result(LONG)
        finally:
            sys.setswitchinterval(interval)
        eventually(lambda: sim.control.status()["nodes"]["native-a"]["sent"] == 2000)
        bus.send(frame())


def send_many(bus, count):
    for _ in range(count):
        bus.send(frame())


def test_what_was_sent_before_a_client_left_still_goes_over_the_bus():
    with (
        SIM.spawn(socketcand_port=0, terminals=0, bitrate=125_000) as sim,
        open_bus(sim, "crtk") as bus,
    ):
        with open_bus(sim, "crtk", name="native-brief") as brief:
            for number in range(20):
                brief.send(frame(0x100 + number))
        assert ids(receive(bus, 20)) == list(range(0x100, 0x114))
