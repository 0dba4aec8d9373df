"""Logs in candump's format: written, read by others, replayed."""

import contextlib
import time

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.can import SIM, frames
from crtk_sim_backends.can.candump import LogError, LogWriter, parse, parse_frame, read, text
from crtk_sim_backends.control import ControlError
from crtk_sim_backends.process import SimStartError
from rigs.can_hub_doors import frame, ids, open_bus, receive
from rigs.waiting import LONG, eventually

CAN_IDS = st.one_of(
    st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda n: n | frames.EXTENDED)
)
RAW = st.one_of(
    st.builds(frames.pack, CAN_IDS, st.binary(max_size=8)),
    st.builds(lambda i, n: frames.pack(i | frames.REMOTE, b"", n), CAN_IDS, st.integers(0, 8)),
    st.builds(frames.error_frame, st.integers(0, 0x1FF), st.binary(min_size=8, max_size=8)),
)


@pytest.mark.parametrize(
    ("raw", "line"),
    [
        (frames.pack(0x123, b"\xde\xad\xbe\xef"), "123#DEADBEEF"),
        (frames.pack(0x001), "001#"),
        (frames.pack(0x1 | frames.EXTENDED, b"\x00"), "00000001#00"),
        (frames.pack(0x123 | frames.REMOTE), "123#R"),
        (frames.pack(0x123 | frames.REMOTE, b"", 3), "123#R3"),
        (frames.error_frame(0x40), "20000040#0000000000000000"),
    ],
)
def test_frames_are_written_as_candump_writes_them(raw, line):
    assert text(raw) == line
    assert parse_frame(line) == raw


@given(RAW)
def test_frames_survive_writing_and_reading(raw):
    assert parse_frame(text(raw)) == raw


@given(st.text(max_size=60))
def test_any_text_is_a_line_or_refused(line):
    try:
        record = parse(line)
    except LogError:
        return
    assert len(record.raw) == frames.SIZE


@pytest.mark.parametrize(
    "line", ["800#", "123#1", "123#112233445566778899", "FFFFFFFF#", "12#", ""]
)
def test_wrong_frames_are_refused(line):
    with pytest.raises(LogError):
        parse_frame(line)


