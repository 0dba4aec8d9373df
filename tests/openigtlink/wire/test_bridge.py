"""The bridge over TCP: what peers are told, may command, and cannot do to each other."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

import crtk_drivers
from crtk_drivers.errors import ConfigError, ConnectionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.front.openigtlink import METRES, Bridge, Caller, Server, connection, peer_streams
from crtk_drivers.front.openigtlink.bodies import String, Transform
from crtk_drivers.front.openigtlink.codec import Message, time_of
from crtk_drivers.front.openigtlink.connection import STALLED, Connection
from crtk_drivers.front.openigtlink.doors import MOST_PEERS
from crtk_drivers.geometry.conversions import to_matrix
from crtk_drivers.options import TOO_LATE
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import LoopbackDevice
from rigs.beside import beside
from rigs.igtl_peer import HEADER, Got, IgtlPeer, at, framed, sensor, served, string, transform
from rigs.waiting import LONG, eventually


@pytest.fixture(scope="module")
def device() -> Iterator[Any]:
    with crtk_drivers.connect("loopback", timeout=LONG, stream_timeout=2.0) as front:
        yield front


@pytest.fixture
def arm(device: Any) -> Iterator[Any]:
    yield device
    device.disable()
    hardware = device.engine.device
    assert isinstance(hardware, LoopbackDevice)
    hardware.go_to_zero()


@pytest.fixture
def rig(arm: LocalDevice) -> Iterator[tuple[Bridge, Server, IgtlPeer]]:
    with served({"arm": arm}, rate=200.0) as (bridge, server):
        peer = IgtlPeer.connected(server.port)
        yield bridge, server, peer
        peer.close()


def enabled(peer: IgtlPeer) -> None:
    peer.send("STRING", "arm/state_command", string("enable"))
    until_status(peer, "ENABLED")


def until_status(peer: IgtlPeer, state: str) -> Got:
    while True:
        got = peer.until("STATUS", "arm")
        if got.body[10:30].rstrip(b"\0").decode() == state:
            return got


def joints(got: Got) -> np.ndarray[Any, Any]:
    assert got.body[:2] == bytes((11, 2))
    shape = struct.unpack(">2H", got.body[2:6])
    return np.frombuffer(got.body, ">f8", offset=6).reshape(shape)


def test_joints_poses_and_efforts_are_told_as_saw_does_in_millimetres(
    rig: tuple[Bridge, Server, IgtlPeer], arm: Any
) -> None:
    _, _, peer = rig
    enabled(peer)
    arm.move_jp([0.1, 0.2, -0.3, 0.5]).wait(LONG)
    matrix = peer.until("TRANSFORM", "arm/setpoint_cp").matrix
    expected = to_matrix(arm.setpoint_cp())
    expected[:3, 3] *= 1000.0
    eventually(
        lambda: np.allclose(peer.until("TRANSFORM", "arm/setpoint_cp").matrix, expected, atol=1e-3),
        f"{matrix}",
    )
    told = joints(peer.until("NDARRAY", "arm/setpoint_js"))
    assert told.shape == (6, 4)
    assert np.allclose(told[:2], [(1, 1, 1, 1), (0.1, 0.2, -0.3, 0.5)])
    got = peer.until("SENSOR", "arm/measured_cf")
    assert got.body[0] == 6
    assert len(got.body) == 10 + 48
    assert abs((peer.until("TRANSFORM", "arm/measured_cp").time >> 32) - time.time()) < 60.0


def test_metres_and_chosen_names_for_saw(arm: Any) -> None:
    arm.enable()
    arm.move_jp([0.1, 0.2, -0.3, 0.5]).wait(LONG)
    with served({"arm": arm}, scale=METRES, only=["goal_cp", "setpoint_cp"]) as (_, server):
        peer = IgtlPeer.connected(server.port)
        found = [peer.next() for _ in range(8)]
        told = {each.device for each in found if each.kind != "STATUS"}
        assert {"arm/setpoint_cp"} <= told <= {"arm/setpoint_cp", "arm/goal_cp"}
        matrix = peer.until("TRANSFORM", "arm/setpoint_cp").matrix
        assert np.allclose(matrix[:3, 3], arm.setpoint_cp().position, atol=1e-6)
        peer.close()


def test_a_peer_enables_moves_and_streams(rig: tuple[Bridge, Server, IgtlPeer], arm: Any) -> None:
    _, _, peer = rig
    enabled(peer)
    peer.send("TRANSFORM", "arm/move_cp", transform(at(50.0, -20.0, 10.0)))
    eventually(lambda: np.allclose(arm.setpoint_cp().position, (0.05, -0.02, 0.01)), "it moved")
    for step in range(1, 11):
        peer.send("SENSOR", "arm/servo_jp", sensor(0.05 + step * 1e-3, -0.02, 0.01, 0.0))
    eventually(lambda: np.allclose(arm.setpoint_jp(age=0)[0], 0.06), "it followed the stream")
    array = struct.pack(">BBH4d", 11, 1, 4, 0.0, 0.0, 0.0, 0.0)
    peer.send("NDARRAY", "arm/move_jp", array)
    eventually(lambda: np.allclose(arm.setpoint_jp(age=0), 0.0), "back at zero")
    peer.send("STRING", "arm/state_command", string("disable"))
    until_status(peer, "DISABLED")


@pytest.mark.parametrize(
    ("kind", "name", "body", "told"),
    [
        ("SENSOR", "arm/servo_jp", sensor(0.0, 0.0, 0.0, 0.0), "not_enabled"),
        ("TRANSFORM", "arm/servo_jp", transform(at(0.0, 0.0, 0.0)), "wrong_type"),
        ("TRANSFORM", "arm/move_cp", transform(np.diag((2.0, 1.0, 1.0, 1.0))), "wrong_type"),
        ("TRANSFORM", "arm/move_cp", transform(at(np.nan, 0.0, 0.0)), "not_"),
        ("SENSOR", "arm/move_jp", sensor(0.0), "not_enabled"),
        ("STRING", "arm/state_command", string("explode"), "unknown_command"),
        ("STRING", "arm/state_command", string("resume"), "invalid_transition"),
        ("POSITION", "arm/servo_cp", struct.pack(">3f", 1.0, 2.0, 3.0), "wrong_type"),
    ],
    ids=["disabled", "no joints", "no rotation", "no number", "move", "word", "state", "no turn"],
)
def test_what_is_refused_is_told_to_who_sent_it_and_changes_nothing(
    rig: tuple[Bridge, Server, IgtlPeer], kind: str, name: str, body: bytes, told: str
) -> None:
    _, _, peer = rig
    peer.send(kind, name, body)
    assert told in peer.until("STRING", "arm/error").text


def test_names_that_nobody_has_are_not_found_and_who_only_tells_takes_nothing(arm: Any) -> None:
    with served({"arm": arm}, takes=False) as (_, server):
        peer = IgtlPeer.connected(server.port)
        for name in ("arm/servo_jp", "leg/servo_jp"):
            peer.send("SENSOR", name, sensor(0.0))
            got = peer.until("STATUS", name)
            assert struct.unpack_from(">H", got.body)[0] == 4
        peer.close()


def test_the_end_of_a_connection_ends_the_move_that_it_has_begun(
    rig: tuple[Bridge, Server, IgtlPeer], arm: Any
) -> None:
    bridge, server, peer = rig
    arm.trajectory_j.set_ratio(0.05)
    try:
        enabled(peer)
        peer.send("SENSOR", "arm/move_jp", sensor(0.9, 0.0, 0.0, 0.0))
        eventually(arm.is_busy, "it moves")
        other = IgtlPeer.connected(server.port)
        eventually(lambda: len(bridge.connections) == 2, "another one is connected")
        other.close()  # which has begun nothing
        eventually(lambda: len(bridge.connections) == 1, "it is gone")
        assert arm.is_busy()
        peer.close()
        eventually(lambda: not arm.is_busy(), "it is held")
        assert arm.setpoint_jp()[0] < 0.5
        assert arm.operating_state().state is OperatingState.ENABLED
    finally:
        arm.trajectory_j.set_ratio(1.0)


def test_a_device_is_moved_by_one_connection_and_stopped_by_any(
    rig: tuple[Bridge, Server, IgtlPeer], arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(peer_streams, "SILENCE", LONG)  # or it has ended where it is held up
    _, server, peer = rig
    enabled(peer)
    other = IgtlPeer.connected(server.port)
    before = arm.health().setpoints

    def stream(over: threading.Event) -> None:
        while not over.wait(0.01):
            peer.send("SENSOR", "arm/servo_jp", sensor(0.0, 0.0, 0.0, 0.0))

    with beside(stream):
        eventually(lambda: arm.health().setpoints > before + 5, "it streams")
        other.send("SENSOR", "arm/servo_jp", sensor(0.001, 0.0, 0.0, 0.0))
        assert "stream_owned" in other.until("STRING", "arm/error").text
        other.send("STRING", "arm/hold", string(""))
        assert "stream_ended" in peer.until("STRING", "arm/error").text
    other.close()


def test_a_setpoint_that_the_network_kept_is_refused(
    rig: tuple[Bridge, Server, IgtlPeer], arm: Any
) -> None:
    """As after a cut, when TCP delivers what was sent meanwhile: by the peer's own clock."""
    _, _, peer = rig
    enabled(peer)
    began = time.monotonic()

    def step(position: float, seconds: float) -> None:
        body = sensor(position, 0.0, 0.0, 0.0)
        peer.send("SENSOR", "arm/servo_jp", body, seconds=1000.0 + seconds)

    step(0.001, 0.0)
    eventually(lambda: arm.setpoint_jp()[0] == pytest.approx(0.001), "it is taken")
    time.sleep(2.0 * TOO_LATE)
    step(0.002, 0.01)
    assert "too_old" in peer.until("STRING", "arm/error").text
    assert arm.setpoint_jp()[0] == pytest.approx(0.001)

    def is_taken() -> bool:
        step(0.003, time.monotonic() - began)
        return bool(arm.setpoint_jp()[0] == pytest.approx(0.003))

    eventually(is_taken, "the newest is taken")


