"""The simulated WSG gripper by its bytes: what other clients send is answered as hardware answers."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.weiss_wsg import SIM, RunningSim
from rigs.waiting import LONG, eventually
from rigs.wsg_bench import FREE_PORTS

STOP = "AAAAAA 22 0000 0E76"
FAST_STOP = "AAAAAA 23 0000 AC1C"
ACKNOWLEDGE = "AAAAAA 24 0300 61636B DCB9"
HOME = "AAAAAA 20 0100 00 8F83"
GRASP = "AAAAAA 25 0800 00002042 00004842 835C"
"""A part of 40 mm at 50 mm/s."""
QUICK_GRASP = "00002042 0000D243"
"""The same at 420 mm/s."""
HOME_PENDING, HOME_DONE = "AAAAAA 20 0200 1A00", "AAAAAA 20 0200 0000 B3FD"


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """As nobody has used it: referenced, no fast stop, nothing between its fingers."""
    shared.control.clear()
    eventually(lambda: not any(shared.control.status()["connections"].values()), "nobody there")
    shared.control.inject("as_new", opening=0.11)
    yield shared
    shared.control.clear()


def crc(data: bytes) -> int:
    """The manual's function (1.2.1), bit by bit."""
    value = 0xFFFF
    for byte in data:
        entry = ((value ^ byte) & 0xFF) << 8
        for _ in range(8):
            entry = (entry << 1 ^ 0x1021) & 0xFFFF if entry & 0x8000 else entry << 1
        value = entry ^ value >> 8
    return value


def frame(number: int, payload: str = "") -> str:
    """Return a frame as a text."""
    body = bytes.fromhex(payload)
    data = b"\xaa\xaa\xaa" + bytes((number,)) + len(body).to_bytes(2, "little") + body
    return (data + crc(data).to_bytes(2, "little")).hex()


def frame_head(number: int, status: int, size: int = 2) -> str:
    """Return how an answer begins."""
    return f"AAAAAA {number:02X} {size:02X}00 {status:02X}00"


class Client:
    """A client that sends bytes, or lines, and reads what comes until it has seen what it wants."""

    def __init__(self, peer: socket.socket) -> None:
        self.peer = peer
        peer.settimeout(LONG)
        self.heard = b""

    def say(self, text: str) -> None:
        self.peer.sendall(bytes.fromhex(text))

    def read(self, text: str) -> bytes:
        return self.wait(bytes.fromhex(text))

    def ask(self, text: str, answer: str) -> bytes:
        """Return what came before the answer."""
        self.say(text)
        return self.read(answer)

    def line(self, text: str, answer: str) -> bytes:
        self.peer.sendall(f"{text}\n".encode())
        return self.wait(f"{answer}\n".encode())

    def wait(self, wanted: bytes) -> bytes:
        while wanted not in self.heard:
            data = self.peer.recv(4096)
            assert data, f"closed before {wanted!r}: {self.heard!r}"
            self.heard += data
        before, _, self.heard = self.heard.partition(wanted)
        return before


@contextmanager
def client(sim: RunningSim, port: str = "binary") -> Iterator[Client]:
    with socket.create_connection((sim.host, sim.ports[port])) as peer:
        yield Client(peer)


# -------------------------------------------------------------------------------- known frames


def test_the_frames_of_the_ros_client_are_answered(sim: RunningSim) -> None:
    """nalt/wsg50-ros-pkg: acknowledge, home, move with a flag, set force, polling."""
    with client(sim) as it:
        it.ask(ACKNOWLEDGE, frame_head(0x24, 0))
        it.ask(HOME, HOME_PENDING)
        it.read(HOME_DONE)
        it.ask(frame(0x21, "02 00004842 0000D243"), "AAAAAA 21 0200 1A00 67CB")
        it.read("AAAAAA 21 0200 0000 2804")
        it.ask(frame(0x32, "0000A041"), frame_head(0x32, 0))
        it.ask(frame(0x33), frame_head(0x33, 0, 6) + "0000A041")
        it.ask(frame(0x43, "000000"), "AAAAAA 43 0600 0000 00004842 62FF")
        it.ask(frame(0x41, "000000"), frame_head(0x41, 0, 3) + "00")
        it.ask(frame(0x40, "000000"), frame_head(0x40, 0, 6) + "81000000")
        it.say(frame(0x07))
        it.read(frame_head(0x07, 0))
    eventually(lambda: not sim.control.status()["connections"]["binary"], "gone")
    assert not sim.control.status()["fast_stop"], "it has said goodbye"


