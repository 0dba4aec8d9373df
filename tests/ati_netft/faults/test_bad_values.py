"""NaN, infinity, the largest and the smallest of numbers in every field of the sensor's wires and inputs.

What comes of it is a refusal in words, or values that are finite: nothing else may leave the driver.
"""

from __future__ import annotations

import itertools
import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from crtk_driver_ati_netft import PLUGIN
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device
from crtk_drivers.errors import CommandRefused, ConfigError, ConnectionLost, DeviceError
from crtk_drivers.samples import Pose, Sample, Wrench, vector
from crtk_sim_backends.netft import SIM, RunningSim
from rigs.netft_bench import FREE_PORTS, LONG, configuration
from rigs.netft_peer import RECORD, Peer

NUMBERS = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1e-300", "5e-324", "0", "-1", "0.5", "1e400",
    str(2**64), "9" * 5000, "0x" + "f" * 5000, "0x", "", "x", "1;2", ";".join(["nan"] * 6),
    ";".join(["1e308"] * 6), ";".join(["-1e308"] * 6), ";".join(["0"] * 6), ";".join(["1e-320"] * 6),
)  # fmt: skip
TAGS = (
    "cfgcpf", "cfgcpt", "cfgfu", "scfgfu", "cfgtu", "scfgtu", "cfgmr", "cfgtfx", "cfgtdu", "scfgtdu",
    "cfgtau", "scfgtau", "setbias", "setcfgsel", "setuserfilter", "runrate", "setrate", "comrdtrate",
    "commrdtrate", "comrdtbsiz", "comrdte", "runstat", "prodname", "mfgdigsn",
)  # fmt: skip


@pytest.fixture(scope="module")
def box() -> Iterator[RunningSim]:
    with SIM.spawn(rdt_rate=7000, load="constant:fz=5", **FREE_PORTS) as sim:
        yield sim


def soon(seconds: float = LONG) -> float:
    return time.monotonic() + seconds


def is_sound(sample: Sample) -> bool:
    """Whether a sample is finite, each value in it and the times."""
    vectors = [value.vector for value in sample.values.values() if isinstance(value, Wrench)]
    assert len(vectors) == len(sample.values)
    finite = all(np.isfinite(one).all() for one in vectors)
    return finite and math.isfinite(sample.stamp.monotonic)


def measures_soundly(device: Device, samples: int = 3) -> None:
    """Read some samples, all finite, and everything that is told besides."""
    deadline = soon()
    for _ in range(samples):
        sample = None
        while sample is None:
            assert time.monotonic() < deadline
            sample = device.read(deadline)
        assert is_sound(sample), sample
    assert all(math.isfinite(value) for value in device.counters.values()), device.counters
    assert all(len(note.text) < 1000 for note in device.notes)


def refuses_or_measures(device: Device) -> None:
    """Open it, and see that it refuses or measures soundly."""
    with suppress(DeviceError):
        device.open(soon())
        measures_soundly(device)


@contextmanager
def device_of(**values: Any) -> Iterator[NetFtDevice]:
    config = load(NetFtConfig, from_values({"sample_timeout": 2.0, **values}))
    device = NetFtDevice(config)
    try:
        yield device
    finally:
        device.close()


# The sensor's page


@pytest.mark.sweep(6)
@pytest.mark.parametrize("tag", TAGS)
def test_any_number_in_a_tag_of_the_page(box: RunningSim, tag: str) -> None:
    for number in NUMBERS:
        box.control.inject("web_tag", tag=tag, text=number)
        device = PLUGIN.create(configuration(box, page_period=0.0))
        try:
            refuses_or_measures(device)
        finally:
            device.close()
            box.control.clear("web_tag")


@pytest.mark.parametrize("length", ["nan", "-1", "1e308", "9" * 5000, "٣", ""])
def test_any_length_in_the_head_of_a_page(length: str) -> None:
    page = (
        b"<netft><cfgcpf>1000000</cfgcpf><cfgcpt>1000000</cfgcpt><scfgfu>N</scfgfu>"
        b"<scfgtu>Nm</scfgtu></netft>"
    )
    head = f"HTTP/1.0 200 OK\r\nContent-Length: {length}\r\n\r\n".encode()
    with one_answer(lambda request: head + page) as port, device_of(
        host="127.0.0.1", http_port=port, http_timeout=2.0
    ) as device, suppress(DeviceError):  # fmt: skip
        assert device.web.read(soon()).scale.counts_per_force == 1e6


# The stream

WORDS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
COUNTS = (0, 1, -1, 2**31 - 1, -(2**31))


def test_any_number_in_a_record() -> None:
    """Each field at its ends, alone and beside others, in the midst of a stream."""
    scale = {"counts_per_force": 0.1, "counts_per_torque": 0.1}
    with Peer() as peer, device_of(
        host=peer.host, rdt_port=peer.port, http=False, transport="udp", scale=scale, rate=1000.0
    ) as device:  # fmt: skip
        peer.rate = 1000.0
        device.open(soon())
        measures_soundly(device)
        for words in itertools.product(WORDS, repeat=3):
            for count in COUNTS:
                peer.send(RECORD.pack(*words, *[count] * 6))
            try:
                measures_soundly(device, 1)
            except ConnectionLost:  # it takes it for a sensor that was restarted
                device.close()
                device.open(soon())
        eventually_measures(device)


