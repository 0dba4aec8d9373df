"""What goes wrong at a tracker, and what is told of it. It never comes back ENABLED by itself."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from crtk_driver_ndi.codec import command
from crtk_driver_ndi.config import NdiConfig
from crtk_driver_ndi.link import NdiLink
from crtk_drivers.errors import ConnectionFailed, TransitionFailed
from crtk_drivers.state import OperatingState
from crtk_sim_backends.process import RunningSim
from rigs.full_queue import full_queue
from rigs.ndi_bench import TRANSPORTS, NdiBench, configuration, ndi_bench, simulated
from rigs.waiting import LONG, eventually

S = OperatingState

pytestmark = pytest.mark.sweep(2)


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with simulated() as running:
        yield running


@pytest.fixture(params=TRANSPORTS)
def bench(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[NdiBench]:
    """A driver whose tracker tracks."""
    with ndi_bench(sim, transport=request.param) as made:
        made.tracking()
        yield made
        sim.control.clear()


@pytest.fixture(params=TRANSPORTS)
def hasty(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[NdiBench]:
    """The same, of a driver that waits for a frame no longer than a busy machine may need."""
    with ndi_bench(sim, transport=request.param, sample_timeout=1.0) as made:
        made.tracking()
        yield made
        sim.control.clear()


def comes_back(bench: NdiBench) -> None:
    """It connects by itself, is DISABLED, and can be enabled."""
    bench.connected()
    bench.state(S.DISABLED)
    for name in bench.session.children:
        assert not bench.is_valid(name)
    bench.tracking()


def test_the_cable_is_out(bench: NdiBench) -> None:
    bench.sim.control.inject("disconnect")
    bench.state(S.FAULT)
    for name in bench.session.children:
        tool = getattr(bench.front, name)
        eventually(lambda tool=tool: tool.operating_state().state is S.FAULT, "FAULT")
        assert not bench.is_valid(name)
    bench.sim.control.clear("disconnect")
    comes_back(bench)


def test_it_falls_silent(hasty: NdiBench) -> None:
    hasty.sim.control.inject("silence")
    hasty.state(S.FAULT, "old")
    hasty.sim.control.clear("silence")
    comes_back(hasty)


def test_its_frames_stand_still(hasty: NdiBench) -> None:
    hasty.sim.control.inject("frozen")
    hasty.state(S.FAULT, "old")
    hasty.sim.control.clear("frozen")
    comes_back(hasty)


def test_it_is_reset_while_it_tracks(bench: NdiBench) -> None:
    """Over a serial line its rate is lost too, and found again."""
    bench.sim.control.inject("reset")
    bench.state(S.FAULT)
    comes_back(bench)


def test_it_is_reset_while_it_does_not(bench: NdiBench) -> None:
    bench.front.disable()
    bench.sim.control.inject("reset")
    bench.state(S.FAULT)
    comes_back(bench)


@pytest.mark.parametrize("code", [0x0C, 0x1A, 0x0F])
def test_an_error_while_it_tracks_ends_that(bench: NdiBench, code: int) -> None:
    bench.sim.control.inject("error", command="BX2", code=code)
    bench.state(
        S.DISABLED if code == 0x0C else S.FAULT, "another client" if code == 0x0C else f"{code:02X}"
    )
    bench.sim.control.clear("error")
    bench.tracking()


def test_a_warning_while_it_tracks_is_told_and_survived(
    bench: NdiBench, caplog: pytest.LogCaptureFixture
) -> None:
    bench.sim.control.inject("warning", command="BX2")
    eventually(lambda: "WARNING06" in caplog.text, "a warning")
    bench.sim.control.clear("warning")
    frames = bench.counters["frames"]
    eventually(lambda: bench.counters["frames"] > frames + 5, "frames go on")
    bench.state(S.ENABLED)


@pytest.mark.parametrize("command", ["TSTART", "TSTOP"])
def test_a_transition_is_refused_with_the_error(bench: NdiBench, command: str) -> None:
    if command == "TSTART":
        bench.front.disable()
    bench.sim.control.inject("error", command=command, code=0x12)
    with pytest.raises(TransitionFailed, match="ERROR12: tracking could not be started"):
        (bench.front.enable if command == "TSTART" else bench.front.disable)()
    bench.sim.control.clear("error")
    bench.tracking()


def test_damaged_replies_are_dropped_and_asked_for_again(bench: NdiBench) -> None:
    bench.sim.control.inject("damage", every=4)
    eventually(lambda: bench.counters["damaged_replies"] > 10, "damaged replies")
    bench.state(S.ENABLED)
    frames = bench.counters["frames"]
    eventually(lambda: bench.counters["frames"] > frames + 20, "frames go on")


def test_nothing_but_damaged_replies_is_a_lost_link(bench: NdiBench) -> None:
    bench.sim.control.inject("damage", every=1)
    bench.state(S.FAULT, "damaged replies one after the other")
    bench.sim.control.clear("damage")
    comes_back(bench)


@pytest.mark.parametrize("size", [0xFFFFFFFF, 1 << 21, 1000])
def test_a_length_that_is_a_lie(hasty: NdiBench, size: int) -> None:
    """Beyond all sense it is refused at once; a little too long, the rest is waited for in vain."""
    hasty.sim.control.inject("hostile_length", size=size)
    hasty.state(S.FAULT)
    hasty.sim.control.clear("hostile_length")
    comes_back(hasty)


def test_what_nobody_knows_is_skipped(bench: NdiBench) -> None:
    bench.sim.control.inject("strange")
    frames = bench.counters["frames"]
    eventually(lambda: bench.counters["frames"] > frames + 10, "frames go on")
    bench.state(S.ENABLED)


def test_a_lost_reply_is_asked_for_again(bench: NdiBench) -> None:
    bench.sim.control.inject("swallow", command="BX2", duration=0.1)
    frames = bench.counters["frames"]
    eventually(lambda: bench.counters["frames"] > frames + 10, "frames go on")
    bench.state(S.ENABLED)


def test_a_wired_tool_is_unplugged(bench: NdiBench) -> None:
    """Seen when nothing is tracked; its part numbers are asked for again."""
    bench.front.disable()
    bench.sim.control.inject("unplug", tool=0)
    bench.state(S.FAULT, "plugged")
    bench.connected()
    assert "pointer is not plugged in" in [note.text for note in bench.front.health().notes]
    bench.sim.control.clear("unplug")
    bench.state(S.FAULT, "plugged")
    comes_back(bench)


def test_no_tracker_tracks_after_close(sim: RunningSim) -> None:
    """It has answered by then: what comes late would stop the next driver's tracking."""
    for transport in TRANSPORTS:
        with ndi_bench(sim, transport=transport) as bench:
            bench.tracking()
            bench.front.close()
            assert sim.control.status()["mode"] == "setup"
            assert bench.session.engine.status.state is not S.FAULT


