"""Recordings: written, read, cut off anywhere, damaged anywhere, mended; and read by MCAP's own library."""

import errno
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import McapWriter, Recording, cdr, mend
from crtk_drivers.recording.mcap_format import MAGIC
from crtk_drivers.samples import JointState, Pose, Text, vector
from rigs.examples import examples
from rigs.full_disk import largest_file

JOINTS = cdr.TYPE_NAMES[JointState]
POSE = cdr.TYPE_NAMES[Pose]
TEXT = cdr.TYPE_NAMES[Text]
SECOND = 1_000_000_000


def text(words, stamp_ns=0):
    return cdr.encode(Text(words), stamp_ns)


def write_bench(path):
    """Write three chunks of two topics, the second one new in the second chunk; return the messages."""
    writer = McapWriter(path)
    written = []

    def add(channel, topic, type_name, data, time):
        writer.message(channel, data, time, time - 5)
        written.append((topic, type_name, time, time - 5, data))

    writer.metadata("device", {"serial": "12", "host": "10.0.0.1"})
    arm = writer.channel("/arm/measured_js", JOINTS)
    for time in range(1000, 1005):
        value = JointState(vector([time, 2.0]), name=("a", "b"))
        add(arm, "/arm/measured_js", JOINTS, cdr.encode(value, time, "base"), time)
    writer.flush()
    words = writer.channel("/arm/error", TEXT)
    add(words, "/arm/error", TEXT, text("über", 1010), 1010)
    add(arm, "/arm/measured_js", JOINTS, cdr.encode(JointState(), 0), 1009)
    writer.flush()
    writer.attachment("config.yaml", b"rate: 100\n", "text/yaml")
    add(words, "/arm/error", TEXT, text("", 1020), 1020)
    writer.finish()
    return written


def contents(recording):
    return [
        (m.topic, m.type_name, m.log_time, m.publish_time, m.data) for m in recording.messages()
    ]


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    path = tmp_path_factory.mktemp("bench") / "bench.mcap"
    return path, path.with_name("again.mcap"), write_bench(path), path.read_bytes()


def test_what_was_written_is_read(bench):
    path, _, written, _ = bench
    found = Recording(path)
    assert found.is_complete
    assert contents(found) == written
    assert found.topics == {"/arm/measured_js": JOINTS, "/arm/error": TEXT}
    assert found.counts == {"/arm/measured_js": 6, "/arm/error": 2}
    assert found.metadata == [("device", {"serial": "12", "host": "10.0.0.1"})]
    (attached,) = found.attachments
    assert (attached.name, attached.media_type) == ("config.yaml", "text/yaml")
    assert attached.data == b"rate: 100\n"
    assert [m.decoded().value.value for m in found.messages("/arm/error")] == ["über", ""]
    assert [m.sequence for m in found.messages("/arm/measured_js")] == list(range(6))


def test_a_topic_that_is_not_there_is_told(bench):
    with pytest.raises(RecordingError, match=r"has no /leg. It has: /arm/measured_js, /arm/error"):
        list(Recording(bench[0]).messages("/leg"))


