"""Recordings: what is written is read again, whatever happens to the file."""

from __future__ import annotations

import io
import json
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_ati_netft import recording
from crtk_driver_ati_netft.blocks import MEASUREMENT, Block, BlockRing
from crtk_driver_ati_netft.recording import (
    RECORD,
    Recorder,
    encode_block,
    encode_header,
    read_recording,
)
from crtk_drivers.errors import ConfigError
from rigs.full_disk import largest_file
from rigs.waiting import LONG, eventually

HEADER = {"host": "192.168.1.1", "sensor": {"serial": "FT\n1"}}


def block(count: int, first: int = 1) -> Block:
    """Measurements with no value twice, the last digits of each included."""
    made = np.zeros(count, MEASUREMENT)
    numbers = first + np.arange(count)
    made["stamp"] = 1763709179123456789 + numbers * 142857
    made["ticks"] = (1 << 40) + numbers
    made["sequence"] = numbers
    made["status"] = 0x80010000
    made["raw"] = numbers[:, None] / 7.0 + np.arange(6)
    made["wrench"] = -made["raw"] / 3.0
    return made


def bits(measurements: Block) -> bytes:
    """All of them, exactly."""
    return measurements.astype(RECORD).tobytes()


@pytest.fixture
def ring() -> BlockRing:
    ring = BlockRing(1000)
    ring.open()
    return ring


@pytest.fixture(params=["ftrec", "csv"])
def path(request, tmp_path) -> Path:
    return tmp_path / f"load.{request.param}"


def test_what_was_measured_is_read_again(ring, path) -> None:
    recorder = Recorder(path, ring.reader(), HEADER)
    recorder.start()
    for first in range(1, 501, 100):
        ring.add(block(100, first))
    recorder.stop()
    found = read_recording(path)
    assert found.header["sensor"] == {"serial": "FT\n1"}
    assert found.cut == 0
    assert bits(found.data) == bits(block(500))
    assert (recorder.written, recorder.missed, recorder.error) == (500, 0, "")
    assert recorder.size == path.stat().st_size


def test_a_binary_file_opens_with_numpy_alone_as_the_documentation_says(ring, tmp_path) -> None:
    path = tmp_path / "load.ftrec"
    recorder = Recorder(path, ring.reader(), HEADER)
    ring.add(block(3))
    recorder.start()
    recorder.stop()
    with path.open("rb") as file:
        header = json.loads(file.readline())
        fields = [(name, kind, tuple(shape)) for name, kind, shape in header["fields"]]
        data = np.fromfile(file, np.dtype(fields))
    assert data.dtype == RECORD
    assert data.dtype.itemsize == 120
    assert bits(data) == bits(block(3))


def test_a_csv_file_has_names_over_its_columns(ring, tmp_path) -> None:
    path = tmp_path / "load.csv"
    recorder = Recorder(path, ring.reader(), HEADER)
    ring.add(block(2))
    recorder.start()
    recorder.stop()
    table = np.genfromtxt(path, delimiter=",", names=True, skip_header=1)
    assert table["raw_tz"] == pytest.approx(block(2)["raw"][:, 5])
    assert table["wrench_fx"] == pytest.approx(block(2)["wrench"][:, 0])


def test_it_goes_on_after_the_device_was_closed_and_opened(ring, path) -> None:
    recorder = Recorder(path, ring.reader(), HEADER)
    recorder.start()
    ring.add(block(10))
    ring.close()
    recorder.stop()
    assert len(read_recording(path).data) == 10
    ring.open()
    recorder.start()
    ring.add(block(10, 11))
    recorder.stop()
    recorder.stop()
    assert bits(read_recording(path).data) == bits(block(20))