def test_another_client_stops_tracking(sim: RunningSim) -> None:
    with ndi_bench(sim) as bench:
        bench.tracking()
        with socket.create_connection((sim.host, sim.ports["tcp"]), timeout=LONG) as other:
            other.sendall(command("TSTOP:"))
            assert other.recv(100) == b"OKAYA896\r"
        bench.state(S.DISABLED, "is there another client")
        bench.tracking()


def test_a_second_driver_at_a_serial_line_is_refused_with_the_first(sim: RunningSim) -> None:
    with ndi_bench(sim, transport="serial") as bench:
        bench.tracking()
        second = NdiBench(sim, configuration(sim, transport="serial"))
        try:
            with pytest.raises(ConnectionFailed, match="in use by process"):
                second.session.engine.device.open(float("inf"))
        finally:
            second.front.close()
        frames = bench.counters["frames"]
        eventually(lambda: bench.counters["frames"] > frames + 5, "the first goes on")


@pytest.mark.parametrize("transport", TRANSPORTS)
@pytest.mark.parametrize(
    ("text", "code", "words"),
    [
        ("INIT", 0x15, "ERROR15: the system could not be initialised"),
        ("PENA", 0x28, "too many tools"),
        ("PHF", 0x08, "no such port handle"),
    ],
)
def test_what_is_refused_while_it_connects_is_told(
    sim: RunningSim, transport: str, text: str, code: int, words: str
) -> None:
    with ndi_bench(sim, transport=transport):
        pass  # the rate of its line is known from here on
    sim.control.inject("error", command=text, code=code)
    made = NdiBench(sim, configuration(sim, transport=transport))
    try:
        made.session.start()
        made.state(S.FAULT, words)
        sim.control.clear("error")
        comes_back(made)
    finally:
        sim.control.clear()
        made.front.close()


def test_a_warning_while_it_connects_is_a_success(sim: RunningSim) -> None:
    sim.control.inject("warning", command="PINIT")
    try:
        with ndi_bench(sim) as bench:
            assert bench.front.operating_state().state is S.DISABLED
    finally:
        sim.control.clear()


def test_nobody_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("crtk_driver_ndi.link.PATIENCE", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as deaf, simulated() as sim:
        config = configuration(sim).model_copy(
            update={"host": "127.0.0.1", "tcp_port": deaf.getsockname()[1]}
        )
        made = NdiBench(sim, config)
        try:
            made.session.start()
            made.state(S.FAULT, "nobody answers")
        finally:
            made.front.close()


@pytest.mark.real_time  # how many wait to be accepted is up to Linux
def test_a_shut_down_ends_a_connection_that_is_being_made() -> None:
    with full_queue() as (host, port):
        link = NdiLink(NdiConfig(host=host, tcp_port=port))
        failed: list[ConnectionFailed] = []

        def connect() -> None:
            with pytest.raises(ConnectionFailed) as error:
                link.open(float("inf"))
            failed.append(error.value)

        thread = threading.Thread(target=connect)
        thread.start()
        link.abort()
        thread.join(LONG)
        assert failed
        assert "given up" in failed[0].message


def test_a_shut_down_does_not_wait_for_an_answer_that_does_not_come(sim: RunningSim) -> None:
    sim.control.inject("swallow", command="INIT")
    made = NdiBench(sim, configuration(sim))
    try:
        made.session.start()
        eventually(lambda: sim.control.status()["connections"]["tcp"], "connected")
        made.front.close()
    finally:
        sim.control.clear()
