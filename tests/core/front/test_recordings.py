"""A device records itself: samples, commands, refusals; and its black box, at a fault and when asked."""

import json
import os
import threading
import time
from datetime import datetime

import pytest

import crtk_drivers
from crtk_drivers import plugins
from crtk_drivers.commands import Payload
from crtk_drivers.device import Reading
from crtk_drivers.engine.checked_readings import checked_readings
from crtk_drivers.errors import (
    CommandRefused,
    RecordingError,
    TransitionFailed,
    WrongReading,
)
from crtk_drivers.recording import Recording, recorder
from crtk_drivers.samples import Flag, JointState, Stamp, Text, vector
from crtk_drivers.session import black_box, open_session, recordings
from crtk_drivers.session.black_box import BlackBox
from crtk_drivers.session.recordings import make_room
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.testing.contract import DeviceContract
from rigs.waiting import eventually

DEVICE = "/loopback/"
OFTEN = 200.0


@pytest.fixture
def arm(tmp_path):
    with crtk_drivers.connect(
        "loopback", rate=OFTEN, recording={"folder": str(tmp_path / "box"), "black_box": 30.0}
    ) as arm:
        yield arm


def told(path, name):
    return [m.decoded() for m in Recording(path).messages(f"{DEVICE}{name}")]


def texts(path, name):
    return [json.loads(each.value.value) for each in told(path, name)]


def test_every_sample_is_recorded_once_with_its_stamp(arm, tmp_path):
    seen = []

    def keep(moment):
        seen.append(moment[1])

    path = arm.recordings.start(tmp_path / "run.mcap")
    arm.engine.keepers = (*arm.engine.keepers, keep)
    eventually(lambda: len(seen) > 100, "a hundred samples")
    answer = arm.record_stop()
    recording = Recording(path)
    assert recording.is_complete
    stamps = [each.stamp_ns for each in told(path, "measured_js")]
    assert stamps == sorted(set(stamps))
    kept = {each.stamp.wall_ns: each for each in seen}
    both = [stamp for stamp in stamps if stamp in kept]
    assert len(both) > 90
    assert both == [stamp for stamp in kept if both[0] <= stamp <= both[-1]]
    for name in ("measured_js", "measured_cp"):
        for found in told(path, name):
            if found.stamp_ns in kept:
                own = kept[found.stamp_ns].values["measured_js"].position
                assert found.value.position[:3].tolist() == own[:3].tolist()
    assert told(path, "measured_js")[0].value.name == arm.engine.capabilities.joints
    assert told(path, "measured_js")[0].frame_id == "base"
    assert "none lost" in answer


def test_commands_refusals_states_and_settings_are_in_it(arm, tmp_path):
    path = arm.recordings.start(tmp_path / "run.mcap")
    with pytest.raises(CommandRefused):
        arm.move_jp(vector([0.1, 0.0, 0.0, 0.0]))
    arm.enable()
    arm.move_jp(vector([0.1, 0.0, 0.0, 0.0])).wait()
    arm.hold()
    with pytest.raises(CommandRefused):
        arm.engine.submit("servo_jp", JointState(vector([0.1, 0.2])))
    arm.record_stop()
    assert [each.value.position[0] for each in told(path, "move_jp")] == [0.1, 0.1]
    assert [each.value.value for each in told(path, "state_command")] == ["enable"]
    assert len(told(path, "servo_jp")) == 1
    assert [each["reason"] for each in texts(path, "refusals")] == ["not_enabled", "wrong_size"]
    states = [each.value.state for each in told(path, "operating_state")]
    assert (states[0], states[-1]) == (OperatingState.DISABLED, OperatingState.ENABLED)
    assert told(path, "goal_js")[-1].value.position[0] == 0.1
    assert told(path, "trajectory_j/ratio")
    assert Recording(path).counts[f"{DEVICE}hold"] == 1
    assert texts(path, "crtk_driver/health")[0]["connected"]
    (configuration,) = Recording(path).attachments
    assert json.loads(configuration.data)["rate"] == OFTEN


def test_what_no_command_can_be_is_refused_and_harms_no_recording(arm, tmp_path):
    path = arm.recordings.start(tmp_path / "run.mcap")
    for name, value in (("nonsense", None), ("servo_jp", "text"), ("servo_jp", None)):
        with pytest.raises(CommandRefused):
            arm.engine.submit(name, value)
    arm.record_stop()
    assert len(texts(path, "refusals")) == 3
    assert f"{DEVICE}nonsense" not in Recording(path).topics