def read_by_mcap(path):
    """Return the messages as MCAP's own library reads them, by the index and one after the other."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [
            (channel.topic, schema.name, m.log_time, m.publish_time, m.data)
            for schema, channel, m in reader.iter_messages(log_time_order=False)
        ]
        summary = reader.get_summary()
        assert summary.statistics.message_count == len(found)
        assert [a.data for a in reader.iter_attachments()] == [b"rate: 100\n"]
        assert [m.name for m in reader.iter_metadata()] == ["device"]
        assert reader.get_header().profile == "ros2"
    with path.open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    kinds = [type(record).__name__ for record in records]
    assert kinds.count("Message") == len(found)
    assert kinds.count("ChunkIndex") == len(summary.chunk_indexes)
    return found


def test_the_library_of_mcap_reads_it(bench):
    path, _, written, _ = bench
    assert read_by_mcap(path) == written


def test_the_index_of_messages_leads_to_each(bench):
    path, _, _, data = bench
    with path.open("rb") as file:
        chunks = make_reader(file).get_summary().chunk_indexes
    count = 0
    for chunk in chunks:
        for channel, at in chunk.message_index_offsets.items():
            size = int.from_bytes(data[at + 11 : at + 15], "little")
            for entry in range(at + 15, at + 15 + size, 16):
                time = int.from_bytes(data[entry : entry + 8], "little")
                offset = int.from_bytes(data[entry + 8 : entry + 16], "little")
                message = chunk.chunk_start_offset + 9 + 28 + 4 + 8 + offset
                assert data[message] == 0x05
                assert data[message + 9 : message + 11] == channel.to_bytes(2, "little")
                assert data[message + 15 : message + 23] == time.to_bytes(8, "little")
                count += 1
        assert chunk.message_start_time <= chunk.message_end_time
    assert count == 8


@pytest.mark.sweep(4)
@pytest.mark.parametrize("part", range(4))
def test_cut_off_at_any_byte_all_whole_chunks_are_read_and_mended(bench, tmp_path, part):
    _, path, written, data = bench
    seen = set()
    begin = data.index(b"\x0c")  # the first metadata: before, there is nothing to be read
    for size in range(part, begin, 4):
        path.write_bytes(data[:size])
        with pytest.raises(RecordingError, match=r"is no MCAP file|before anything was recorded"):
            Recording(path)
    for size in range(begin + part, len(data), 4):
        path.write_bytes(data[:size])
        found = Recording(path)
        messages = contents(found)
        assert not found.is_complete
        assert messages == written[: len(messages)]
        if len(messages) in seen and size % 11:
            continue
        seen.add(len(messages))
        assert mend(path)
        assert not mend(path)
        mended = Recording(path)
        assert mended.is_complete
        assert contents(mended) == messages
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert len(list(reader.iter_messages())) == len(messages)
            assert reader.get_summary().statistics.message_count == len(messages)
    assert seen == {0, 5, 7, 8}


def first_chunk(path):
    with path.open("rb") as file:
        return make_reader(file).get_summary().chunk_indexes[0]


def test_a_chunk_without_its_indexes_is_kept_and_gets_them(bench):
    whole, path, written, data = bench
    chunk = first_chunk(whole)
    path.write_bytes(data[: chunk.chunk_start_offset + chunk.chunk_length + 3])
    assert contents(Recording(path)) == written[:5]
    mend(path)
    assert first_chunk(path) == chunk
    assert contents(Recording(path)) == written[:5]


@settings(max_examples=examples(400))
@given(st.data())
def test_a_damaged_byte_is_an_error_or_does_no_harm(bench, data):
    _, path, written, whole = bench
    at = data.draw(st.integers(0, len(whole) - 1))
    other = data.draw(st.integers(1, 255))
    path.write_bytes(whole[:at] + bytes((whole[at] ^ other,)) + whole[at + 1 :])
    try:
        found = Recording(path)
        messages = contents(found)
    except RecordingError:
        return
    assert messages == written  # it was behind the data: in the summary
    assert not found.is_complete
    mend(path)
    assert path.read_bytes() == whole


@settings(max_examples=examples(300))
@given(st.data())
def test_damaged_and_cut_off_nothing_wrong_is_taken_for_right(bench, data):
    _, path, written, whole = bench
    size = data.draw(st.integers(len(whole) // 2, len(whole)))
    damaged = bytearray(whole[:size])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, size - 1))
        damaged[at : at + 4] = data.draw(st.binary(min_size=1, max_size=8))
    path.write_bytes(damaged)
    try:
        found = Recording(path)
        messages = contents(found)
    except RecordingError:
        return
    assert messages == written[: len(messages)]


@given(st.binary(max_size=300))
def test_any_bytes_are_no_recording(bench, junk):
    path = bench[1]
    for data in (junk, MAGIC + junk):
        path.write_bytes(data)
        with pytest.raises(RecordingError):
            Recording(path)
        with pytest.raises(RecordingError):
            mend(path)
        assert path.read_bytes() == data


def test_zeros_behind_a_record_are_space_that_was_never_written(bench):
    whole, path, written, data = bench
    chunk = first_chunk(whole)
    end = chunk.chunk_start_offset + chunk.chunk_length + chunk.message_index_length + 13
    for zeros in (1, 8, 9, 5000):
        path.write_bytes(data[:end] + bytes(zeros))
        assert contents(Recording(path)) == written[:5]
        assert mend(path)
        assert contents(Recording(path)) == written[:5]
    path.write_bytes(data[: chunk.chunk_start_offset + 60] + bytes(5000))
    with pytest.raises(RecordingError, match=r"again.mcap: is damaged at byte \d+: the checksum"):
        Recording(path)


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_text("mine")
    with pytest.raises(RecordingError, match=r"run.mcap: is there already"):
        McapWriter(path)
    assert path.read_text() == "mine"


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(RecordingError, match="cannot be made: No such file"):
        McapWriter(tmp_path / "none" / "run.mcap")
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        Recording(tmp_path / "none.mcap")


def test_one_that_is_being_written_can_be_read_but_not_mended(tmp_path):
    path = tmp_path / "run.mcap"
    with McapWriter(path) as writer:
        channel = writer.channel("/error", TEXT)
        writer.message(channel, text("a"), 1)
        writer.flush()
        assert [m.decoded().value.value for m in Recording(path).messages()] == ["a"]
        with pytest.raises(RecordingError, match="still being written"):
            mend(path)
        writer.message(channel, text("b"), 2)
    assert Recording(path).is_complete
    assert len(list(Recording(path).messages())) == 2


def test_more_than_a_chunk_is_written_without_being_asked(tmp_path):
    path = tmp_path / "run.mcap"
    writer = McapWriter(path)
    channel = writer.channel("/error", TEXT)
    data = text("x" * 100_000)
    for time in range(12):
        writer.message(channel, data, time)
    assert len(list(Recording(path).messages())) == 11
    writer.finish()
    assert len(list(Recording(path).messages())) == 12


def test_a_topic_has_one_type(tmp_path):
    with McapWriter(tmp_path / "run.mcap") as writer:
        assert writer.channel("/a", TEXT) == writer.channel("/a", TEXT)
        with pytest.raises(RecordingError, match="/a has messages of type crtk_msgs/msg/String"):
            writer.channel("/a", POSE)
        with pytest.raises(RecordingError, match="std_msgs/msg/Byte cannot be recorded"):
            writer.channel("/b", "std_msgs/msg/Byte")


def test_a_disk_that_is_full_is_told_and_what_was_written_stays(tmp_path):
    path = tmp_path / "run.mcap"
    writer = McapWriter(path)
    channel = writer.channel("/error", TEXT)
    writer.message(channel, text("before"), 1)
    writer.flush()
    with largest_file(path.stat().st_size + 300):
        for time in range(20):
            writer.message(channel, text("lost" * 10), time)
        with pytest.raises(RecordingError, match="20 messages are lost: cannot be written: File"):
            writer.flush()
    assert writer.lost == 20
    assert [m.decoded().value.value for m in Recording(path).messages()] == ["before"]
    writer.message(channel, text("after"), 2)
    writer.finish()
    found = Recording(path)
    assert found.is_complete
    assert [m.decoded().value.value for m in found.messages()] == ["before", "after"]


def test_without_space_for_its_end_it_can_be_mended_later(tmp_path, monkeypatch):
    path = tmp_path / "run.mcap"
    writer = McapWriter(path)
    writer.message(writer.channel("/error", TEXT), text("a"), 1)
    writer.flush()
    with monkeypatch.context() as patch:

        def full(*_):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        patch.setattr(os, "pwrite", full)
        with pytest.raises(RecordingError, match=r"cannot be completed: No space left .* disk"):
            writer.finish()
    writer.finish()
    with pytest.raises(RecordingError, match="is finished"):
        writer.metadata("a", {})
    assert not Recording(path).is_complete
    mend(path)
    assert [m.decoded().value.value for m in Recording(path).messages()] == ["a"]
