"""Replay of recorded loads: CSV, the driver's recordings, captures of RDT traffic; whole and damaged."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft.blocks import MEASUREMENT
from crtk_driver_ati_netft.recording import encode_block, encode_header
from crtk_sim_backends.kit.loads import LoadError, parse_load
from crtk_sim_backends.netft import replay
from crtk_sim_backends.netft.pcap import Capture, CaptureError
from crtk_sim_backends.netft.replay import Replay

EPOCH = 1763709179
AXES = ("fx", "fy", "fz", "tx", "ty", "tz")


def loads(count: int) -> np.ndarray:
    """A load (count, 6) with no value twice."""
    return np.arange(1, count + 1)[:, None] + np.arange(6) / 10.0


def table(times: Sequence[float], values: np.ndarray, separator: str = ",") -> str:
    rows = (separator.join(map(repr, (t, *v))) for t, v in zip(times, values.tolist(), strict=True))
    return "\n".join(rows) + "\n"


@pytest.fixture
def file(tmp_path) -> Callable[[str | bytes], str]:
    def write(content: str | bytes) -> str:
        path = tmp_path / "load"
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return str(path)

    return write


# ---------------------------------------------------------------------------------------------- at what time


def test_it_goes_at_the_recorded_pace_straight_from_value_to_value_and_begins_anew(file) -> None:
    load = Replay(file(table([5.0, 5.5, 6.0, 6.5], loads(4))))
    assert load.duration == pytest.approx(2.0)
    found = load.wrench(np.array([0.0, 0.25, 0.5, 1.5, 1.9, 2.0, 2.25, 4.5]))
    assert found[:, 0] == pytest.approx([1.0, 1.5, 2.0, 4.0, 4.0, 1.0, 1.5, 2.0])
    assert found[:, 5] == pytest.approx(found[:, 0] + 0.5)


def test_it_can_be_scaled_and_hold_its_end(file) -> None:
    text = file(table([0.0, 0.5, 1.0], loads(3)))
    load = parse_load(f"replay:file={text},speed=2,loop=no")
    assert load.wrench(np.array([0.125, 0.25, 0.5, 100.0]))[:, 0] == pytest.approx([1.5, 2, 3, 3])


def test_one_measurement_is_constant(file) -> None:
    load = Replay(file("0,1,2,3,4,5,6"))
    assert load.wrench(np.array([0.0, 7.0])).tolist() == [[1, 2, 3, 4, 5, 6]] * 2


# -------------------------------------------------------------------------------------------------------- CSV


@pytest.mark.parametrize(
    "content",
    [
        table([0, 1, 2], loads(3)),
        "# of Monday\n\n" + table([0, 1, 2], loads(3), "; ") + "\n",
        "time,fx,fy,fz,tx,ty,tz\n" + table([10, 11, 12], loads(3)),
        '\ufeff"T (s)";"Fx [N]";Fy;Fz;"Mx [Nm]";My;Mz\r\n' + table([0, 1, 2], loads(3), ";"),
        "t fx fy fz tx ty tz\n" + table([0, 1, 2], loads(3), " "),
        table([0, 1, 2], loads(3), "\t").rstrip(),
    ],
)
def test_tables_of_numbers_are_read_as_people_write_them(file, content) -> None:
    load = Replay(file(content), loop=False)
    assert load.wrench(np.array([0.0, 1.0, 2.0])) == pytest.approx(loads(3))


def test_columns_are_taken_by_their_names(file) -> None:
    load = Replay(file("note,tz,ty,tx,fz,fy,fx,time\nx,6,5,4,3,2,1,0\n"))
    assert load.wrench(np.array([0.0])).tolist() == [[1, 2, 3, 4, 5, 6]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "holds no measurements"),
        ("# nothing\n\n", "holds no measurements"),
        ("time,fx,fy,fz,tx,ty,tz\n", "holds no measurements"),
        ("0,1,2,3,4,5,6\n1,2,3\n", "line 2: 3 columns, where 7 are needed"),
        ("0,1,2,3,4,5,6\n1,2,3,x,5,6,7\n", "line 2: 'x' is no number"),
        ("0,1,2,3,4,5,6\n1,2,3,,5,6,7\n", "line 2: '' is no number"),
        ("0,1,2,3,4,5,nan\n", "line 1: 'nan' is not finite"),
        ("0,1,2,3,4,5,1e999\n", "line 1: '1e999' is not finite"),
        ("2,1,2,3,4,5,6\n\n1,1,2,3,4,5,6\n", "line 3: time goes back from 2.0 to 1.0"),
        ("time,fx,fy,fz,tx,ty\n0,1,2,3,4,5\n", "line 1: no column raw_tz or tz or mz among time"),
        ("fx,fy,fz,tx,ty,tz\n1,2,3,4,5,6\n", "line 1: no column time"),
        ("0,1,2,3,4,5," + "6" * 70_000 + "\n", "line 1: 70013 bytes long"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_with_file_and_line(file, content, message) -> None:
    path = file(content)
    with pytest.raises(LoadError) as caught:
        Replay(path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_a_last_line_that_was_cut_off_is_left_out(file, caplog) -> None:
    load = Replay(file(table([0, 1], loads(2)) + "2,1,2"), loop=False)
    assert load.wrench(np.array([9.0])) == pytest.approx(loads(2)[1:])
    assert "line 3, the last one, is not whole" in caplog.text


def test_files_that_cannot_be_read_are_told(tmp_path, monkeypatch, file) -> None:
    with pytest.raises(LoadError, match=r"nothing: No such file"):
        Replay(str(tmp_path / "nothing"))
    with pytest.raises(LoadError, match="is no file"):
        Replay("/dev/zero")
    path = file(table(range(10), loads(10)))
    monkeypatch.setattr(replay, "MOST", 9)
    with pytest.raises(LoadError, match="line 10: more than 9 measurements"):
        Replay(path)
    monkeypatch.setattr(replay, "LARGEST_FILE", 100)
    with pytest.raises(LoadError, match="100 can be replayed"):
        Replay(path)


@pytest.mark.parametrize("name", ["speed", "counts_per_force", "counts_per_torque"])
@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_options_that_are_impossible_are_refused(file, name, value) -> None:
    with pytest.raises(LoadError, match=f"replay: {name} must be above 0"):
        parse_load(f"replay:file={file('0,1,2,3,4,5,6')},{name}={value}")


# ------------------------------------------------------------------------------------------- our recordings


def measurements(count: int, rate: float = 1000.0, jitter: float = 0.0) -> np.ndarray:
    made = np.zeros(count, MEASUREMENT)
    numbers = np.arange(count)
    noise = np.random.default_rng(1).uniform(0.0, 2.0 * jitter, count)
    made["stamp"] = EPOCH * 10**9 + np.round((numbers / rate + noise) * 1e9).astype(np.int64)
    made["ticks"] = 2**33 - 5 + 7 * numbers
    made["raw"] = loads(count)
    made["wrench"] = -1.0
    return made


def recording(made: np.ndarray, csv: bool = False) -> bytes:
    return encode_header({"host": "192.168.1.1"}, csv) + encode_block(made, csv)


@pytest.mark.parametrize("csv", [False, True])
def test_a_recording_of_the_driver_is_replayed_as_the_sensor_measured_it(file, csv) -> None:
    load = Replay(file(recording(measurements(50), csv)), loop=False)
    assert load.duration == pytest.approx(0.05, rel=1e-4)
    assert load.wrench(np.arange(50) / 1000.0) == pytest.approx(loads(50), abs=0.01)


def test_its_pace_is_that_of_the_sensors_counter_and_not_of_jittering_stamps(file) -> None:
    load = Replay(file(recording(measurements(2000, jitter=0.0005))), loop=False)
    found = load.wrench(np.arange(2000) / 1000.0)
    assert np.abs(np.diff(found[:-1, 0]) - 1.0).max() < 0.01


def test_pauses_and_restarts_of_the_sensor_keep_their_length(file) -> None:
    first, second = measurements(100), measurements(100)
    second["stamp"] += 10 * 10**9
    second["ticks"] -= 2**33 - 10
    load = Replay(file(recording(np.concatenate((first, second)))), loop=False)
    assert load.duration == pytest.approx(10.1, abs=0.06)
    found = load.wrench(np.array([0.05, 5.0, 10.05, 11.0]))[:, 0]
    assert found == pytest.approx([51.0, 50.5, 51.0, 100.0], abs=0.6)


def test_a_frozen_sensor_is_replayed_as_long_as_it_was_frozen(file) -> None:
    made = measurements(3000)
    made["ticks"][1000:] = made["ticks"][999]
    made["raw"][1000:] = made["raw"][999]
    load = Replay(file(recording(made)), loop=False)
    assert load.wrench(np.array([0.5, 1.5]))[:, 0] == pytest.approx([501.0, 1000.0], abs=0.1)
    assert load.duration == pytest.approx(3.0, abs=0.6)


@given(st.integers(0, 120 * 20))
def test_a_recording_that_was_cut_off_is_replayed_as_far_as_it_goes(tmp_path_factory, kept) -> None:
    path = tmp_path_factory.mktemp("cut") / "load"
    made = measurements(20)
    path.write_bytes(encode_header({}, csv=False) + encode_block(made, csv=False)[:kept])
    if kept < 120:
        with pytest.raises(LoadError, match="holds no measurements"):
            Replay(str(path))
        return
    load = Replay(str(path), loop=False)
    assert load.wrench(np.array([9.0]))[0] == pytest.approx(made["raw"][kept // 120 - 1])


def _header(**changes: Any) -> bytes:
    header = json.loads(encode_header({}, csv=False))
    return json.dumps(header | changes).encode() + b"\n"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "no line of JSON"),
        (b"{\n", "no JSON in the first line"),
        (b"{" + b'"a":[' * 100_000 + b"\n", "no JSON in the first line"),
        (b"{}\n", "JSON, but no recording"),
        (_header(format="other"), "JSON, but no recording"),
        (_header(fields=[]), "fields"),
        (_header(fields=3), "fields"),
        (
            _header(fields=[["raw", "|O", [6]], ["stamp", "<i8", []], ["ticks", "<i8", []]]),
            "fields",
        ),
        (_header(fields=[["raw", "<f8", [10**9]], ["stamp", "<i8", []]]), "fields"),
        (
            _header(fields=[["raw", "<f8", [6]], ["stamp", "<f8", []], ["ticks", "<i8", []]]),
            "fields",
        ),
        (_header(fields=[["raw", "<f8", [6]], ["raw", "<f8", [6]]]), "fields"),
    ],
)
def test_a_recording_with_a_wrong_header_is_refused(file, content, message) -> None:
    with pytest.raises(LoadError, match=f"offset 0: {message}"):
        Replay(file(content))


def test_a_recording_with_a_load_that_is_no_number_is_refused(file) -> None:
    made = measurements(3)
    made["raw"][1, 2] = np.nan
    start = len(encode_header({"host": "192.168.1.1"}, csv=False))
    with pytest.raises(LoadError, match=f"offset {start + 120}: a load that is not finite"):
        Replay(file(recording(made)))


# ------------------------------------------------------------------------------------------------- captures


def records(count: int, first: int = 1, rdt: int = 1, step: int = 7) -> list[bytes]:
    """RDT records: counter of measurements from `first` on, loads in micronewtons."""
    values = np.round(loads(count) * 1e6).astype(int).tolist()
    return [
        struct.pack(">III6i", rdt + i, (first + i * step) % 2**32, 0, *row)
        for i, row in enumerate(values)
    ]


def ipv4(payload: bytes, port: int = 49152, source: str = "192.168.1.1", **more: int) -> bytes:
    """A datagram from a sensor; `fragment` and `protocol` can be others."""
    udp = struct.pack(">HHHH", port, 40000, 8 + len(payload), 0) + payload
    options = bytes(more.get("options", 0))
    addresses = bytes(map(int, source.split("."))) + b"\xc0\xa8\x01\x02"
    first = 0x45 + len(options) // 4
    length = 20 + len(options) + len(udp)
    head = (first, 0, length, 1, more.get("fragment", 0x4000), 64, more.get("protocol", 17), 0)
    return struct.pack(">BBHHHBBH", *head) + addresses + options + udp


LINKS: dict[str, tuple[int, Callable[[bytes], bytes]]] = {
    "ethernet": (1, lambda ip: bytes(12) + b"\x08\x00" + ip),
    "vlan": (1, lambda ip: bytes(12) + b"\x81\x00\x00\x05\x08\x00" + ip),
    "two vlans": (1, lambda ip: bytes(12) + b"\x88\xa8\0\x02\x81\0\0\x05\x08\x00" + ip + b"pad"),
    "cooked": (113, lambda ip: bytes(14) + b"\x08\x00" + ip),
    "cooked 2": (276, lambda ip: b"\x08\x00" + bytes(18) + ip),
    "loopback, little-endian": (0, lambda ip: b"\x02\0\0\0" + ip),
    "loopback, big-endian": (108, lambda ip: b"\0\0\0\x02" + ip),
    "raw": (101, lambda ip: ip),
}

Packets = Sequence[tuple[float, bytes]]


def pcap(packets: Packets, link: int = 1, order: str = "<", nano: bool = False) -> bytes:
    content = struct.pack(
        f"{order}IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link
    )
    for time, data in packets:
        part = round((time % 1) * (1e9 if nano else 1e6))
        content += struct.pack(f"{order}IIII", EPOCH + int(time), part, len(data), len(data)) + data
    return content


def block(kind: int, body: bytes, order: str) -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack(f"{order}I", 12 + len(body))
    return struct.pack(f"{order}I", kind) + size + body + size


def pcapng(packets: Packets, link: int = 1, order: str = "<", nano: bool = False) -> bytes:
    section = block(0x0A0D0D0A, struct.pack(f"{order}IHHq", 0x1A2B3C4D, 1, 0, -1), order)
    options = struct.pack(f"{order}HHB3x", 9, 1, 9) + struct.pack(f"{order}HH", 0, 0)
    interface = struct.pack(f"{order}HHI", link, 0, 0) + (options if nano else b"")
    content = section + block(5, bytes(16), order) + block(1, interface, order)
    for time, data in packets:
        ticks = round((EPOCH + time) * (1e9 if nano else 1e6))
        head = struct.pack(
            f"{order}IIIII", 0, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data)
        )
        content += block(6, head + data, order)
    return content


def packets_of(
    made: Sequence[bytes],
    rate: float = 1000.0,
    wrap: Callable[[bytes], bytes] = LINKS["ethernet"][1],
) -> list[tuple[float, bytes]]:
    return [(i / rate, wrap(ipv4(data))) for i, data in enumerate(made)]


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("nano", [False, True])
@pytest.mark.parametrize("write", [pcap, pcapng])
def test_captured_traffic_is_replayed(file, link, order, nano, write) -> None:
    number, wrap = LINKS[link]
    load = Replay(file(write(packets_of(records(30), wrap=wrap), number, order, nano)), loop=False)
    assert load.duration == pytest.approx(0.030, rel=1e-3)
    assert load.wrench(np.arange(30) / 1000.0) == pytest.approx(loads(30), abs=0.01)


def test_only_the_sensors_records_count(file) -> None:
    wrap = LINKS["ethernet"][1]
    made = records(4)
    others = [
        ipv4(made[0], port=40000),
        ipv4(made[0] + b"x"),
        ipv4(b""),
        ipv4(made[0], fragment=0x2000),
        ipv4(made[0], fragment=0x0004),
        ipv4(made[0], protocol=6),
        ipv4(made[0])[:30],
        b"\x60" + ipv4(made[0])[1:],
        b"",
    ]
    packets = [(0.0, wrap(ip)) for ip in others] + [(0.0, bytes(12) + b"\x86\xdd" + bytes(60))]
    packets += [(1.0 + i / 1000.0, wrap(ipv4(data, options=8))) for i, data in enumerate(made)]
    load = Replay(file(pcap(packets)), loop=False)
    assert load.wrench(np.arange(4) / 1000.0) == pytest.approx(loads(4), abs=0.01)


def test_several_records_in_a_datagram_are_spread_over_the_time_between(file) -> None:
    made = records(400)
    together = [b"".join(made[i : i + 40]) for i in range(0, 400, 40)]
    load = Replay(file(pcap(packets_of(together, rate=25.0))), loop=False)
    found = load.wrench(np.arange(360) / 1000.0)[:, 0]
    assert np.diff(found) == pytest.approx(np.full(359, 1.0), abs=0.2)


def test_counts_are_scaled_as_told(file) -> None:
    path = file(pcap(packets_of(records(2))))
    load = parse_load(f"replay:file={path},counts_per_force=2000000,counts_per_torque=1e3")
    assert load.wrench(np.zeros(1))[0] == pytest.approx([0.5, 0.55, 0.6, 1300, 1400, 1500])


def test_two_sensors_in_one_capture_must_be_told_apart(file) -> None:
    wrap = LINKS["ethernet"][1]
    one, other = records(3), records(9)[6:]
    packets = []
    for i in range(3):
        packets += [(i / 10, wrap(ipv4(one[i]))), (i / 10, wrap(ipv4(other[i], source="10.0.0.2")))]
    path = file(pcap(packets))
    with pytest.raises(LoadError, match=r"192\.168\.1\.1 and 10\.0\.0\.2 both send; give source="):
        Replay(path)
    load = parse_load(f"replay:file={path},source=10.0.0.2")
    assert load.wrench(np.zeros(1))[0, 0] == pytest.approx(7.0)
    with pytest.raises(LoadError, match=r"no RDT records from port 49152 of 10\.0\.0\.3"):
        Replay(path, source="10.0.0.3")
    with pytest.raises(LoadError, match="no RDT records from port 5000"):
        Replay(path, port=5000)


def test_late_and_repeated_records_and_a_counter_that_wraps(file) -> None:
    made = records(100, first=2**32 - 200)
    made[10], made[11] = made[11], made[10]
    made[50] = made[49]
    load = Replay(file(pcap(packets_of(made))), loop=False)
    found = load.wrench(np.array([0.009, 0.011, 0.049, 0.099]))[:, 0]
    assert found == pytest.approx([10.0, 12.0, 50.0, 100.0], abs=0.05)


@given(share=st.floats(0.0, 1.0), ng=st.booleans())
def test_a_capture_that_was_cut_off_is_replayed_as_far_as_it_goes(
    tmp_path_factory, share, ng
) -> None:
    write = pcapng if ng else pcap
    path = tmp_path_factory.mktemp("cut") / "load"
    sizes = [len(write(packets_of(records(count)))) for count in range(21)]
    kept = round(share * sizes[-1])
    path.write_bytes(write(packets_of(records(20)))[:kept])
    whole = sum(size <= kept for size in sizes) - 1
    if whole < 1:
        with pytest.raises(LoadError):
            Replay(str(path))
        return
    load = Replay(str(path), loop=False)
    assert load.wrench(np.array([9.0]))[0] == pytest.approx(loads(20)[whole - 1])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (pcap([], link=147), "no RDT records"),
        (pcap([(0.0, bytes(60))], link=147), "offset 24: link type 147 is not known"),
        (
            pcap([]) + struct.pack("<IIII", 0, 0, 2**31, 5),
            "offset 24: a packet of 2147483648 bytes",
        ),
        (pcap([])[:20], "offset 0: no header of a pcap"),
        (pcapng([])[:8] + b"nope" + bytes(20), "offset 0: a section without a byte order"),
        (pcapng([]) + struct.pack("<II", 6, 4) + bytes(20), "offset 76: a block of 4 bytes"),
        (
            pcapng([]) + struct.pack("<II4xI", 6, 16, 20),
            "offset 76: a block of 16 bytes ends as one of 20",
        ),
        (pcapng([]) + block(6, bytes(4), "<"), "offset 76: a packet of 4 bytes"),
        (
            pcapng([]) + block(6, struct.pack("<5I", 3, 0, 0, 0, 0), "<"),
            "offset 76: a packet of interface 3",
        ),
        (
            pcapng([]) + block(6, struct.pack("<5I", 0, 0, 0, 9, 9), "<"),
            "offset 76: 9 bytes of a packet in 0",
        ),
        (pcapng([]) + block(1, b"", "<"), "offset 76: an interface of 0 bytes"),
    ],
)
def test_what_is_wrong_with_a_capture_is_told_with_its_offset(file, content, message) -> None:
    path = file(content)
    with pytest.raises(LoadError) as caught:
        Replay(path)
    assert str(caught.value).startswith(f"{path}: {message}")


# ------------------------------------------------------------------------------------------------- anything

SAMPLES = {
    "csv": ("time,fx,fy,fz,tx,ty,tz\n" + table([0, 1, 2], loads(3))).encode(),
    "recording": recording(measurements(5)),
    "text recording": recording(measurements(5), csv=True),
    "pcap": pcap(packets_of(records(5))),
    "pcapng": pcapng(packets_of(records(5)), nano=True),
}


@given(data=st.data())
@pytest.mark.parametrize("kind", SAMPLES)
def test_a_damaged_file_is_replayed_or_refused_and_nothing_else(
    tmp_path_factory, kind, data
) -> None:
    content = bytearray(SAMPLES[kind])
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path_factory.mktemp("damaged") / "load"
    path.write_bytes(bytes(content))
    try:
        load = Replay(str(path))
    except LoadError:
        return
    assert np.isfinite(load.wrench(np.linspace(0.0, 10.0, 50))).all()


@given(st.binary(max_size=400), st.sampled_from(["", "pcap", "pcapng"]))
def test_any_bytes_are_refused_as_a_capture_or_hold_datagrams(content, beginning) -> None:
    whole = {"": b"", "pcap": pcap([]), "pcapng": pcapng([])}[beginning] + content
    try:
        found = list(Capture(whole))
    except CaptureError:
        return
    assert all(0 <= datagram.offset < len(whole) for datagram in found)


def test_the_files_are_read_without_the_driver() -> None:
    text = Path(replay.__file__).read_text()
    assert "crtk_driver" not in text.replace('"crtk-netft-recording"', "")
