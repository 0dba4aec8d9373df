"""Every port of the driver against python-can at the other end of the bus."""

from __future__ import annotations

import errno
import itertools
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import Any

import can
import pytest

from crtk_driver_canopen.bus_state import Condition, condition_of_error
from crtk_driver_canopen.frames import ERROR, EXTENDED, REMOTE, Frame, pack, unpack
from crtk_driver_canopen.ports import HubPort, MessagePort, Port, SocketPort, port_of
from crtk_sim_backends.can import SIM
from crtk_sim_backends.process import RunningSim
from rigs.waiting import LONG, eventually

FRAMES = (
    Frame(0x000, b"\x01\x05"),
    Frame(0x080, b""),
    Frame(0x181, b"\x37\x02\x10\x27\x00\x00"),
    Frame(0x7FF, bytes(range(8))),
)


def message(frame: Frame, **more: Any) -> can.Message:
    return can.Message(arbitration_id=frame.can_id, data=frame.data, is_extended_id=False, **more)


def received(port: Port, count: int) -> list[Frame]:
    """The next frames, without the times that not every port knows."""
    found: list[Frame] = []
    end = time.monotonic() + LONG
    while len(found) < count:
        assert time.monotonic() < end, found
        found += port.receive(0.2)
    return [frame._replace(time=0.0) for frame in found]


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as opened:
        yield opened


def at_hub(sim: RunningSim, stack: ExitStack, **options: Any) -> can.BusABC:
    return stack.enter_context(can.Bus(interface="crtk", channel=sim.paths["crtk"], **options))


@pytest.fixture(params=[HubPort, MessagePort])
def port(request: pytest.FixtureRequest, sim: RunningSim, stack: ExitStack) -> Port:
    made: Port = request.param(at_hub(sim, stack))
    return made


# Which one


def test_the_hub_takes_bytes(sim: RunningSim, stack: ExitStack) -> None:
    assert isinstance(port_of(at_hub(sim, stack)), HubPort)


def test_any_other_interface_takes_messages(stack: ExitStack) -> None:
    bus = stack.enter_context(can.Bus(interface="virtual", channel="which port"))
    assert isinstance(port_of(bus), MessagePort)


# On the bus


def test_frames_arrive_as_they_were_sent(port: Port, sim: RunningSim, stack: ExitStack) -> None:
    peer = at_hub(sim, stack)
    for frame in FRAMES:
        peer.send(message(frame))
    assert received(port, len(FRAMES)) == list(FRAMES)
    assert not port.receive(0.0)


def test_frames_are_sent_as_they_are(port: Port, sim: RunningSim, stack: ExitStack) -> None:
    peer = at_hub(sim, stack)
    assert port.send(FRAMES) == len(FRAMES)
    for frame in FRAMES:
        assert (got := peer.recv(LONG)) is not None
        assert got.equals(message(frame), timestamp_delta=None, check_channel=False)
    assert peer.recv(0.02) is None


def test_what_is_no_data_frame_has_a_flag(port: Port, sim: RunningSim, stack: ExitStack) -> None:
    peer = at_hub(sim, stack)
    peer.send(can.Message(arbitration_id=0x1234567, data=b"\xaa"))
    peer.send(can.Message(arbitration_id=0x123, is_remote_frame=True, is_extended_id=False))
    extended, remote = received(port, 2)
    assert extended == Frame(EXTENDED | 0x1234567, b"\xaa")
    assert remote.can_id == REMOTE | 0x123
    sim.control.inject("error_frames", rate=100.0, what="no_ack")
    (error, *_) = received(port, 1)
    sim.control.clear("error_frames")
    assert error.can_id & (ERROR | 0x020) == ERROR | 0x020


@pytest.mark.parametrize("kind", [HubPort, MessagePort])
def test_own_frames_that_come_back_are_marked(kind: Any, sim: RunningSim, stack: ExitStack) -> None:
    port, peer = kind(at_hub(sim, stack, receive_own_messages=True)), at_hub(sim, stack)
    port.send(FRAMES[:1])
    assert received(port, 1) == [FRAMES[0]._replace(own=True)]
    peer.send(message(FRAMES[1]))
    assert received(port, 1) == [FRAMES[1]]


def test_what_is_there_is_received_without_waiting(
    port: Port, sim: RunningSim, stack: ExitStack
) -> None:
    peer = at_hub(sim, stack)
    peer.send(message(FRAMES[2]))
    found: list[Frame] = []

    def receive() -> bool:
        found.extend(port.receive(0.0))
        return bool(found)

    eventually(receive, "it has been received")
    assert found[0].data == FRAMES[2].data


def test_a_wait_ends_in_time(port: Port) -> None:
    began = time.monotonic()
    assert port.receive(0.05) == ()
    assert time.monotonic() - began >= 0.05