def eventually_measures(device: Device) -> None:
    deadline = soon()
    while time.monotonic() < deadline:
        try:
            sample = device.read(deadline)
        except ConnectionLost:
            device.close()
            device.open(deadline)
            continue
        if sample is not None and sample.stamp.wall_ns:
            return
    pytest.fail("the stream never was valid again")


# TCP


@contextmanager
def one_answer(answer: Callable[[bytes], bytes]) -> Iterator[int]:
    """Serve connections one after another: an answer for each request, and then the end, or the next."""
    ended = threading.Event()
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)

    def serve(peer: socket.socket) -> None:
        peer.settimeout(0.05)
        while not ended.is_set():
            with suppress(TimeoutError):
                request = peer.recv(4096)
                if not request:
                    return
                peer.sendall(answer(request))
                if request.startswith(b"GET"):
                    return

    def run() -> None:
        while not ended.is_set():
            with suppress(TimeoutError, ConnectionError):
                peer, _ = listener.accept()
                with peer:
                    serve(peer)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield listener.getsockname()[1]
    finally:
        ended.set()
        thread.join()
        listener.close()


PER_UNIT = (0, 1, 1_000_000, 2**32 - 1)
STEPS = (0, 1, 1000, 2**16 - 1)


@pytest.mark.parametrize("codes", [(2, 3), (0, 0), (1, 6), (3, 1), (255, 255)])
def test_any_number_in_an_answer_over_tcp(codes: tuple[int, int]) -> None:
    now: dict[str, bytes] = {}
    reading = struct.pack(">HH6h", 0x1234, 0, -32768, 32767, 0, 1, -1, -32768)

    def answer(request: bytes) -> bytes:
        return now["scale"] if request[0] == 1 else reading

    with one_answer(answer) as port:
        for force, torque, step in itertools.product(PER_UNIT, PER_UNIT, STEPS):
            now["scale"] = struct.pack(">HBBII6H", 0x1234, *codes, force, torque, *[step] * 6)
            with device_of(
                host="127.0.0.1", tcp_port=port, transport="tcp", http=False,
                scale={"counts_per_force": 1e6, "counts_per_torque": 1e6}, rate=1000.0,
            ) as device:  # fmt: skip
                refuses_or_measures(device)


# What people set

LARGE = (math.nan, math.inf, -math.inf, 1e308, -1e308)


@pytest.mark.parametrize("number", LARGE)
@pytest.mark.parametrize("axis", range(6))
def test_no_such_number_becomes_a_bias(box: RunningSim, axis: int, number: float) -> None:
    values = np.zeros(6)
    values[axis] = number
    device = PLUGIN.create(
        configuration(box, point=(0.1, 0.2, 0.3), measuring_frame_id="tip", page_period=0.0)
    )
    assert isinstance(device, NetFtDevice)
    with pytest.raises(CommandRefused):
        device.inputs["set_bias"].take(Wrench(vector(values[:3]), vector(values[3:]), ""))
    assert not device.bias.any()


@pytest.mark.parametrize("number", LARGE)
@pytest.mark.parametrize(
    "key", ["bias", "point", "rotation", "gravity", "orientation", "mounting", "center"]
)
def test_no_such_number_is_a_setting(key: str, number: float) -> None:
    values: dict[str, Any] = {key: [number] * (6 if key == "bias" else 3)}
    if key == "center":
        values = {"tool": {"mass": 1.0, "center_of_mass": [number] * 3}}
    with pytest.raises(ConfigError):
        load(NetFtConfig, from_values({"measuring_frame_id": "tip", **values}))


@pytest.mark.parametrize("number", LARGE)
@pytest.mark.parametrize("key", ["counts_per_force", "counts_per_torque"])
def test_no_such_number_is_a_scale(key: str, number: float) -> None:
    scale = {"counts_per_force": 1e6, "counts_per_torque": 1e6, key: number}
    with pytest.raises(ConfigError):
        load(NetFtConfig, from_values({"scale": scale}))


@pytest.mark.parametrize("number", LARGE)
@pytest.mark.parametrize("place", range(7))
def test_an_orientation_that_is_none_takes_no_weight_off(
    box: RunningSim, place: int, number: float
) -> None:
    values = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    values[place] = number
    config = configuration(box, tool={"mass": 1.0}, page_period=0.0)
    device = PLUGIN.create(config)
    try:
        device.open(soon())
        pose = Pose(vector(values[:3]), vector(values[3:]), "")
        with suppress(CommandRefused):
            device.inputs["orientation"].take(pose)
        measures_soundly(device)
    finally:
        device.close()
