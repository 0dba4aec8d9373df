"""Recording of the full-rate stream over real datagrams: the command, Ctrl-C, lost links, the services."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import yaml

from crtk_driver_ati_netft import PLUGIN, tools
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.recording import read_recording
from crtk_driver_ati_netft.tools import RecordOptions
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Severity
from crtk_drivers.errors import CommandRefused, ConfigError, ConnectionFailed, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from rigs.full_disk import largest_file
from rigs.netft_peer import Peer
from rigs.programs import COMMAND
from rigs.waiting import LONG, eventually
from rigs.warm_start import Process, server

RATE = 2000.0
SETTINGS = {
    "http": False,
    "profile": "netbox",
    "transport": "udp",
    "scale": {"counts_per_force": 1e6, "counts_per_torque": 1e6},
    "rate": 100.0,
    "bias": (1.0, 0.0, 0.0, 0.0, 0.0, 0.5),
    "sample_timeout": 2.0,  # a busy machine is no lost link
}


def assert_no_gaps(data: np.ndarray) -> None:
    """Every record is there; where the peer was held up for 0.1 s, the driver has asked for them anew."""
    begins = data["sequence"][1:] == 1
    assert (begins | (np.diff(data["sequence"].astype(int)) == 1)).all()
    assert (begins | (np.diff(data["ticks"]) == 2)).all()


@pytest.fixture
def peer() -> Iterator[Peer]:
    with Peer() as peer:
        peer.rate = RATE
        peer.tick_rate = 2 * RATE
        peer.counts = (1500000, 0, 0, 0, 0, -250000)
        yield peer


@pytest.fixture
def config(peer, tmp_path) -> NetFtConfig:
    values = {**SETTINGS, "host": peer.host, "rdt_port": peer.port, "recordings": str(tmp_path)}
    return load(NetFtConfig, from_values(values))


@pytest.mark.parametrize("suffix", ["ftrec", "csv"])
def test_every_record_is_in_the_file_and_not_the_decimated_ones(
    config, peer, tmp_path, capsys, suffix
) -> None:
    out = tmp_path / f"load.{suffix}"
    assert tools.record(config, RecordOptions(out=str(out), seconds=0.5)) == 0
    peer.wait_for(0)
    found = read_recording(out)
    sequence = found.data["sequence"].astype(int)
    assert len(sequence) > 100
    assert_no_gaps(found.data)
    assert np.diff(found.data["ticks"])[0] == 2
    steps = np.diff(found.data["stamp"])
    # How far apart they arrive is the machine's: what it held up comes in bursts.
    assert (steps >= 0).all()
    assert 0 < found.data["stamp"][-1] - found.data["stamp"][0] < LONG * 1e9
    assert abs(found.data["stamp"][-1] - time.time_ns()) < LONG * 1e9
    assert found.data["raw"] == pytest.approx(
        np.tile([1.5, 0, 0, 0, 0, -0.25], (len(steps) + 1, 1))
    )
    assert found.data["wrench"][-1] == pytest.approx([0.5, 0, 0, 0, 0, -0.75])
    header = found.header
    assert (header["host"], header["profile"]) == (peer.host, "netbox")
    assert header["sensor"]["scale"]["counts_per_force"] == 1e6
    assert header["bias"] == [1.0, 0.0, 0.0, 0.0, 0.0, 0.5]
    text = capsys.readouterr().out
    assert f"{len(sequence)} measurements" in text
    assert "0 lost" in text


def test_lost_records_show_as_gaps_and_are_counted(config, peer, tmp_path, capsys) -> None:
    out = tmp_path / "load.ftrec"
    send = peer.socket

    class Leaky:
        """Drops one datagram in fifty."""

        def __init__(self) -> None:
            self.count = 0

        def sendto(self, data: bytes, address: Any) -> None:
            self.count += 1
            if self.count % 50:
                send.sendto(data, address)

        def __getattr__(self, name: str) -> Any:
            return getattr(send, name)

    peer.socket = Leaky()  # type: ignore[assignment]
    assert tools.record(config, RecordOptions(out=str(out), seconds=0.5)) == 0
    steps = np.diff(read_recording(out).data["sequence"].astype(int))
    assert set(steps[steps > 0].tolist()) == {1, 2}, "back to the begin where it was asked anew"
    assert ", 0 lost" not in capsys.readouterr().out


def test_it_fails_when_there_is_no_sensor_and_leaves_no_file(config, tmp_path) -> None:
    out = tmp_path / "load.ftrec"
    away = config.model_copy(update={"rdt_port": 9, "open_timeout": 0.2})
    with pytest.raises(ConnectionFailed):
        tools.record(away, RecordOptions(out=str(out)))
    assert not out.exists()


def test_it_writes_over_nothing(config, tmp_path) -> None:
    out = tmp_path / "load.ftrec"
    out.write_text("precious")
    with pytest.raises(ConfigError, match="exists already"):
        tools.record(config, RecordOptions(out=str(out)))


@pytest.fixture
def command(peer, tmp_path) -> Iterator[Process]:
    """The command line as people use it, recording until it is stopped."""
    config = tmp_path / "sensor.yaml"
    config.write_text(yaml.safe_dump({**SETTINGS, "bias": [0.0] * 6, "sample_timeout": 0.3}))
    arguments = ["ati-netft", "record", "--out", str(tmp_path / "load.ftrec")]
    arguments += ["--config", str(config), "--host", peer.host, "--rdt-port", str(peer.port)]
    with server().start_text(
        COMMAND, *arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        yield process
        process.kill()


@pytest.mark.real_time  # reads what a command prints
def test_it_goes_on_after_a_lost_link_and_is_whole_after_ctrl_c(peer, tmp_path, command) -> None:
    out = tmp_path / "load.ftrec"

    def count() -> int:
        return len(read_recording(out).data) if out.exists() and out.stat().st_size else 0

    eventually(lambda: count() > 100, "the first measurements")
    peer.rate = 0.0
    peer.wait_for(0)
    peer.rate = RATE
    before = count()
    eventually(lambda: count() > before + 100, "measurements after the pause")
    command.send_signal(signal.SIGINT)
    text, told = command.communicate(timeout=LONG)
    assert command.returncode == 0, told
    assert "Connecting again" in told
    found = read_recording(out)
    assert found.cut == 0
    assert f"{len(found.data)} measurements" in text.replace("\n", "")
    sequence = found.data["sequence"].astype(int)
    assert np.count_nonzero(np.diff(sequence) < 0) >= 1, "the stream was asked for anew"


@pytest.mark.slow
def test_what_a_kill_leaves_can_be_read(peer, tmp_path, command) -> None:
    out = tmp_path / "load.ftrec"
    eventually(lambda: out.exists() and out.stat().st_size > 50_000, "measurements")
    command.kill()
    command.wait(LONG)
    assert len(read_recording(out).data) > 100


@pytest.fixture
def front(config) -> Iterator[Any]:
    with Session(PLUGIN, config) as session:
        eventually(lambda: session.engine.has_sample, "a sample")
        yield LocalDevice(session)


def test_the_services_record_while_the_device_serves(front, config, tmp_path) -> None:
    with pytest.raises(CommandRefused, match="nothing is recorded"):
        front.record_stop()
    said = front.record_start()
    (out,) = tmp_path.glob("netft-127.0.0.1-*.ftrec")
    assert str(out) in said
    with pytest.raises(ConfigError, match="a recording goes on"):
        front.record_start()
    recorder = front.engine.device.recorder
    eventually(lambda: recorder.written > 100, "measurements")
    notes = {note.key: note.text for note in front.health().notes}
    assert str(out) in notes["recording"]
    assert "measurements" in front.record_stop()
    assert_no_gaps(read_recording(out).data)
    assert "recording" not in {note.key for note in front.health().notes}


def test_a_recording_that_failed_is_told_and_the_stream_goes_on(front, tmp_path) -> None:
    front.record_start()
    recorder = front.engine.device.recorder
    eventually(lambda: recorder.written > 0, "measurements")
    with largest_file(recorder.size):
        eventually(lambda: recorder.error, "the disk is full")
    severities = {note.key: note.severity for note in front.health().notes}
    assert severities["recording"] is Severity.ERROR
    assert front.measured_cf(age=0.5, wait=LONG) is not None
    with pytest.raises(TransitionFailed, match="the recording"):
        front.record_stop()
    front.record_start()
    front.record_stop()


def test_without_a_directory_the_service_says_what_is_missing(config) -> None:
    config = config.model_copy(update={"recordings": ""})
    with Session(PLUGIN, config) as session:
        eventually(lambda: session.engine.has_sample, "a sample")
        front: Any = LocalDevice(session)
        with pytest.raises(CommandRefused, match="no directory"):
            front.record_start()