def test_more_than_one_packet_holds(sim: RunningSim, stack: ExitStack) -> None:
    port, other = HubPort(at_hub(sim, stack)), HubPort(at_hub(sim, stack))
    many = [Frame(0x200 + n % 0x400, bytes([n & 0xFF])) for n in range(600)]
    assert port.send(many) == len(many)
    assert received(other, len(many)) == many


@pytest.mark.parametrize("kind", [HubPort, MessagePort])
def test_a_full_queue_takes_the_first_ones(kind: Any, stack: ExitStack) -> None:
    with SIM.spawn(bitrate=10_000, queue=4) as slow:
        port, peer = kind(at_hub(slow, stack)), at_hub(slow, stack)
        many = 500  # more than are on their way while a sender gets no time for a while
        count = port.send([Frame(0x100 + n, bytes(8)) for n in range(many)])
        assert 4 <= count < many
        got = [peer.recv(LONG) for _ in range(count)]
        assert [each.arbitration_id for each in got if each] == [0x100 + n for n in range(count)]
        assert peer.recv(0.05) is None, "what did not find room was sent after all"
        eventually(lambda: port.send([FRAMES[0]]) == 1, "there is room again")
        stack.close()


@pytest.mark.parametrize("kind", [HubPort, MessagePort])
def test_an_interface_that_is_off_the_bus_or_down(
    kind: Any, sim: RunningSim, stack: ExitStack
) -> None:
    port = kind(at_hub(sim, stack, name="arm"))
    sim.control.inject("bus_off", node="arm")
    assert port.send(FRAMES) == 0
    assert received(port, 1)[0].can_id & ERROR
    sim.control.clear("bus_off")
    received(port, 1)  # it tells that it is back
    sim.control.inject("down", node="arm")
    try:
        for use in (lambda: port.receive(LONG), lambda: port.send(FRAMES)):
            with pytest.raises(can.CanOperationError) as caught:
                use()
            assert caught.value.error_code == errno.ENETDOWN
    finally:
        sim.control.clear("down")


@pytest.mark.parametrize("kind", [HubPort, MessagePort])
def test_a_hub_that_has_ended(kind: Any, stack: ExitStack) -> None:
    with SIM.spawn() as short:
        port = kind(at_hub(short, stack))
    with pytest.raises(can.CanOperationError) as caught:
        port.receive(LONG)
    assert condition_of_error(caught.value) is Condition.GONE
    with pytest.raises(can.CanOperationError) as caught:
        port.send(FRAMES)
    assert condition_of_error(caught.value) is Condition.GONE


# On a socket of the kernel: UDP here, whose datagrams have time stamps too; tests/vcan has the real one


@pytest.fixture
def sockets(stack: ExitStack) -> tuple[socket.socket, socket.socket]:
    near, far = (
        stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) for _ in range(2)
    )
    for one in (near, far):
        one.bind(("127.0.0.1", 0))
    for one, other in itertools.permutations((near, far)):
        one.connect(other.getsockname())
    far.settimeout(LONG)
    return near, far


def test_a_socket_sends_frame_by_frame(sockets: tuple[socket.socket, socket.socket]) -> None:
    near, far = sockets
    assert SocketPort(near).send(FRAMES) == len(FRAMES)
    assert [unpack(far.recv(100)) for _ in FRAMES] == list(FRAMES)


@pytest.mark.real_time  # the kernel stamps what it receives
def test_a_socket_receives_with_the_time_of_the_kernel(
    sockets: tuple[socket.socket, socket.socket],
) -> None:
    near, far = sockets
    near.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS
    port = SocketPort(near)
    assert port.receive(0.0) == ()
    assert port.receive(0.01) == ()
    before = time.time()
    far.send(pack(FRAMES[2]))
    far.send(pack(FRAMES[3]))
    after = time.time()
    for timeout, expected in ((LONG, FRAMES[2]), (0.0, FRAMES[3])):
        (frame,) = port.receive(timeout)
        assert frame._replace(time=0.0) == expected
        assert before <= frame.time <= after


def test_a_socket_without_room_takes_no_more() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with closing(near), closing(far):
        count = SocketPort(near).send(FRAMES * 10_000)
        assert 0 < count < len(FRAMES) * 10_000
        far.settimeout(LONG)
        for number in range(count):
            assert unpack(far.recv(100)) == FRAMES[number % len(FRAMES)]


def test_a_socket_that_fails_says_so(sockets: tuple[socket.socket, socket.socket]) -> None:
    near, _ = sockets
    port = SocketPort(near)
    near.close()
    with pytest.raises(OSError, match="Bad file descriptor") as caught:
        port.send(FRAMES)
    assert condition_of_error(caught.value) is Condition.GONE
