"""What is made of recordings: pages, pictures, tables, and a way for an arm."""

import csv
import json
import math
import xml.etree.ElementTree as ET
from importlib.util import find_spec

import numpy as np
import pytest

from crtk_drivers.cli import main
from crtk_drivers.errors import MissingExtra, RecordingError
from crtk_drivers.labs.tapes.contents import contents_of
from crtk_drivers.labs.tapes.figures import thinned
from crtk_drivers.labs.tapes.joint_path import joint_path, refused
from crtk_drivers.labs.tapes.pages import all_figures, html, png
from crtk_drivers.labs.tapes.rows import row_of
from crtk_drivers.labs.tapes.tables import convert
from crtk_drivers.recording import Raw, Recording, Series, cdr, opened
from crtk_drivers.recording.cdr_transforms import TYPE as TRANSFORMS
from crtk_drivers.samples import (
    CartesianServo,
    Flag,
    JointServo,
    JointState,
    Number,
    Numbers,
    Pose,
    Text,
    Twist,
    Wrench,
    vector,
)
from crtk_drivers.state import OperatingState, Status

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
NAMES = ("pan_joint", "tilt_joint")


def write_arm(path, namespace="/arm", seconds=2.0, rate=100.0):
    """Record two joints that swing, with a refusal, a fault, and something nobody knows."""
    series = Series(path)

    def add(name, type_name, data, log_time, stamp=None):
        full = f"{namespace}/{name}"
        series.message(Raw(full, type_name, data, log_time, stamp or log_time, definition=""))

    for number in range(int(seconds * rate)):
        t = number / rate
        at = BEGIN + int(t * SECOND)
        position = vector([0.5 * math.sin(t), 0.2 * t])
        measured = JointState(position, vector([0.5 * math.cos(t), 0.2]), name=NAMES)
        add("measured_js", cdr.TYPE_NAMES[JointState], cdr.encode(measured, at, "base"), at)
        is_valid = t > 0.5
        setpoint = JointState(position + 0.01, name=NAMES)
        data = cdr.encode(setpoint, at if is_valid else 0, "base")
        add("setpoint_js", cdr.TYPE_NAMES[JointState], data, at)
        pose = Pose(vector([math.cos(t), math.sin(t), t]), vector([0, 0, 0, 1]))
        add("measured_cp", cdr.TYPE_NAMES[Pose], cdr.encode(pose, at, "base"), at)
        wrench = Wrench(vector([0, 0, t]), vector([0, 0, 0]))
        add("measured_cf", cdr.TYPE_NAMES[Wrench], cdr.encode(wrench, at, "base"), at)
        if is_valid:
            add("servo_jp", cdr.TYPE_NAMES[JointState], cdr.encode(setpoint, at), at)
    middle = BEGIN + int(seconds / 2 * SECOND)
    for state, at in (("DISABLED", BEGIN), ("ENABLED", BEGIN + SECOND // 2), ("FAULT", middle)):
        told = Status(OperatingState(state))
        add("operating_state", cdr.TYPE_NAMES[Status], cdr.encode(told, at), at)
    why = json.dumps({"state": "FAULT", "detail": "the <link> is gone"})
    add("crtk_driver/status", cdr.TEXT_TYPE, cdr.encode_text(why), middle)
    refusal = json.dumps({"command": "move_jp", "reason": "not_enabled"})
    add("refusals", cdr.TEXT_TYPE, cdr.encode_text(refusal), BEGIN + SECOND // 4)
    add("refusals", cdr.TEXT_TYPE, cdr.encode_text("no json"), BEGIN + SECOND // 4)
    add("mine", "my_msgs/msg/Mine", b"\1\2", BEGIN)
    add("measured_js2", cdr.TYPE_NAMES[JointState], b"nonsense", BEGIN)
    series.finish()


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    path = tmp_path_factory.mktemp("tapes") / "run.mcap"
    write_arm(path)
    return path


# ---------------------------------------------------------------------------------------- what is in it


def test_tracks_states_refusals_and_commands_are_found(arm):
    contents = contents_of(opened(arm)[0])
    (device,) = contents.devices.values()
    assert device.namespace == "/arm"
    assert contents.seconds == pytest.approx(1.99)
    joints = device.tracks["measured_js"]
    assert joints.times.size == 200
    assert joints.columns["position/tilt_joint"][100] == pytest.approx(0.2)
    setpoint = device.tracks["setpoint_js"].part("position")["pan_joint"]
    assert np.isnan(setpoint[:51]).all()  # not valid then
    assert np.isfinite(setpoint[52:]).all()
    assert device.refusals == [(0.25, "move_jp", "not_enabled")]
    assert (1.0, "FAULT", "the <link> is gone") in device.states
    assert len(device.commands["servo_jp"]) == 149
    assert contents.others["/arm/mine"] == ("my_msgs/msg/Mine", 1)


def test_only_a_part_of_the_time(arm):
    contents = contents_of(opened(arm)[0], 0.5, 1.0)
    (device,) = contents.devices.values()
    times = device.tracks["measured_js"].times
    assert 0.5 <= times.min() <= times.max() <= 1.0


# ------------------------------------------------------------------------------------- page and picture


def test_the_page_is_whole_in_one_file_and_shows_what_happened(arm):
    recording, _ = opened(arm)
    contents = contents_of(recording)
    figures = all_figures(contents)
    page = html(recording, contents, figures, "it was cut off & mended")
    assert "it was cut off &amp; mended" in page
    assert "<script" not in page
    for outside in ("http://", "https://", "src="):
        assert outside not in page.replace("http://www.w3.org/2000/svg", "")
    begin = page.index("<svg")
    element = ET.fromstring(page[begin : page.index("</svg>") + len("</svg>")])
    words = " ".join(each.text or "" for each in element.iter() if each.tag.endswith("text"))
    for shown in ("/arm", "Position", "Error", "Velocity", "Force", "Way of the tool", "servo_jp"):
        assert shown in words
    assert "move_jp: not_enabled" in words
    assert "the &lt;link&gt; is gone" in page
    assert "my_msgs/msg/Mine" in page
    (panel,) = [each for each in figures[0].panels if each.title.startswith("Error")]
    assert np.nanmax(np.abs(panel.lines[0].y)) == pytest.approx(0.01, abs=1e-6)


def test_the_picture_is_a_png_in_which_lines_are_drawn(arm):
    from io import BytesIO

    from PIL import Image

    data = png(all_figures(contents_of(opened(arm)[0])))
    picture = Image.open(BytesIO(data)).convert("RGB")
    pixels = np.asarray(picture).reshape(-1, 3)
    assert picture.width == 1000
    blue = np.abs(pixels.astype(int) - (0x1F, 0x6F, 0xEB)).sum(axis=1) < 40
    green = np.abs(pixels.astype(int) - (0x4A, 0xC2, 0x6B)).sum(axis=1) < 20
    assert blue.sum() > 500
    assert green.sum() > 500  # ENABLED


def test_of_a_long_line_the_peaks_are_kept_and_gaps_stay():
    x = np.linspace(0.0, 1.0, 100_000)
    y = np.zeros(x.size)
    y[12_345] = 7.0
    y[50_000:60_000] = np.nan
    pieces = list(thinned(x, y, 0.0, 1.0, 500))
    assert len(pieces) == 2
    assert sum(map(len, pieces)) < 2100
    assert max(piece[:, 1].max() for piece in pieces) == 7.0
    assert list(thinned(x, np.full(x.size, np.inf), 0.0, 1.0, 500)) == []


@pytest.mark.parametrize("values", [0.0, 1e-320, 1e300, -5.0])
def test_values_of_any_size_are_drawn(tmp_path, values):
    path = tmp_path / "run.mcap"
    series = Series(path)
    for number in range(3):
        data = cdr.encode(JointState(vector([values])), BEGIN)
        series.message(Raw("/a/measured_js", cdr.TYPE_NAMES[JointState], data, BEGIN + number, 1))
    series.finish()
    recording, _ = opened(path)
    contents = contents_of(recording)
    assert "polyline" in html(recording, contents, all_figures(contents), "")


def test_the_command_writes_both_and_says_what_is_missing(arm, tmp_path, capfd, monkeypatch):
    page = tmp_path / "page.html"
    assert main(["plot", str(arm), "-o", str(page)]) == 0
    assert page.exists()
    assert page.with_suffix(".png").read_bytes().startswith(b"\x89PNG")

    def none(name):
        raise ImportError(name)

    monkeypatch.setattr("crtk_drivers.labs.tapes.png_canvas.import_module", none)
    assert main(["plot", str(arm), "-o", str(tmp_path / "other.html")]) == 0
    assert "no picture" in capfd.readouterr().err
    assert not (tmp_path / "other.png").exists()


def test_the_commands_refuse_in_words(arm, tmp_path, capfd):
    (tmp_path / "words.mcap").write_text("x")
    Series(tmp_path / "none.mcap", {"a": {"b": "c"}}).finish()
    for arguments, words in (
        (["plot", str(tmp_path / "words.mcap")], "is no MCAP file"),
        (["plot", str(tmp_path / "missing.mcap")], "cannot be read"),
        (["plot", str(tmp_path / "none.mcap")], "holds no message"),
        (["plot", str(arm), "-o", str(tmp_path / "no" / "page.html")], "cannot be written"),
        (["plot", str(arm), "--from", "2", "--to", "1"], "must be before --to"),
        (["convert", str(arm), "-t", "/nobody"], "has no /nobody"),
        (["convert", str(arm), "-o", str(tmp_path / "words.mcap")], "cannot be written"),
    ):
        assert main(arguments) in (1, 2)
        err = " ".join(capfd.readouterr().err.split())
        assert words in err


# ----------------------------------------------------------------------------------------------- tables


def read_csv(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_each_topic_becomes_a_table(arm, tmp_path):
    recording, _ = opened(arm)
    written = {topic: (path, rows) for topic, path, rows in convert(recording, tmp_path, "csv")[0]}
    assert set(written) == set(recording.topics)
    rows = read_csv(written["/arm/measured_js"][0])
    assert len(rows) == written["/arm/measured_js"][1] == 200
    assert float(rows[100]["position/tilt_joint"]) == pytest.approx(0.2)
    assert rows[100]["stamp_ns"] == rows[100]["log_time_ns"]
    assert rows[100]["frame_id"] == "base"
    states = read_csv(written["/arm/operating_state"][0])
    assert [row["state"] for row in states] == ["DISABLED", "ENABLED", "FAULT"]
    assert read_csv(written["/arm/mine"][0])[0]["data"] == "0102"  # a type that nobody knows
    assert read_csv(written["/arm/measured_js2"][0])[0]["data"] == b"nonsense".hex()
    with pytest.raises(RecordingError, match="is there already"):
        convert(recording, tmp_path, "csv")


def test_parquet_says_what_it_takes(arm, tmp_path, monkeypatch):
    def none(name):
        raise ImportError(name)

    monkeypatch.setattr("crtk_drivers.labs.tapes.tables.import_module", none)
    with pytest.raises(MissingExtra, match="pyarrow"):
        convert(opened(arm)[0], tmp_path, "parquet")


@pytest.mark.skipif(find_spec("pyarrow") is None, reason="no pyarrow")
def test_parquet_has_the_same_numbers(arm, tmp_path):
    import pyarrow.parquet as parquet

    (((_, path, rows),), _) = convert(opened(arm)[0], tmp_path, "parquet", ["/arm/measured_js"])
    table = parquet.read_table(path)
    assert table.num_rows == rows == 200
    assert table.column("position/tilt_joint")[100].as_py() == pytest.approx(0.2)


@pytest.mark.skipif(find_spec("pyarrow") is None, reason="no pyarrow")
def test_parquet_takes_columns_that_are_empty_at_first_and_words_among_numbers(
    tmp_path, monkeypatch
):
    import pyarrow.parquet as parquet

    monkeypatch.setattr("crtk_drivers.labs.tapes.tables.BATCH", 2)
    series = Series(tmp_path / "run.mcap")
    number = cdr.encode(Number(2.5), 0)
    for at, data in enumerate((number, number, b"nonsense", number)):
        series.message(Raw("/a/number", "std_msgs/msg/Float64", data, BEGIN + at, BEGIN))
    series.finish()
    recording = Recording(tmp_path / "run.mcap")
    (((_, path, rows),), _) = convert(recording, tmp_path / "parquet", "parquet")
    assert rows == 4
    told = parquet.read_table(path).column("data").to_pylist()
    assert told == ["2.5", "2.5", b"nonsense".hex(), "2.5"]


@pytest.mark.parametrize(
    ("value", "name", "cell"),
    [
        (Twist(vector([1, 2, 3]), vector([4, 5, 6])), "angular/y", 5.0),
        (Number(2.5), "data", 2.5),
        (Flag(True), "data", True),
        (Numbers((1.0, 2.0)), "1", 2.0),
        (Text("wörd"), "data", "wörd"),
        (JointServo((1, 2), vector([3, 4])), "mode/1", 2.0),
        (
            CartesianServo(
                (0, 0, 1, 0, 0, 0),
                Pose(vector([1, 2, 3]), vector([0, 0, 0, 1])),
                Twist(vector([0, 0, 0]), vector([0, 0, 0])),
                Wrench(vector([0, 0, 9]), vector([0, 0, 0])),
                Pose(vector([7, 8, 9]), vector([0, 0, 0, 1])),
            ),
            "task/position/z",
            9.0,
        ),
    ],
)
def test_what_a_message_says_is_a_row(tmp_path, value, name, cell):
    types = {
        Twist: "geometry_msgs/msg/TwistStamped",
        Number: "std_msgs/msg/Float64",
        Flag: "std_msgs/msg/Bool",
        Numbers: "std_msgs/msg/Float64MultiArray",
        Text: "crtk_msgs/msg/StringStamped",
        JointServo: "crtk_msgs/msg/JointServo",
        CartesianServo: "crtk_msgs/msg/CartesianServo",
    }
    series = Series(tmp_path / "run.mcap")
    series.message(Raw("/a", types[type(value)], cdr.encode(value, 5), 1, 1))
    series.finish()
    (message,) = Recording(tmp_path / "run.mcap").messages()
    assert row_of(message)[2][name] == cell


def test_each_transform_is_a_row_of_its_own(tmp_path):
    series = Series(tmp_path / "run.mcap")
    place = Pose(vector([0, 0, 0.5]), vector([0, 0, 0, 1]))
    where = cdr.encode_transform(place, 7, "base", "tip")
    for topic, data in (("/tf", where), ("/tf_static", b"nonsense")):
        series.message(Raw(topic, TRANSFORMS, data, BEGIN, BEGIN, definition=""))
    series.finish()
    recording = Recording(tmp_path / "run.mcap")
    written = {topic: path for topic, path, _ in convert(recording, tmp_path / "csv", "csv")[0]}
    (row,) = read_csv(written["/tf"])
    assert (row["frame_id"], row["child_frame_id"], row["stamp_ns"]) == ("base", "tip", "7")
    assert float(row["position/z"]) == 0.5
    assert float(row["orientation/w"]) == 1.0
    assert read_csv(written["/tf_static"])[0]["data"] == b"nonsense".hex()
    contents = contents_of(recording)
    assert contents.devices == {}
    assert contents.others["/tf"] == (TRANSFORMS, 1)
    assert TRANSFORMS in html(recording, contents, all_figures(contents), "")


# ------------------------------------------------------------------------------------- a way for an arm


def limits(**changed):
    return [
        {"name": name, "lower": -1.0, "upper": 1.0, "velocity": 1.0, **changed} for name in NAMES
    ]


def test_the_way_is_that_of_the_setpoints_which_are_valid(arm):
    path = joint_path(opened(arm)[0])
    assert path.topic == "/arm/setpoint_js"
    assert path.names == NAMES
    assert path.seconds == pytest.approx(1.99 - 0.51, abs=0.02)
    assert path.at(0.5)[1] == pytest.approx(0.2 * 1.01 + 0.01, abs=1e-3)
    assert refused(path, limits(), 1.0) == ""


@pytest.mark.parametrize(
    ("joints", "rate", "why"),
    [
        (limits(upper=0.3), 1.0, r"pan_joint goes to 0.5\d*, its range ends at 0.3"),
        (limits(lower=0.4), 1.0, "its range begins at 0.4"),
        (
            limits(velocity=0.3),
            1.0,
            r"pan_joint goes at 0.43\d* a second .* --rate 0.6\d* would do",
        ),
        (limits(), 3.0, "its limit is 1"),
        (limits()[:1], 1.0, "is of another device: pan_joint, tilt_joint, not pan_joint"),
        (limits()[::-1], 1.0, "is of another device"),
    ],
)
def test_a_way_that_an_arm_cannot_go_is_refused(arm, joints, rate, why):
    import re

    assert re.search(why, refused(joint_path(opened(arm)[0]), joints, rate))


def write_way(path, rows, names=()):
    series = Series(path)
    for time, *position in rows:
        at = BEGIN + int(time * SECOND)
        data = cdr.encode(JointState(vector(position), name=names), at)
        series.message(Raw("/x/measured_js", cdr.TYPE_NAMES[JointState], data, at, at))
    series.finish()
    return opened(path)[0]


def test_jumps_and_gaps_are_no_way(tmp_path):
    jump = write_way(tmp_path / "jump.mcap", [(0, 0), (0.01, 0), (0.02, 0.5), (0.03, 0.5)])
    assert "goes at" in refused(joint_path(jump), limits()[:1], 1.0)
    gap = write_way(tmp_path / "gap.mcap", [(0, 0), (0.1, 0), (3.0, 0.5), (3.1, 0.5)])
    assert "moves by 0.5 in a gap at 0.10 s" in refused(joint_path(gap), limits()[:1], 1.0)


def test_what_holds_no_way_is_told(tmp_path):
    with pytest.raises(RecordingError, match="holds no joint positions"):
        joint_path(write_way(tmp_path / "one.mcap", [(0, 0)]))
    path = tmp_path / "nan.mcap"
    with pytest.raises(RecordingError, match="not finite"):
        joint_path(write_way(path, [(0, 0), (1, math.nan)]))
    with pytest.raises(RecordingError, match="has other joints later on"):
        joint_path(write_way(tmp_path / "uneven.mcap", [(0, 0), (1, 0, 0)]))


def test_of_several_devices_one_is_asked_for(tmp_path):
    path = tmp_path / "two.mcap"
    series = Series(path)
    for space in ("/a", "/b"):
        for number in range(3):
            at = BEGIN + number * SECOND // 10
            data = cdr.encode(JointState(vector([0.1 * number])), at)
            series.message(Raw(f"{space}/measured_js", cdr.TYPE_NAMES[JointState], data, at, at))
    series.finish()
    recording, _ = opened(path)
    with pytest.raises(RecordingError, match="has joints of several devices"):
        joint_path(recording)
    assert joint_path(recording, "/b").topic == "/b/measured_js"