def test_the_frames_of_the_drake_client_are_answered(sim: RunningSim) -> None:
    """drake-schunk-driver: info, updates of all, home both ways, tare without a sensor, limits."""
    with client(sim) as it:
        it.ask(frame(0x50), frame_head(0x50, 0, 10))
        for number in (0x40, 0x41, 0x43, 0x44, 0x45):
            it.ask(frame(number, "01 1400"), frame(number, "")[:8])
        it.ask(frame(0x20, "02"), HOME_PENDING)
        it.read(HOME_DONE)
        assert sim.control.status()["opening"] == 0.0
        it.ask(frame(0x20, "01"), HOME_PENDING)
        it.read(HOME_DONE)
        it.ask(frame(0x38), frame_head(0x38, 1))
        it.ask(frame(0x53), frame_head(0x53, 0, 34) + "0000DC42 0000A040 0000D243")
        it.ask(frame(0x36), frame_head(0x36, 0))
        it.ask(frame(0x30, "00409C45"), frame_head(0x30, 0))
        it.ask(STOP, frame_head(0x22, 0))


def test_a_part_is_grasped_and_released(sim: RunningSim) -> None:
    sim.control.inject("object", width=0.04)
    with client(sim) as it:
        it.ask(frame(0x21, "00 00005842 0000D243"), frame_head(0x21, 26))
        it.read(frame_head(0x21, 0))
        it.ask(frame(0x41, "02 0A00"), frame_head(0x41, 0, 3))
        it.ask(GRASP, frame_head(0x25, 26))
        it.read(frame_head(0x25, 0))
        it.read(frame_head(0x41, 0, 3) + "04")
        it.ask(GRASP, frame_head(0x25, 16))
        it.ask(frame(0x21, "00 0000C842 00004842"), frame_head(0x21, 16))
        it.ask(frame(0x26, "0000A042 0000D243"), frame_head(0x26, 26))
        it.read(frame_head(0x26, 0))
        assert sim.control.status()["opening"] == pytest.approx(0.08)


def test_no_part_fails(sim: RunningSim) -> None:
    with client(sim) as it:
        it.ask(frame(0x25, QUICK_GRASP), frame_head(0x25, 26))
        it.read(frame_head(0x25, 18))
        assert sim.control.status()["grasping"] == 2


def test_a_part_that_is_too_wide_blocks(sim: RunningSim) -> None:
    sim.control.inject("object", width=0.06)
    with client(sim) as it:
        it.ask(frame(0x25, QUICK_GRASP), frame_head(0x25, 26))
        it.read(frame_head(0x25, 29))


def test_a_move_is_replaced_by_another(sim: RunningSim) -> None:
    with client(sim) as it:
        it.ask(frame(0x21, "00 00000000 0000A041"), frame_head(0x21, 26))
        it.ask(frame(0x21, "00 0000C842 0000A041"), frame_head(0x21, 19))
        it.read(frame_head(0x21, 26))
        it.ask(STOP, frame_head(0x21, 19))


def test_a_damaged_frame_is_answered_so_and_the_next_is_heard(sim: RunningSim) -> None:
    with client(sim) as it:
        it.ask("AAAAAA 22 0000 0000", frame_head(0x22, 11))
        it.say("00 AAAAAA 22 FFFF AA 01")
        it.ask(STOP, frame_head(0x22, 0))


@pytest.mark.parametrize(
    ("number", "payload", "status"),
    [
        (0x90, "", 14),
        (0x21, "00", 13),
        (0x22, "01", 12),
        (0x24, "616263", 12),
        (0x30, "0000C07F", 24),
    ],
)
def test_what_it_does_not_take(sim: RunningSim, number: int, payload: str, status: int) -> None:
    with client(sim) as it:
        it.ask(frame(number, payload), frame_head(number, status))


def test_a_frame_may_come_byte_by_byte(sim: RunningSim) -> None:
    with client(sim) as it:
        for byte in bytes.fromhex(STOP):
            it.peer.sendall(bytes((byte,)))
        it.read(frame_head(0x22, 0))


# ------------------------------------------------------------------------------------- fast stop


def test_closing_without_goodbye_stops_fast(sim: RunningSim) -> None:
    with client(sim) as it:
        it.ask(frame(0x21, "00 00000000 0000A041"), frame_head(0x21, 26))
    eventually(lambda: sim.control.status()["fast_stop"], "stopped fast")
    assert not sim.control.status()["moves"]
    with client(sim) as it:
        it.ask(HOME, frame_head(0x20, 16))
        it.ask(ACKNOWLEDGE, frame_head(0x24, 0))
        it.ask(HOME, HOME_PENDING)


def test_a_second_client_is_sent_away_and_the_first_goes_on(sim: RunningSim) -> None:
    with client(sim) as first:
        with client(sim) as second:
            assert second.peer.recv(1) == b""
        first.ask(STOP, frame_head(0x22, 0))
    eventually(lambda: sim.control.status()["fast_stop"], "the first has gone")


def test_it_need_not_stop() -> None:
    with SIM.spawn(**FREE_PORTS, fast_stop_on_disconnect=False) as sim:
        with client(sim) as it:
            it.ask(FAST_STOP, frame_head(0x23, 0))
            it.ask(ACKNOWLEDGE, frame_head(0x24, 0))
        eventually(lambda: not sim.control.status()["connections"]["binary"], "gone")
        assert not sim.control.status()["fast_stop"]


