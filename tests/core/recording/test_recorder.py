"""Values handed over by a thread that must not wait: written by another, counted, and told when lost."""

import logging
import os
import threading

import pytest

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import McapWriter, Raw, Recorder, Recording
from crtk_drivers.recording.recorder import CAPACITY_SIZE, TOTALS
from crtk_drivers.samples import JointState, Number, Pose, Stamp, Text, vector
from crtk_drivers.state import OperatingState, Status
from rigs.waiting import LONG, eventually


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run.mcap"


def texts(path):
    return [m.decoded().value.value for m in Recording(path).messages()]


def test_what_was_taken_is_in_the_file_by_topic_and_stamp(path):
    pose = Pose(vector([1, 2, 3]), vector([0, 0, 0, 1]), "world")
    with Recorder(
        path,
        metadata={"device": {"serial": "7"}},
        attachments={"config.yaml": b"rate: 5"},
        frame_id="base",
    ) as recorder:
        recorder.take("/arm/measured_js", JointState(vector([0.5])), Stamp(77, 1.0))
        recorder.take("/arm/measured_cp", pose, Stamp(78, 1.0))
        recorder.take("/arm/operating_state", Status(OperatingState.PAUSED), Stamp(0, 1.0))
    found = Recording(path)
    assert found.is_complete
    joints, cartesian, state = found.messages()
    assert joints.publish_time == 77
    assert joints.decoded().value.position.tolist() == [0.5]
    assert (joints.decoded().stamp_ns, joints.decoded().frame_id) == (77, "base")
    assert cartesian.decoded().frame_id == "world"
    assert state.decoded().value.state is OperatingState.PAUSED
    assert state.publish_time == state.log_time > 77  # it has no stamp that is valid
    (_, texts_of_device), (name, totals) = found.metadata
    assert texts_of_device == {"serial": "7"}
    assert (name, totals["taken"], totals["written"], totals["lost"]) == (TOTALS, "3", "3", "0")
    assert found.attachments[0].data == b"rate: 5"


def test_what_waits_is_in_the_file_while_it_is_open(path):
    with Recorder(path, period=0.001) as recorder:
        recorder.take("/a", Text("one"), Stamp(1, 1.0))
        eventually(lambda: recorder.totals.written == 1)
        eventually(lambda: texts(path) == ["one"])  # counted before it is flushed
        assert not Recording(path).is_complete


def test_what_is_measured_meanwhile_takes_no_room_of_messages(path):
    recorder = Recorder(path, capacity=1)
    recorder.take("/a", Text("one"), Stamp(1, 1.0))
    recorder.hold("a", "clock", {"at": "0"})
    recorder.hold("a", "clock", {"at": "1"})
    totals = recorder.close()
    assert (totals.written, totals.lost) == (1, 0)
    clocks, newest, (last, _) = Recording(path).metadata
    assert (clocks, newest) == (("clock", {"at": "0"}), ("clock", {"at": "1"}))
    assert last == TOTALS


def test_what_finds_the_queue_full_is_dropped_and_counted(path):
    recorder = Recorder(path, capacity=10)
    for number in range(25):
        recorder.take("/a", Text(str(number)), Stamp(1, 1.0))
    totals = recorder.close()
    assert texts(path) == [str(number) for number in range(10)]
    assert (totals.taken, totals.written, totals.lost) == (25, 10, 15)
    assert dict(Recording(path).metadata)[TOTALS]["lost"] == "15"


def test_what_waits_has_a_largest_size(path):
    data, topic = bytes(1000), "/cloud"
    raw = Raw(topic, "sensor_msgs/msg/PointCloud2", data, 1, 1, definition="uint8[] data\n")
    recorder = Recorder(path)
    for size in (CAPACITY_SIZE - 1000, 1001, 1000):
        recorder.put((lambda *_: (raw,), topic, 1), 1, size)
    recorder.start()
    eventually(lambda: recorder.totals.written == 2)
    recorder.put((lambda *_: (raw,), topic, 1), 1, CAPACITY_SIZE)
    totals = recorder.close()
    assert (totals.written, totals.lost) == (3, 1)


