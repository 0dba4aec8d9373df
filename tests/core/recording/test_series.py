"""The files of one recording: split, each whole by itself, and none written over."""

import pytest
from mcap.reader import make_reader

from crtk_drivers.errors import RecordingError
from crtk_drivers.recording import Raw, Recorder, Recording, Series, Split, cdr
from crtk_drivers.samples import Stamp, Text
from rigs.full_disk import largest_file
from rigs.waiting import eventually

TEXT = cdr.TYPE_NAMES[Text]


def raw(words, topic="/a", log_time=1, is_latched=False):
    return Raw(topic, TEXT, cdr.encode(Text(words), 7), log_time, 7, is_latched)


def words(path):
    return [(m.topic, m.decoded().value.value) for m in Recording(path).messages()]


def test_each_file_begins_with_what_holds(tmp_path):
    path = tmp_path / "run.mcap"
    series = Series(path, {"device": {"serial": "7"}}, {"config": b"1"}, Split(size=1500))
    series.message(raw("old", "/goal", is_latched=True))
    series.message(raw("new", "/goal", is_latched=True))
    for number in range(3):
        series.message(raw(f"{number}" * 400))
        series.message(raw("x" * 700))
        series.flush()
    series.finish()
    assert series.paths == [
        path,
        tmp_path / "run_1.mcap",
        tmp_path / "run_2.mcap",
        *series.paths[3:],
    ]
    first, second, third = (words(each) for each in series.paths[:3])
    assert first == [("/goal", "old"), ("/goal", "new"), ("/a", "0" * 400), ("/a", "x" * 700)]
    assert second == [("/goal", "new"), ("/a", "1" * 400), ("/a", "x" * 700)]
    assert third[0] == ("/goal", "new")
    for each in series.paths:
        found = Recording(each)
        assert found.is_complete
        assert found.metadata == [("device", {"serial": "7"})]
        assert [attached.data for attached in found.attachments] == [b"1"]


def test_what_several_publishers_have_latched_holds_until_it_is_told_anew(tmp_path):
    series = Series(tmp_path / "run.mcap", split=Split(size=10))
    for number, about in enumerate(("ab", "c", "b", "cd", "", "ad", "a")):
        series.message(
            raw(str(number), "/tf_static", is_latched=True)._replace(about=frozenset(about))
        )
    series.flush()
    series.finish()
    assert words(series.paths[1]) == [("/tf_static", each) for each in "2356"]


def test_a_latched_topic_says_so_to_players(tmp_path):
    series = Series(tmp_path / "bag.mcap")
    series.message(raw("a", "/goal", is_latched=True))
    series.message(raw("b"))
    series.finish()
    with (tmp_path / "bag.mcap").open("rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    told = {each.topic: each.metadata for each in channels}
    assert "durability: transient_local" in told["/goal"]["offered_qos_profiles"]
    assert told["/a"] == {}


def told(path):
    return [texts["at"] for name, texts in Recording(path).metadata if name == "clock"]


def test_each_file_has_what_was_measured_first_and_last(tmp_path):
    series = Series(tmp_path / "run.mcap", split=Split(size=3000))
    for number in range(20):
        series.hold("a", "clock", {"at": f"{number}"}, at_once=number == 1)
        series.message(raw("x" * 400))
        series.flush()
    assert told(series.paths[-1]), "also while it is written, as of one that is killed"
    series.finish()
    first, second, *_ = map(told, series.paths)
    assert first[:2] == ["0", "1"], "at once, where what is there does not hold any more"
    assert len(first) == 3, "the newest at its end"
    assert second[0] == first[-1]
    assert second[1] == str(int(second[0]) + len(words(series.paths[1])))
    assert told(series.paths[-1])[-1] == "19"


def test_no_file_that_is_there_is_written_over(tmp_path):
    (tmp_path / "run_1.mcap").write_text("mine")
    series = Series(tmp_path / "run.mcap", split=Split(size=10))
    series.message(raw("a"))
    series.flush()
    series.finish()
    assert series.paths[1] == tmp_path / "run_2.mcap"
    assert (tmp_path / "run_1.mcap").read_text() == "mine"


def test_where_no_next_file_can_be_begun_the_last_goes_on(tmp_path):
    folder = tmp_path / "folder"
    folder.mkdir()
    series = Series(folder / "run.mcap", split=Split(size=300))
    series.message(raw("a" * 400))
    with largest_file(0), pytest.raises(RecordingError):
        series.flush()
    series.message(raw("b"))
    series.flush()
    series.finish()
    assert [text for path in series.paths for _, text in words(path)].count("b") == 1
    assert series.lost == 1  # the disk was full before that


def test_files_are_split_by_time_too(tmp_path):
    with Recorder(tmp_path / "run.mcap", period=0.001, split=Split(seconds=0.01)) as recorder:
        recorder.take("/a", Text("a"), Stamp(1, 1.0))
        eventually(lambda: recorder.totals.files > 2, "a second split")
    assert [path.exists() for path in recorder.series.paths] == [True] * recorder.totals.files


def test_a_type_that_is_not_known_is_recorded_as_it_is(tmp_path):
    series = Series(tmp_path / "run.mcap")
    series.message(Raw("/b", "my_msgs/msg/Mine", b"\0\1\0\0abc", 1, 1, definition=""))
    series.finish()
    (message,) = Recording(tmp_path / "run.mcap").messages()
    assert (message.type_name, message.data) == ("my_msgs/msg/Mine", b"\0\1\0\0abc")
    with pytest.raises(RecordingError, match="my_msgs/msg/Mine cannot be read here"):
        message.decoded()
    with (tmp_path / "run.mcap").open("rb") as file:
        ((schema, _, read),) = make_reader(file, validate_crcs=True).iter_messages()
    assert (schema.name, schema.encoding, schema.data) == ("my_msgs/msg/Mine", "", b"")
    assert read.data == message.data