# -------------------------------------------------------------------------------------- text mode


def test_the_text_mode_speaks_as_its_clients_expect(sim: RunningSim) -> None:
    sim.control.inject("object", width=0.03)
    with client(sim, "text") as it:
        it.line("FSACK()", "ACK FSACK")
        it.line("MOVE(60)", "ACK MOVE")
        it.line("", "FIN MOVE")
        it.line("POS?", "POS=60")
        it.line("MOVE(10, 200)", "ACK MOVE")
        it.line("", "ERR MOVE 29")
        it.line("GRIP(30)", "ACK GRIP")
        it.line("", "FIN GRIP")
        it.line("GRIPSTATE?", "GRIPSTATE=4")
        it.line("GRIP(30)", "ERR GRIP 16")
        it.line("RELEASE(10)", "ACK RELEASE")
        it.line("", "FIN RELEASE")
        it.line("PWT=2", "PWT=2")
        it.line("VERBOSE=1", "VERBOSE=1")
        it.line("SYSFLAGS[0]?", "SYSFLAGS[0]=1")
        it.line("SING()", "ERR SING 14")
        it.line("MOVE(a)", "ERR MOVE 15")
        it.line('AUTOSEND("GRIPSTATE",20)', "ACK AUTOSEND")
        it.wait(b"@GRIPSTATE=0\n")
        it.line("STOP()", "ACK STOP")
        it.line("BYE()", "ACK BYE")
        while it.peer.recv(4096):
            pass
    assert not sim.control.status()["fast_stop"]


# ------------------------------------------------------------------------------- faults and options


@pytest.mark.parametrize("status", [1, 4, 16, 28])
def test_every_status_on_demand(sim: RunningSim, status: int) -> None:
    sim.control.inject("refuse", command="MOVE", status=status)
    with client(sim) as it:
        it.ask(frame(0x21, "00 00004842 00004842"), frame_head(0x21, status))
    sim.control.clear("refuse")
    sim.control.inject("fail", command="MOVE", status=status)
    with client(sim) as it:
        it.ask(ACKNOWLEDGE, frame_head(0x24, 0))
        it.ask(frame(0x21, "00 0000C842 0000D243"), frame_head(0x21, 26))
        it.read(frame_head(0x21, status))


def test_a_part_that_slips_and_one_that_is_lost(sim: RunningSim) -> None:
    sim.control.inject("object", width=0.04)
    with client(sim) as it:
        it.ask(frame(0x25, QUICK_GRASP), frame_head(0x25, 26))
        it.read(frame_head(0x25, 0))
        sim.control.inject("slip", speed=0.003)
        eventually(lambda: sim.control.status()["opening"] < 0.0385, "slipped")
        sim.control.clear("slip")
        assert sim.control.status()["grasping"] == 4
        sim.control.inject("object_lost")
        eventually(lambda: sim.control.status()["grasping"] == 3, "lost")


def test_answers_are_doubled_held_and_swallowed(sim: RunningSim) -> None:
    with client(sim) as it:
        sim.control.inject("doubled")
        it.ask(STOP, frame_head(0x22, 0))
        it.read(frame_head(0x22, 0))
        sim.control.clear("doubled")
        sim.control.inject("held", seconds=0.05)
        it.say(STOP + frame(0x43, "000000"))
        assert bytes.fromhex(frame_head(0x22, 0)) not in it.read(frame_head(0x43, 0, 6))
        it.read(frame_head(0x22, 0))
        sim.control.clear("held")
        sim.control.inject("swallow", command="STOP")
        it.say(STOP)
        assert it.ask(FAST_STOP, frame_head(0x23, 0)).hex().count("aaaaaa22") == 0


def test_defects_are_of_what_is_told_alone() -> None:
    with SIM.spawn(**FREE_PORTS, defects="position_jump=0.01,jump_at=0.06") as sim:
        with client(sim) as it:
            it.ask(frame(0x43, "000000"), "AAAAAA 43 0600 0000 00004842")
            it.ask(frame(0x21, "00 0000A042 0000D243"), frame_head(0x21, 26))
            it.read(frame_head(0x21, 0))
            it.ask(frame(0x43, "000000"), "AAAAAA 43 0600 0000 0000B442")
        assert sim.control.status()["opening"] == pytest.approx(0.08)


@pytest.mark.parametrize(
    "wrong",
    [{"model": "wsg-60"}, {"opening": 0.2}, {"while_moving": "wait"}, {"binary_port": -1}],
)
def test_wrong_options_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises((SimStartError, ValueError)):
        SIM.spawn(**{**FREE_PORTS, **wrong})


def test_a_fault_file_is_played(tmp_path: Path) -> None:
    path = tmp_path / "faults.yaml"
    path.write_text("- {at: 0.05, kind: fast_stop}\n")
    with SIM.spawn(**FREE_PORTS, faults=str(path)) as sim:
        eventually(lambda: sim.control.status()["fast_stop"], "played")