def test_nothing_is_lost_between_threads(path):
    with Recorder(path, period=0.001) as recorder:

        def produce(topic):
            for number in range(500):
                recorder.take(topic, Text(str(number)), Stamp(1, 1.0))

        threads = [threading.Thread(target=produce, args=(f"/t{i}",)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    found = Recording(path)
    for topic in found.topics:
        values = [m.decoded().value.value for m in found.messages(topic)]
        assert values == list(map(str, range(500)))
    assert recorder.totals.written == recorder.totals.taken == 2000


def test_what_no_message_can_hold_is_counted_told_once_and_harms_nothing(path, caplog):
    with Recorder(path) as recorder:
        for _ in range(3):
            recorder.take("/n", Number(1.0), Stamp(1, 1.0))
        recorder.take("/a", Text("a"), Stamp(1, 1.0))
        recorder.take("/a", JointState(), Stamp(1, 1.0))
        recorder.take("/bad", Text(None), Stamp(1, 1.0))
        recorder.take("/a", Text("b"), Stamp(1, 1.0))
    assert texts(path) == ["a", "b"]
    totals = recorder.totals
    assert (totals.taken, totals.written, totals.lost, totals.unsuited) == (7, 2, 0, 5)
    told = [r.getMessage() for r in caplog.records]
    assert len(told) == 3
    assert "/n is left out: a Number cannot be recorded" in told[0]
    assert "/a is left out: it is a sensor_msgs/msg/JointState, not" in told[1]


class Disk:
    """Between a recorder and `os.pwrite`: a disk that is full, or hangs, for as long as one says."""

    def __init__(self, monkeypatch):
        self.is_full = False
        self.hangs = threading.Event()
        self.goes_on = threading.Event()
        real = os.pwrite

        def pwrite(*args):
            if self.hangs.is_set():
                self.goes_on.wait(LONG)
            if self.is_full:
                raise OSError(28, "No space left on device")
            return real(*args)

        monkeypatch.setattr(os, "pwrite", pwrite)


@pytest.fixture
def disk(monkeypatch):
    made = Disk(monkeypatch)
    yield made
    made.goes_on.set()


def test_a_full_disk_is_told_once_and_recording_goes_on(path, disk, caplog):
    caplog.set_level(logging.WARNING)
    with Recorder(path, period=0.001) as recorder:
        recorder.take("/a", Text("before"), Stamp(1, 1.0))
        eventually(lambda: texts(path) == ["before"])  # counted before it is flushed
        disk.is_full = True
        for number in range(5):
            recorder.take("/a", Text(str(number)), Stamp(1, 1.0))
            recorder.take("/new", Text(str(number)), Stamp(1, 1.0))
        eventually(lambda: recorder.totals.lost == 10)
        disk.is_full = False
        recorder.take("/a", Text("after"), Stamp(1, 1.0))
        eventually(lambda: recorder.totals.written == 2)
    assert texts(path) == ["before", "after"]
    totals = recorder.totals
    assert (totals.taken, totals.written, totals.lost) == (12, 2, 10)
    assert "No space left" in totals.error
    first, second = caplog.records
    assert "No space left on device" in first.getMessage()
    assert second.getMessage() == "recording goes on; 10 messages are lost"


def test_the_room_that_is_kept_free_is_left(path, caplog):
    recorder = Recorder(path, keep_free=1 << 60)
    recorder.take("/a", Text("a"), Stamp(1, 1.0))
    totals = recorder.close()
    assert (totals.written, totals.lost) == (0, 1)
    assert "1 messages are lost: its disk has" in totals.error
    assert "are kept free" in caplog.text
    assert texts(path) == []
    assert Recording(path).is_complete


def test_a_disk_that_stays_full_is_told_by_close_and_the_file_can_be_read(path, disk):
    recorder = Recorder(path)
    recorder.take("/a", Text("a"), Stamp(1, 1.0))
    disk.is_full = True
    with pytest.raises(RecordingError, match=r"run.mcap: is not complete: .*No space left"):
        recorder.close()
    assert (recorder.totals.written, recorder.totals.lost) == (0, 1)
    assert texts(path) == []


def test_a_disk_that_hangs_keeps_nobody_waiting(path, disk):
    recorder = Recorder(path, capacity=5)
    disk.hangs.set()
    recorder.start()
    recorder.take("/a", Text("a"), Stamp(1, 1.0))
    eventually(lambda: disk.hangs.is_set() and recorder.totals.taken == 1)
    for number in range(1000):  # would block, if it could
        recorder.take("/a", Text(str(number)), Stamp(1, 1.0))
    with pytest.raises(RecordingError, match=r"has not taken what was recorded for 0.01 s"):
        recorder.close(timeout=0.01)
    disk.goes_on.set()
    totals = recorder.close()
    assert (totals.taken, totals.written, totals.lost) == (1001, 6, 995)


def test_a_mistake_within_ends_no_thread(path, monkeypatch, caplog):
    recorder = Recorder(path, period=0.001)
    flush = McapWriter.flush
    broken = threading.Event()

    def mistaken(self):
        if not broken.is_set():
            broken.set()
            raise KeyError("a mistake")
        flush(self)

    monkeypatch.setattr(McapWriter, "flush", mistaken)
    recorder.start()
    broken.wait(LONG)
    recorder.take("/a", Text("a"), Stamp(1, 1.0))
    recorder.close()
    assert texts(path) == ["a"]
    assert "unexpected KeyError: 'a mistake'" in caplog.records[0].getMessage()


def test_what_fails_before_a_write_keeps_nothing_out_of_the_file(path):
    def look():
        raise ZeroDivisionError("of a reading")

    recorder = Recorder(path, before_write=look)
    recorder.take("/a", Text("a"), Stamp(1, 1.0))
    totals = recorder.close()
    assert texts(path) == ["a"]
    assert (totals.taken, totals.written, totals.lost) == (1, 1, 0)
    assert "of a reading" in totals.error


def test_a_stamp_before_the_epoch_costs_no_message(path):
    recorder = Recorder(path)
    recorder.take("/a", Text("a"), Stamp(-5, 1.0))
    recorder.take("/a", Text("b"), Stamp(7, 1.0))
    totals = recorder.close()
    early, late = Recording(path).messages()
    assert (early.decoded().stamp_ns, early.publish_time) == (-5, early.log_time)
    assert late.publish_time == 7
    assert (totals.written, totals.error) == (2, "")


def test_a_file_that_cannot_be_made_is_told_at_once(tmp_path, disk):
    (tmp_path / "there").write_text("")
    with pytest.raises(RecordingError, match="is there already"):
        Recorder(tmp_path / "there")
    disk.is_full = True
    with pytest.raises(RecordingError, match="No space left"):
        Recorder(tmp_path / "run.mcap")