def test_a_wrong_line_is_named(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("(1.0) can0 123#\n\n(1.5) can0 123#11 R\n(2.0) can0 123\n")
    with pytest.raises(LogError, match=r"a\.log, line 4: expected a frame such as"):
        list(read(path))


def test_the_log_of_a_bus_is_read_by_python_can(tmp_path):
    path = tmp_path / "bus.log"
    messages = [
        frame(0x123, b"\x01\x02"),
        frame(0x1ABCDEF0, b""),
        frame(0x12, None, is_remote_frame=True, dlc=4),
        frame(0x7FF, bytes(range(8))),
    ]
    began = time.time()
    with SIM.spawn(socketcand_port=0, bitrate=125_000, log=str(path), channel="bus5") as sim:
        with open_bus(sim, "crtk") as a, open_bus(sim, "crtk", name="native-b") as b:
            for message in messages:
                a.send(message)
            receive(b, len(messages))
            sim.control.inject("error_frames", rate=1)
            assert receive(b)[0].is_error_frame
        assert sim.stop() == 0
    with can.CanutilsLogReader(path) as reader:
        got = list(reader)
    assert len(got) == len(messages) + 1
    for message, logged in zip(messages, got, strict=False):
        assert logged.equals(message, timestamp_delta=None, check_channel=False)
    assert got[-1].is_error_frame
    assert {message.channel for message in got[:-1]} == {"bus5"}
    times = [message.timestamp for message in got]
    assert began <= times[0] <= times[-1] <= time.time()
    bits = [frames.exact_bits(record.raw) for record in read(path)]
    for earlier, later, length in zip(times, times[1:], bits[1:], strict=False):
        # The clock of the log is read twice a frame, so it may differ by a few microseconds.
        assert later - earlier >= length / 125_000 - 2e-5


def recorded(tmp_path, lines):
    path = tmp_path / "recorded.log"
    with contextlib.closing(LogWriter(path)) as writer:
        for at, can_id, data in lines:
            writer.write(at, frames.pack(can_id, data))
    return path


def test_a_log_is_replayed_in_order_and_at_its_pace(tmp_path):
    path = recorded(
        tmp_path, [(100.0, 0x300, b"\x01"), (100.05, 0x200, b"\x02"), (100.1, 0x100, b"\x03")]
    )
    with SIM.spawn(socketcand_port=0, terminals=0) as sim, open_bus(sim, "crtk") as bus:
        began = time.monotonic()
        sim.control.call("replay", path=str(path))
        assert [(m.arbitration_id, m.data[0]) for m in receive(bus, 3)] == [
            (0x300, 1),
            (0x200, 2),
            (0x100, 3),
        ]
        assert time.monotonic() - began >= 0.099
        eventually(lambda: "replay" not in sim.control.status()["nodes"])
        assert sim.control.status()["replay"] == {"sent": 3, "error": None}


@pytest.mark.parametrize("speed", [0.0, 1000.0])
def test_a_replay_can_be_faster(tmp_path, speed):
    path = recorded(tmp_path, [(100.0 + n, 0x100 + n, b"") for n in range(20)])
    with (
        SIM.spawn(socketcand_port=0, terminals=0) as sim,
        open_bus(sim, "crtk") as bus,
    ):
        sim.control.call("replay", path=str(path), speed=speed)
        assert ids(receive(bus, 20)) == list(range(0x100, 0x114))


def test_a_new_replay_ends_the_one_before(tmp_path):
    slow = recorded(tmp_path, [(1.0 + n, 0x400 + n, b"") for n in range(100)])
    with SIM.spawn(socketcand_port=0, terminals=0) as sim, open_bus(sim, "crtk") as bus:
        sim.control.call("replay", path=str(slow))
        assert ids(receive(bus)) == [0x400]
        sim.control.call("replay", path=str(slow), speed=20.0)
        assert ids(receive(bus, 3)) == [0x400, 0x401, 0x402]
        assert [name for name in sim.control.status()["nodes"] if "replay" in name] == ["replay"]


def test_a_replay_waits_for_a_slow_bus_and_loses_nothing(tmp_path):
    path = recorded(tmp_path, [(1.0, 0x400, bytes([n])) for n in range(60)])
    with (
        SIM.spawn(socketcand_port=0, terminals=0, bitrate=125_000, queue=4) as sim,
        open_bus(sim, "crtk") as bus,
    ):
        sim.control.call("replay", path=str(path), speed=0)
        assert [message.data[0] for message in receive(bus, 60)] == list(range(60))


def test_a_log_can_be_replayed_from_the_start(tmp_path):
    path = recorded(tmp_path, [(1.0, 0x1, b""), (2.2, 0x2, b"")])
    with SIM.spawn(
        socketcand_port=0, terminals=0, replay=str(path), replay_speed=2.0, log=str(tmp_path / "l")
    ) as sim:
        eventually(lambda: sim.control.status()["replay"]["sent"] == 2)
        assert sim.stop() == 0
    first, second = read(tmp_path / "l")
    assert (text(first.raw), text(second.raw)) == ("001#", "002#")
    assert second.time - first.time > 0.1  # 0.6, less what the first one was late


def test_a_log_with_a_defect_is_replayed_up_to_it(tmp_path):
    path = tmp_path / "broken.log"
    path.write_text("(1.0) can0 100#\nnonsense\n(1.0) can0 101#\n")
    with SIM.spawn(socketcand_port=0, terminals=0) as sim, open_bus(sim, "crtk") as bus:
        sim.control.call("replay", path=str(path))
        assert ids(receive(bus)) == [0x100]
        eventually(lambda: sim.control.status()["replay"]["error"] is not None)
        assert "broken.log, line 2" in sim.control.status()["replay"]["error"]


def test_a_log_that_cannot_be_used_is_refused(tmp_path):
    empty = tmp_path / "empty.log"
    empty.write_text("")
    with SIM.spawn(socketcand_port=0, terminals=0) as sim:
        with pytest.raises(ControlError, match="is empty"):
            sim.control.call("replay", path=str(empty))
        with pytest.raises(ControlError, match="cannot read the log"):
            sim.control.call("replay", path=str(tmp_path / "nothing.log"))
    with pytest.raises(SimStartError, match="cannot write the log"):
        SIM.spawn(socketcand_port=0, log=str(tmp_path / "no" / "folder.log"))


def test_single_frames_are_sent_through_the_control_socket(tmp_path):
    with SIM.spawn(socketcand_port=0, terminals=0) as sim, open_bus(sim, "crtk") as bus:
        assert sim.control.call("send", frame="123#DEAD") == 0
        message = bus.recv(LONG)
        assert (message.arbitration_id, bytes(message.data)) == (0x123, b"\xde\xad")
        with pytest.raises(ControlError, match="such as 123#DEADBEEF"):
            sim.control.call("send", frame="hello")
        with pytest.raises(ControlError, match="error frame"):
            sim.control.call("send", frame="20000040#0000000000000000")