def test_only_the_topics_that_were_asked_for(tmp_path):
    with crtk_drivers.connect("loopback", recording={"topics": ["jacobian"]}) as arm:
        path = arm.recordings.start(tmp_path / "run.mcap")
        arm.record_stop()
    topics = Recording(path).topics
    assert f"{DEVICE}measured_js" not in topics


def test_one_at_a_time_and_none_without_a_place(arm):
    first = arm.record_start()
    assert first.startswith("recording ")
    with pytest.raises(CommandRefused, match="is being written"):
        arm.record_start()
    arm.record_stop()
    with pytest.raises(CommandRefused, match="nothing is recorded"):
        arm.record_stop()
    with crtk_drivers.connect("loopback") as other:
        with pytest.raises(RecordingError, match="no folder is configured"):
            other.record_start()
        with pytest.raises(CommandRefused, match="there is no black box"):
            other.dump()


def test_a_disk_that_hangs_stops_no_device_and_the_loss_is_told(arm, tmp_path, monkeypatch):
    goes_on, real, hangs = threading.Event(), os.pwrite, threading.Event()

    def pwrite(*args):
        hangs.set()
        goes_on.wait(20.0)
        return real(*args)

    path = arm.recordings.start(tmp_path / "run.mcap")
    recorder = arm.recordings.recorder
    recorder._capacity = 5
    monkeypatch.setattr(os, "pwrite", pwrite)
    hangs.wait(20.0)
    before = arm.engine.health()
    eventually(lambda: arm.engine.health().samples > before.samples + 50, "fifty more samples")
    eventually(lambda: recorder.totals.lost > 100, "some are dropped, and counted")
    assert arm.engine.status.state is OperatingState.DISABLED
    goes_on.set()
    totals = arm.recordings.stop()
    assert totals.lost > 100
    counted = dict(Recording(path).metadata)["crtk_drivers recording"]
    assert int(counted["lost"]) == totals.lost
    assert len(list(Recording(path).messages())) == totals.written