def test_a_peer_that_takes_nothing_blocks_nobody_and_gets_the_newest(
    arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "STALLED", LONG)  # or it is sent away meanwhile
    with served({"arm": arm}, rate=1000.0) as (bridge, server):
        stuck = socket.socket()
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.connect(("127.0.0.1", server.port))
        eventually(lambda: bridge.connections, "it is connected")
        (slow,) = bridge.connections
        slow._peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        eventually(lambda: slow.overwritten > 100, "values are overwritten")
        peer = IgtlPeer.connected(server.port)
        for _ in range(200):
            peer.next()
        assert slow.waiting < 20
        assert not slow.has_ended
        peer.close()
        stuck.close()


def test_a_device_that_goes_home_is_held_when_the_peer_is_gone_that_said_so() -> None:
    with (
        crtk_drivers.connect("loopback", needs_homing=True, timeout=LONG) as arm,
        served({"arm": arm}) as (_, server),
    ):
        peer, other = (IgtlPeer.connected(server.port) for _ in range(2))
        enabled(peer)
        arm.engine.device.transition_time = 4.0  # of homing alone
        peer.send("STRING", "arm/state_command", string("home"))
        eventually(arm.is_busy, "it goes home")
        other.close()
        peer.close()
        eventually(lambda: not arm.is_busy(), "it is held")
        assert not arm.is_homed()


