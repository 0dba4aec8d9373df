"""Any file that may be given: ours, cut off or being written; of other programs; damaged; none."""

import os
import struct
import tracemalloc

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import McapWriter, Recording, cdr, opened
from crtk_drivers.recording.foreign import Foreign
from crtk_drivers.recording.mcap_format import MAGIC
from crtk_drivers.recording.order import in_order
from crtk_drivers.samples import Text
from rigs.examples import examples

TEXT = cdr.TYPE_NAMES[Text]


def write_foreign(path, compression=CompressionType.NONE, count=50, chunk_size=400):
    """Write a file as `ros2 bag` does: schemas and channels in the chunks."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, chunk_size=chunk_size)
        writer.start("ros2", "another program")
        schema = writer.register_schema(TEXT, "ros2msg", b"string string")
        kept = {"offered_qos_profiles": "- history: 1\n  depth: 1\n  durability: 1\n"}
        one = writer.register_channel("/a", "cdr", schema)
        two = writer.register_channel("/b", "cdr", schema, metadata=kept)
        for number in range(count):
            channel = two if number % 5 == 0 else one
            data = cdr.encode(Text(str(number)), number)
            writer.add_message(channel, number, data, number, sequence=number)
        writer.add_metadata("about", {"who": "me"})
        writer.add_attachment(0, 0, "notes", "text/plain", b"hello")
        writer.finish()


def words(recording, *topics):
    return [int(m.decoded().value.value) for m in recording.messages(*topics)]


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    path = tmp_path_factory.mktemp("foreign") / "bag.mcap"
    write_foreign(path)
    return path, path.with_name("again.mcap"), path.read_bytes()


@pytest.mark.parametrize("compression", CompressionType)
def test_a_file_of_another_program_is_read(tmp_path, compression):
    path = tmp_path / "bag.mcap"
    write_foreign(path, compression)
    found, told = opened(path)
    assert isinstance(found, Foreign)
    assert told == ""
    assert found.is_complete
    assert found.topics == {"/a": TEXT, "/b": TEXT}
    assert found.counts == {"/a": 40, "/b": 10}
    assert found.latched == {"/b"}
    assert words(found) == list(range(50))
    assert words(found, "/b") == list(range(0, 50, 5))
    assert found.metadata == [("about", {"who": "me"})]
    assert [each.data for each in found.attachments] == [b"hello"]
    with pytest.raises(RecordingError, match=r"has no /c. It has: /a, /b"):
        list(found.messages("/c"))


def test_a_compression_whose_library_is_missing_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "bag.mcap"
    write_foreign(path, CompressionType.ZSTD)

    def none(name):
        raise ImportError(name)

    monkeypatch.setattr("crtk_drivers.recording.foreign.import_module", none)
    with pytest.raises(RecordingError, match=r"is compressed \(zstd\)") as caught:
        opened(path)
    assert caught.value.remedy == "pip install zstandard"


def test_cut_off_anywhere_what_is_before_is_read(foreign):
    _, path, data = foreign
    seen = set()
    for size in range(len(MAGIC), len(data), 41):
        path.write_bytes(data[:size])
        try:
            found, told = opened(path)
        except RecordingError:  # there is no message before
            seen.add(0)
            continue
        numbers = words(found)
        assert numbers == list(range(len(numbers)))
        if not found.is_complete:
            assert "what is before that is shown" in told
        seen.add(len(numbers))
    assert len(seen) > 4
    assert max(seen) == 50


@settings(max_examples=examples(100))
@given(st.data())
def test_damaged_anywhere_it_is_told_or_read(foreign, data):
    _, path, whole = foreign
    damaged = bytearray(whole)
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(whole) - 1))
        junk = data.draw(st.binary(min_size=1, max_size=8))
        damaged[at : at + len(junk)] = junk
    path.write_bytes(damaged)
    try:
        found, _ = opened(path)
        for message in found.messages():
            assert message.topic
    except RecordingError:
        pass


@given(st.binary(max_size=200))
def test_any_bytes_are_refused_in_words(foreign, junk):
    path = foreign[1]
    for data in (junk, MAGIC + junk):
        path.write_bytes(data)
        with pytest.raises(RecordingError):
            opened(path)


def test_what_is_no_file_is_told(tmp_path):
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "words.mcap").write_text("time,x\n1,2\n")
    for name, why in (
        ("none.mcap", "cannot be read: No such file"),
        ("empty.mcap", "is empty"),
        ("words.mcap", "is no MCAP file"),
        (".", "cannot be read: Is a directory"),
    ):
        with pytest.raises(RecordingError, match=why):
            opened(tmp_path / name)


def test_a_chunk_that_says_it_is_huge_is_not_unpacked(tmp_path, foreign):
    path = tmp_path / "bomb.mcap"
    write_foreign(path, CompressionType.ZSTD, chunk_size=100_000)
    data = bytearray(path.read_bytes())
    chunk = data.index(b"\x04\0\0\0zstd") - 12
    data[chunk : chunk + 8] = (1 << 40).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="larger than any is made"):
        opened(path)


def chunk(content, size, compression=""):
    """Return a file of one chunk, by hand: what it holds, the size that it says, and how it is packed."""
    packed = struct.pack("<QQQII", 0, 0, size, 0, len(compression)) + compression.encode()
    packed += struct.pack("<Q", len(content)) + content
    return MAGIC + struct.pack("<BQ", 6, len(packed)) + packed


def test_a_chunk_that_holds_more_than_it_says_is_not_unpacked(tmp_path):
    path = tmp_path / "bomb.mcap"
    held = 64 << 20
    path.write_bytes(chunk(zstandard.compress(bytes(held)), 100, "zstd"))
    tracemalloc.start()
    try:
        with pytest.raises(RecordingError, match="the checksum of a chunk is wrong"):
            opened(path)
        assert tracemalloc.get_traced_memory()[1] < held / 4
    finally:
        tracemalloc.stop()


def test_chunks_in_chunks_are_no_recording(tmp_path):
    path = tmp_path / "deep.mcap"
    data = chunk(b"", 0)
    for _ in range(2000):
        inner = data[len(MAGIC) :]
        data = chunk(inner, len(inner))
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="a chunk is in a chunk"):
        opened(path)


def begun(path):
    writer = McapWriter(path)
    channel = writer.channel("/a", TEXT)
    for number in range(5):
        writer.message(channel, cdr.encode(Text(str(number)), 1), number)
    writer.flush()
    return writer


def test_ours_that_was_cut_off_is_mended_on_the_way(tmp_path):
    path = tmp_path / "run.mcap"
    begun(path).finish()
    path.write_bytes(path.read_bytes()[:-40])
    found, told = opened(path)
    assert told == "it was cut off, and has been mended"
    assert words(found) == [0, 1, 2, 3, 4]
    assert Recording(path).is_complete
    assert opened(path)[1] == ""


def test_ours_that_is_being_written_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "run.mcap"
    writer = begun(path)
    found, told = opened(path)
    assert "being written" in told
    assert words(found) == [0, 1, 2, 3, 4]
    writer.finish()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anything")
def test_ours_that_may_not_be_written_is_read(tmp_path):
    path = tmp_path / "run.mcap"
    begun(path).finish()
    path.write_bytes(path.read_bytes()[:-40])
    path.chmod(0o400)
    found, told = opened(path)
    assert "cannot be mended here" in told
    assert words(found) == [0, 1, 2, 3, 4]


def test_messages_come_in_the_order_of_time(tmp_path):
    path = tmp_path / "run.mcap"
    with McapWriter(path) as writer:
        channel = writer.channel("/a", TEXT)
        for time in (5, 3, 4, 9, 7, 8, 6):
            writer.message(channel, b"", time)
    assert [m.log_time for m in in_order(Recording(path).messages())] == [3, 4, 5, 6, 7, 8, 9]