def test_on_a_disk_that_holds_it_up_one_writes_after_the_other(ring, path, monkeypatch) -> None:
    begun, goes_on = threading.Event(), threading.Event()

    def slow(*given):
        begun.set()
        goes_on.wait(LONG)
        return encode_block(*given)

    monkeypatch.setattr(recording, "encode_block", slow)
    monkeypatch.setattr(recording, "PATIENCE", 0.01)
    recorder = Recorder(path, ring.reader(), HEADER)
    recorder.start()
    ring.add(block(10))
    assert begun.wait(LONG)
    recorder.stop()
    recorder.start()
    ring.add(block(10, 11))
    goes_on.set()
    name = f"record {path.name}"
    eventually(lambda: [t.name for t in threading.enumerate()].count(name) == 1, "the first ends")
    eventually(lambda: recorder.written == 20, "written")
    recorder.stop()
    assert bits(read_recording(path).data) == bits(block(20))


def test_it_writes_while_it_runs(ring, path) -> None:
    recorder = Recorder(path, ring.reader(), HEADER)
    recorder.start()
    ring.add(block(10))
    eventually(lambda: recorder.written == 10, "written")
    assert len(read_recording(path).data) == 10
    recorder.stop()


def test_what_came_faster_than_it_is_written_is_counted(ring, path) -> None:
    recorder = Recorder(path, ring.reader(), HEADER)
    ring.add(block(1500))
    recorder.start()
    recorder.stop()
    assert (recorder.written, recorder.missed) == (1000, 500)
    assert read_recording(path).data["sequence"][0] == 501


def test_no_space_ends_the_recording_at_a_whole_record_and_nothing_else(ring, path, caplog) -> None:
    recorder = Recorder(path, ring.reader(), HEADER)
    with largest_file(recorder.size + 20_000):
        recorder.start()
        ring.add(block(50))
        eventually(lambda: recorder.written == 50, "written")
        ring.add(block(500, 51))
        eventually(lambda: recorder.error, "an error")
        recorder.stop()
        recorder.start()
        ring.add(block(1))
        recorder.stop()
    assert str(path) in recorder.error
    assert recorder.written == 50
    assert "50 measurements" in caplog.text
    found = read_recording(path)
    assert (len(found.data), found.cut) == (50, 0)


def test_a_file_that_exists_is_never_written_over(ring, path) -> None:
    path.write_text("precious")
    with pytest.raises(ConfigError, match="exists already"):
        Recorder(path, ring.reader(), HEADER)
    assert path.read_text() == "precious"
    with pytest.raises(ConfigError, match="cannot be written"):
        Recorder(path / "below", ring.reader(), HEADER)


@given(csv=st.booleans(), share=st.floats(0.0, 1.0))
def test_a_file_cut_off_anywhere_holds_its_whole_records(tmp_path_factory, csv, share) -> None:
    path = tmp_path_factory.mktemp("cut") / ("load.csv" if csv else "load.ftrec")
    beginning, records = encode_header(HEADER, csv), encode_block(block(20), csv)
    kept = records[: round(share * len(records))]
    path.write_bytes(beginning + kept)
    found = read_recording(path)
    count = len(found.data)
    assert bits(found.data) == bits(block(20)[:count])
    assert len(encode_block(block(20)[:count], csv)) + found.cut == len(kept)
    assert len(encode_block(block(20)[: count + 1], csv)) > len(kept) or count == 20


@given(st.binary(max_size=300))
def test_what_is_no_recording_is_refused(tmp_path_factory, content) -> None:
    path = tmp_path_factory.mktemp("any") / "load.ftrec"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match="is no recording"):
        read_recording(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b'{"format": "crtk-netft-recording", "version": 2}\n', "version 2"),
        (b'{"format": "another"}\n', "its format"),
        (b"[" * 100_000, "no JSON"),
        (encode_header(HEADER, csv=True) + b"1,2,3\n", "damaged"),
        (encode_header(HEADER, csv=True) + b"a," * 15 + b"b\n", "damaged"),
    ],
)
def test_what_is_wrong_with_a_file_is_told(tmp_path, content, message) -> None:
    path = tmp_path / "load"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as caught:
        read_recording(path)
    assert str(path) in str(caught.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_recording(tmp_path / "nothing")


def test_not_a_number_survives_text() -> None:
    made = block(1)
    made["wrench"] = np.nan
    line = encode_block(made, csv=True)
    assert np.isnan(np.loadtxt(io.BytesIO(line), MEASUREMENT, delimiter=",")["wrench"]).all()