def test_a_peer_whose_machine_has_gone_is_not_waited_for_longer_than_one_that_takes_nothing(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    """It says nothing of it: what is sent to it is not acknowledged, and the system ends the connection."""
    (connection,) = eventually(lambda: rig[0].connections, "it is connected")
    wait = connection._peer.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
    assert wait == STALLED * 1000


def test_who_asks_and_takes_no_answer_is_disconnected(arm: Any) -> None:
    with served({"arm": arm}) as (bridge, server):
        peer = IgtlPeer.connected(server.port)
        peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        eventually(lambda: bridge.connections, "it is connected")
        bridge.connections[0]._peer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        with suppress(OSError):
            for _ in range(5000):
                peer.send("GET_STATUS", "arm")
        eventually(lambda: not bridge.connections, "it is sent away")
        peer.close()


def test_a_wrong_checksum_is_answered_and_the_stream_goes_on(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    _, _, peer = rig
    damaged = bytearray(framed("STRING", "arm/state_command", string("enable")))
    damaged[-1] ^= 1
    peer.socket.sendall(bytes(damaged))
    got = peer.until("STATUS", "arm/state_command")
    assert struct.unpack_from(">H", got.body)[0] == 9
    for byte in framed("STRING", "arm/state_command", string("enable")):
        peer.socket.sendall(bytes((byte,)))
    until_status(peer, "ENABLED")


def test_a_size_of_a_lost_stream_disconnects_and_others_stay(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    _, server, peer = rig
    hostile = IgtlPeer.connected(server.port)
    hostile.socket.sendall(HEADER.pack(1, b"STRING", b"arm", 0, (1 << 64) - 1, 0))
    assert hostile.is_sent_away()
    hostile.close()
    peer.until("TRANSFORM", "arm/measured_cp")


def test_queries_are_answered_with_what_is_known_or_without_a_body(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    _, _, peer = rig
    peer.until("TRANSFORM", "arm/measured_cp")
    peer.send("GET_POSITION", "arm/measured_cp")
    assert len(peer.until("POSITION", "arm/measured_cp").body) == 28
    peer.send("GET_QTDATA", "arm")
    assert peer.until("QTDATA", "arm/measured_cp").body[:4] == b"arm\0"
    peer.send("GET_TDATA", "")
    assert len(peer.until("TDATA", "tools").body) == 70
    peer.send("GET_TRANSFOR", "leg/measured_cp")
    assert peer.until("TRANSFORM", "leg/measured_cp").body == b""
    peer.send("GET_POSITION", "")
    assert {peer.until("POSITION").device for _ in range(2)} <= {
        f"arm/{name}_cp" for name in ("measured", "setpoint", "goal")
    }
    peer.send("GET_IMAGE", "camera")
    assert struct.unpack_from(">H", peer.until("STATUS", "camera").body)[0] == 12
    peer.send("GET_CAPABIL", "")
    assert b"TRANSFORM\0\0\0" in peer.until("CAPABILITY").body
    peer.send("GET_STATUS", "arm")
    assert struct.unpack_from(">H", peer.until("STATUS", "arm").body)[0] == 15


def test_tracking_data_is_sent_from_start_to_stop_and_transforms_can_be_stopped(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    bridge, _, peer = rig
    peer.until("TRANSFORM", "arm/measured_cp")
    peer.send("STT_TDATA", "", struct.pack(">i32s", 10, b"Patient"))
    assert peer.until("RTS_TDATA").body == b"\0"
    assert len(peer.until("TDATA", "tools").body) == 70
    peer.send("STP_TDATA", "")
    assert peer.until("RTS_TDATA").body == b"\0"
    assert bridge.connections[0].bundles == {}
    peer.send("STP_TRANSFOR", "")
    assert peer.until("RTS_TRANSFOR").body == b"\0"
    peer.until("NDARRAY")  # what was on its way is over
    assert all(peer.next().kind != "TRANSFORM" for _ in range(50))
    peer.send("STT_TRANSFOR", "leg")
    assert peer.until("RTS_TRANSFOR").body == b"\1"
    peer.send("STT_TRANSFOR", "")
    peer.until("TRANSFORM")


def test_tracking_data_has_no_tool_that_is_not_seen_any_more(arm: Any) -> None:
    with (
        crtk_drivers.connect("loopback") as leg,
        served({"arm": arm, "leg": leg}, rate=200.0) as (_, server),
    ):
        peer = IgtlPeer.connected(server.port)
        peer.send("STT_TDATA", "", struct.pack(">i32s", 10, b""))
        eventually(lambda: len(peer.until("TDATA", "tools").body) == 140, "both")
        leg.engine.device.silent = True
        eventually(lambda: len(peer.until("TDATA", "tools").body) == 70, "one of them")
        leg.engine.device.silent = False
        eventually(lambda: len(peer.until("TDATA", "tools").body) == 140, "both again")
        peer.close()


def test_what_waits_when_it_is_stopped_is_not_sent(rig: tuple[Bridge, Server, IgtlPeer]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as door:
        peer = IgtlPeer.connected(door.getsockname()[1])
        ours, _ = door.accept()
    connection = Connection(ours, "a pair", rig[0])
    connection.offer([Message("arm/a", Transform(np.eye(4))), Message("arm/b", String("b"))])
    connection.stopped.add(("TRANSFORM", ""))
    connection.start()
    assert peer.next().device == "arm/b"
    peer.close()
    connection.join(LONG)


def test_who_speaks_version_2_is_answered_in_it_with_unit_and_frame(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    _, _, peer = rig
    assert peer.until("TRANSFORM", "arm/measured_cp").version == 1
    peer.send("GET_STATUS", "arm", struct.pack(">HHIIH", 12, 2, 0, 0, 0), version=2)
    while (got := peer.until("TRANSFORM", "arm/measured_cp")).version == 1:
        pass
    assert got.body.endswith(b"unitmmframe_idbase")
    assert len(got.body) == 12 + 48 + 2 + 16 + 18


def test_names_without_room_and_values_that_nobody_tells_are_refused_at_the_start(
    arm: Any,
) -> None:
    with pytest.raises(ConfigError, match="has 22 letters"):
        Bridge({"left_arm_1": arm}, only=["measured_cp"])
    with pytest.raises(ConfigError, match="no device tells measured_xy"):
        Bridge({"arm": arm}, only=["measured_xy"])


def test_a_port_in_use_is_told_and_more_peers_than_it_takes_are_sent_away(arm: Any) -> None:
    with served({"arm": arm}, rate=1.0) as (bridge, server):
        with pytest.raises(ConnectionFailed, match="cannot listen"):
            Server(bridge, port=server.port)
        peers = [IgtlPeer.connected(server.port) for _ in range(MOST_PEERS)]
        eventually(lambda: len(bridge.connections) == MOST_PEERS, "all are connected")
        more = IgtlPeer.connected(server.port)
        assert more.is_sent_away()
        for peer in (*peers, more):
            peer.close()
        eventually(lambda: not bridge.connections, "all are gone")


def test_it_calls_a_server_and_again_when_that_was_gone(arm: Any) -> None:
    with Bridge({"arm": arm}) as bridge, socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(LONG)
        caller = Caller(bridge, "127.0.0.1", listening.getsockname()[1])
        caller.start()
        try:
            for _ in range(2):
                peer = IgtlPeer(listening.accept()[0])
                peer.until("TRANSFORM", "arm/measured_cp")
                peer.close()
        finally:
            caller.close()


def test_nothing_is_left_when_it_is_closed(arm: Any) -> None:
    before = set(threading.enumerate())
    with served({"arm": arm}) as (_, server):
        peer = IgtlPeer.connected(server.port)
        peer.next()
    assert peer.is_sent_away()
    peer.close()
    left = set(threading.enumerate()) - before
    assert not [each for each in left if each.name.startswith("igtl")]


def test_a_peer_that_cannot_be_served_is_not_the_last_one(
    arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> None:
        raise RuntimeError("no status")

    with served({"arm": arm}) as (bridge, server):
        with monkeypatch.context() as patch:
            patch.setattr(arm, "operating_state", broken)
            with socket.create_connection(("127.0.0.1", server.port), LONG) as peer:
                peer.settimeout(LONG)
                assert peer.recv(1) == b"", "it is let go"
        assert bridge.connections == ()
        another = IgtlPeer.connected(server.port)
        until_status(another, "DISABLED")
        another.close()


def test_a_value_that_cannot_be_read_or_sent_keeps_no_other_from_a_peer(
    rig: tuple[Bridge, Server, IgtlPeer], arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(**_: float) -> None:
        raise ValueError("vectors of different sizes")

    bridge, _, peer = rig
    peer.until("TRANSFORM", "arm/measured_cp")
    feed = next(each for each in bridge.devices["arm"].feeds if each.name == "measured_js")
    monkeypatch.setattr(feed, "_read", broken)
    until_told_again(peer, "arm/measured_cp")
    (connected,) = bridge.connections
    far = Transform(at(1e40, 0.0, 0.0))
    connected.offer([Message("far", far), Message("text", String("after it"))])
    peer.until("STRING", "text")


def until_told_again(peer: IgtlPeer, device: str) -> None:
    """Until two values have come that were not there before."""
    begun, stamps = time_of(time.time_ns()), set[int]()
    while len(stamps) < 2:
        stamps |= {each for each in (peer.until("TRANSFORM", device).time,) if each > begun}


def test_a_pose_that_is_no_rotation_is_told_to_who_asks_for_a_position(
    rig: tuple[Bridge, Server, IgtlPeer],
) -> None:
    bridge, _, peer = rig
    odd = at(1.0, 2.0, 3.0)
    odd[:3, :3] *= 1.1
    with bridge._lock:  # as a device on the far side of ROS may tell it
        bridge._latest["odd"] = Message("odd", Transform(odd), stamp_ns=1)
    peer.send("GET_POSITION", "odd")
    assert len(peer.until("POSITION", "odd").body) == 28