def test_a_disk_that_is_full_at_the_end_is_the_answer(arm, tmp_path, monkeypatch):
    arm.recordings.start(tmp_path / "run.mcap")

    def pwrite(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", pwrite)
    with pytest.raises(TransitionFailed, match="No space left"):
        arm.record_stop()
    monkeypatch.undo()
    assert Recording(tmp_path / "run.mcap").is_complete is False


# ------------------------------------------------------------------------------------- the black box


def boxes(folder):
    return sorted(folder.glob("*black_box.mcap"))


def test_a_fault_writes_what_led_to_it(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(black_box, "AFTER", 0.05)
    arm.enable()
    arm.move_jp(vector([0.2, 0.0, 0.0, 0.0])).wait()
    eventually(lambda: arm.engine.health().samples > 30, "samples")
    arm.engine.device.reachable = False
    eventually(lambda: boxes(tmp_path / "box"), "the file of the black box")
    arm.engine.device.reachable = True
    eventually(lambda: arm.engine.connected, "it is connected again")
    arm.close()
    (path,) = boxes(tmp_path / "box")
    assert Recording(path).is_complete
    assert len(told(path, "measured_js")) > 20
    assert [each.value.position[0] for each in told(path, "move_jp")] == [0.2]
    assert max(each.value.position[0] for each in told(path, "setpoint_js")) == pytest.approx(0.2)
    states = texts(path, "crtk_driver/status")
    assert any(each["state"] == "FAULT" and each["detail"] for each in states)
    about = dict(Recording(path).metadata)["crtk_drivers device"]
    assert about["name"] == "loopback"
    assert about["why"]


def test_a_fault_just_before_the_end_is_written_whatever_the_thread_does_then(
    arm, tmp_path, monkeypatch
):
    monkeypatch.setattr(black_box, "FORGETS", 0.01)
    box = arm.recordings._black_box
    looks = threading.Event()

    class Ended(threading.Event):
        """The thread is stopped between two looks, and meanwhile all is over."""

        def is_set(self):
            if threading.current_thread() is box._thread and not looks.is_set():
                looks.set()
                closed.wait(20.0)
            return super().is_set()

    closed = threading.Event()
    eventually(lambda: arm.engine.health().samples > 20, "samples")
    box._ended = Ended()
    assert looks.wait(20.0)
    box.status_changed(Status(OperatingState.FAULT, detail="lost"), Stamp.now())
    joined = box._thread.join
    monkeypatch.setattr(box._thread, "join", lambda timeout: (closed.set(), joined(20.0)))
    arm.close()
    (path,) = boxes(tmp_path / "box")
    assert dict(Recording(path).metadata)["crtk_drivers device"]["why"] == "lost"


def test_a_fault_before_the_first_sample_says_nothing_of_it(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(black_box, "AFTER", 0.01)
    written = []
    tell = BlackBox._tell
    monkeypatch.setattr(BlackBox, "_tell", lambda box, why: (tell(box, why), written.append(why)))
    settings = {"recording": {"folder": str(tmp_path)}}
    config = plugins.device("loopback").load_config(settings, {})
    session = open_session("loopback", config)
    session.engine.device.reachable = False
    with session:
        eventually(lambda: written, "the black box has seen the fault")
        assert session.engine.status.state is OperatingState.FAULT
        with pytest.raises(RecordingError, match="no sample has come"):
            session.recordings.dump("asked for")
    assert "black box" not in caplog.text
    assert not boxes(tmp_path)


def test_it_is_written_when_somebody_asks_while_a_recording_goes_on(arm, tmp_path):
    run = arm.recordings.start(tmp_path / "run.mcap")
    before = arm.engine.health().samples
    eventually(lambda: arm.engine.health().samples > before + 20, "samples of both")
    answer = arm.dump()
    arm.record_stop()
    (path,) = boxes(tmp_path / "box")
    assert str(path) in answer
    recorded = [each.stamp_ns for each in told(run, "measured_js")]
    kept = [each.stamp_ns for each in told(path, "measured_js")]
    assert kept == sorted(kept)
    assert set(kept) & set(recorded)


def test_neither_a_stamp_of_a_client_nor_a_reading_that_fails_costs_the_black_box(
    arm, tmp_path, monkeypatch, caplog
):
    def failing():
        raise ZeroDivisionError("of a reading")

    broken = Reading("breaks", Payload.NUMBER, failing)
    monkeypatch.setattr(arm.engine, "readings", {"broken": broken})
    with pytest.raises(CommandRefused):
        arm.engine.submit("servo_jp", JointState(vector([0.1] * 4)), -1_000_000_000)
    run = arm.recordings.start(tmp_path / "run.mcap")
    arm.dump()
    eventually(lambda: arm.recordings.recorder.totals.taken, "a write")
    arm.record_stop()
    (path,) = boxes(tmp_path / "box")
    assert [each.stamp_ns for each in told(path, "servo_jp")] == [-1_000_000_000]
    assert told(path, "measured_js")
    assert Recording(run).is_complete
    assert texts(run, "crtk_driver/health")
    assert "broken is left out" in caplog.text


def test_a_reading_of_a_wrong_class_costs_the_black_box_nothing_else(
    arm, tmp_path, monkeypatch, caplog
):
    readings = {
        "guard": Reading("whether it is open", Payload.FLAG, lambda: True),
        "door": Reading("whether it is shut", Payload.FLAG, lambda: Flag(True)),
    }
    monkeypatch.setattr(arm.engine, "readings", checked_readings(readings, "stage 10.0.0.2"))
    arm.dump()
    (path,) = boxes(tmp_path / "box")
    assert told(path, "state/door")
    assert f"{DEVICE}state/guard" not in Recording(path).topics
    with pytest.raises(WrongReading, match="'guard': returned bool, must return Flag"):
        DeviceContract().test_readings_return_the_class_of_their_payload(arm)
    (said,) = [each for each in caplog.records if "guard" in each.getMessage()]
    assert said.exc_info is None


def test_it_keeps_no_more_than_its_seconds(tmp_path):
    settings = {"folder": str(tmp_path), "black_box": 0.5}
    with crtk_drivers.connect("loopback", rate=OFTEN, recording=settings) as arm:
        eventually(lambda: arm.engine.health().samples > 130, "more samples than it keeps")
        arm.dump()
    (path,) = boxes(tmp_path)
    assert 0 < len(told(path, "measured_js")) <= 0.5 * OFTEN


@pytest.mark.parametrize("leap", [3600.0, -3600.0])
def test_nothing_is_lost_where_the_time_of_day_leaps(arm, tmp_path, monkeypatch, leap):
    real, leapt = time.time_ns, []
    monkeypatch.setattr(time, "time_ns", lambda: real() + sum(leapt))
    run = arm.recordings.start(tmp_path / "run.mcap")
    arm.enable()
    samples = arm.engine.health().samples
    eventually(lambda: arm.engine.health().samples > samples + 20, "samples of before")
    leapt.append(int(1e9 * leap))
    samples = arm.engine.health().samples
    eventually(lambda: arm.engine.health().samples > samples + 20, "samples of after")
    arm.dump()
    assert "none lost" in arm.record_stop()
    (path,) = boxes(tmp_path / "box")
    half = real() + leapt[0] // 2
    for each in (run, path):
        assert Recording(each).is_complete
        stamps = [found.stamp_ns > half for found in told(each, "measured_js")]
        first = leap < 0.0
        assert stamps.count(first) > 10
        assert stamps.count(not first) > 10
        assert stamps == sorted(stamps, reverse=first), "in the order in which they came"
        assert told(each, "state_command")


def test_two_of_one_time_of_day_are_two(arm, tmp_path, monkeypatch):
    class Stopped(datetime):
        @classmethod
        def now(cls, tz=None):
            return cls(2026, 1, 1, tzinfo=tz)

    monkeypatch.setattr(recordings, "datetime", Stopped)
    for _ in range(3):
        arm.dump()
    assert len(boxes(tmp_path / "box")) == 3


def test_it_keeps_no_event_that_is_older_nor_what_is_no_command(tmp_path, monkeypatch):
    monkeypatch.setattr(black_box, "FORGETS", 0.02)
    settings = {"folder": str(tmp_path), "black_box": 60.0}
    with crtk_drivers.connect("loopback", rate=OFTEN, recording=settings) as arm:
        (ring,) = arm.recordings._black_box._rings

        def heard():
            return [arguments[0] for _, (_, *arguments) in [*ring._events]]

        arm.enable()
        with pytest.raises(CommandRefused):
            arm.engine.submit("nonsense", Text("x" * 100_000))
        assert "state_command" in heard()
        assert "nonsense" not in heard()
        ring._seconds = 0.1
        eventually(lambda: "state_command" not in heard(), "it is let go of")


def test_what_is_large_fills_no_memory(arm, tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "CAPACITY_SIZE", 1_000_000)
    goes_on, real, hangs = threading.Event(), os.pwrite, threading.Event()

    def pwrite(*args):
        hangs.set()
        goes_on.wait(20.0)
        return real(*args)

    arm.recordings.start(tmp_path / "run.mcap")
    monkeypatch.setattr(os, "pwrite", pwrite)
    assert hangs.wait(20.0)
    for _ in range(black_box.MOST_LARGE):
        with pytest.raises(CommandRefused):
            arm.engine.state_command("x" * 400_000)
        with pytest.raises(CommandRefused):
            arm.engine.submit("servo_jp", JointState(vector([0.0] * 50_000)))
    (ring,) = arm.recordings._black_box._rings
    assert len(ring._large) == black_box.MOST_LARGE
    goes_on.set()
    totals = arm.recordings.stop()
    assert totals.lost == 2 * black_box.MOST_LARGE - 2
    arm.dump()
    (path,) = boxes(tmp_path / "box")
    for name in ("state_command", "servo_jp"):
        assert len(told(path, name)) == black_box.MOST_LARGE // 2


def test_the_folder_stays_small_and_keeps_what_was_asked_for(tmp_path):
    for number in range(6):
        path = tmp_path / f"arm-{number}-{'run' if number == 1 else 'black_box'}.mcap"
        path.write_bytes(bytes(100))
        os.utime(path, (number, number))
    (tmp_path / "other.txt").write_text("x" * 1000)
    make_room(tmp_path, 300, "black_box")
    names = sorted(path.name for path in tmp_path.glob("*.mcap"))
    assert names == ["arm-1-run.mcap", "arm-4-black_box.mcap", "arm-5-black_box.mcap"]
    past = time.time() + 3600.0  # the time of day was set back since
    os.utime(tmp_path / "arm-4-black_box.mcap", (past, past))
    make_room(tmp_path, 50, "black_box")  # of which the recording alone takes more
    names = sorted(path.name for path in tmp_path.glob("*.mcap"))
    assert names == ["arm-1-run.mcap", "arm-5-black_box.mcap"]


def test_a_folder_that_cannot_be_made_is_told(tmp_path, caplog):
    (tmp_path / "file").write_text("")
    with crtk_drivers.connect("loopback", recording={"folder": str(tmp_path / "file")}) as arm:
        with pytest.raises(RecordingError, match="cannot be used for recordings"):
            arm.record_start()
        with pytest.raises(RecordingError, match="cannot be used for recordings"):
            arm.dump()
        arm.enable()  # the device goes on
