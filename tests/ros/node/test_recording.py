"""A node records what it publishes, byte for byte; and topics of any node are recorded over DDS."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time

import pytest
from geometry_msgs.msg import TransformStamped
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from crtk_drivers.cli import main
from crtk_drivers.client.ros_link import Link
from crtk_drivers.client.topic_recorder import TopicRecorder
from crtk_drivers.recording import Recorder, Recording, Split, cdr, mend
from crtk_drivers.recording.cdr_transforms import decode_transforms
from crtk_drivers.recording.mcap_writer import definition
from crtk_drivers.ros.definitions import definition_of
from rigs.loopback_node import rig_of
from rigs.ros_client import RosClient
from rigs.waiting import eventually

pytestmark = pytest.mark.ros


def heard(client, topic, kind):
    """Return the bytes that come on a topic from now on."""
    found = []
    client.node.create_subscription(
        kind, topic, lambda data: found.append(bytes(data)), 10, raw=True
    )
    return found


def test_what_is_recorded_is_what_was_published(tmp_path):
    from sensor_msgs.msg import JointState as Message

    with rig_of("/taped") as rig:
        recordings = rig.session.recordings
        recordings.place("/taped")
        published = heard(rig.client, "/taped/measured_js", Message)
        path = recordings.start(tmp_path / "run.mcap")
        begun = len(published)

        def valid():
            """Those of a sample that is too old, which are published without a stamp, are not recorded."""
            return [data for data in published[begun:] if cdr.stamp_of(data)]

        eventually(lambda: len(valid()) > 50, "fifty messages")
        recordings.stop()
    recorded = {m.data for m in Recording(path).messages("/taped/measured_js")}
    same = [data for data in published if data in recorded]
    assert len(same) > 30
    (manifest, *_) = Recording(path).messages("/taped/crtk_driver/crtk_capabilities")
    assert json.loads(manifest.decoded().value.value)["schema"] == "crtk_capabilities/1"
    assert "/taped/robot_description" in Recording(path).topics


def test_it_is_started_and_ended_by_services(tmp_path):
    with rig_of("/asked", recording={"folder": str(tmp_path)}) as rig:
        rig.session.recordings.place("/asked")

        def ask(name):
            answer = rig.client.trigger(name)
            return answer.success, answer.message

        assert ask("record_start")[0]
        done, why = ask("record_start")
        assert not done
        assert "is being written" in why
        assert ask("record_stop")[0]
        rig.device.reachable = False  # what went wrong is asked for then
        eventually(lambda: not rig.session.engine.connected, "the device is gone")
        assert ask("dump")[0]
    boxes = list(tmp_path.glob("*black_box.mcap"))  # of the fault, and what was asked for
    assert boxes
    assert all(Recording(box).is_complete for box in boxes)


@pytest.mark.parametrize("type_name", sorted(cdr.READABLE | {"std_msgs/msg/Empty"}))
def test_the_definitions_that_are_found_are_those_that_ship(type_name):
    assert definition_of(type_name) == definition(type_name)


def test_of_what_is_not_installed_there_is_no_definition():
    assert definition_of("nowhere/msg/Nothing") == ""


class Publishers:
    """A node that is no driver of ours."""

    def __init__(self, node):
        quick = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.quick = node.create_publisher(String, "/other/quick", quick)
        self.kept = node.create_publisher(String, "/other/kept", kept)
        self.far = node.create_publisher(String, "/elsewhere/topic", 10)
        self.tf_static = node.create_publisher(TFMessage, "/tf_static", kept)


def recorded_from(tmp_path, topics=(), split=None, beside=()):
    """Record a node that publishes by its own QoS; return the recorder and its totals."""
    recorder = Recorder(tmp_path / "run.mcap", period=0.001, split=split or Split())
    link = Link("recorder")
    link.start()
    with RosClient("/other") as client:
        publishers = Publishers(client.node)
        publishers.kept.publish(String(data="before"))
        publishers.tf_static.publish(TFMessage(transforms=[TransformStamped(child_frame_id="tip")]))
        taker = TopicRecorder(link, recorder, ["/other"], topics, beside)
        recorder.start()

        sent = [-1, 0.0]  # what had been written, and when it was

        def more():
            taker.look()
            # Who listens loses what comes faster than it is stopped: the QoS promises no more.
            written, now = recorder.totals.written, time.monotonic()
            if written > sent[0] or now - sent[1] > 0.5:
                sent[:] = written, now
                publishers.quick.publish(String(data="quick"))
                publishers.far.publish(String(data="far"))
            has_all = {*beside, *([] if topics else ["/other/kept"])} <= taker.topics.keys()
            return recorder.totals.written > 20 and has_all

        eventually(more, "messages come")
        taker.close()
    totals = recorder.close()
    link.close()
    return recorder, taker, totals


def test_topics_are_recorded_by_the_qos_of_who_publishes_them(tmp_path):
    recorder, taker, totals = recorded_from(tmp_path)
    found = Recording(recorder.series.paths[0])
    assert set(found.topics) == {"/other/quick", "/other/kept"}
    assert [m.decoded().value.value for m in found.messages("/other/kept")] == ["before"]
    assert totals.lost == taker.missed == 0
    with recorder.series.paths[0].open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        kept = next(c for c in reader.get_summary().channels.values() if c.topic.endswith("kept"))
        assert "transient_local" in kept.metadata["offered_qos_profiles"]


def test_one_topic_and_a_file_a_few_bytes(tmp_path):
    recorder, _, _ = recorded_from(tmp_path, ["quick"], Split(size=1500))
    assert len(recorder.series.paths) > 1
    for path in recorder.series.paths:
        assert set(Recording(path).topics) <= {"/other/quick"}
    assert "/other/quick" in Recording(recorder.series.paths[0]).topics


def test_where_frames_are_is_recorded_beside_if_asked_for(tmp_path):
    recorder, taker, _ = recorded_from(tmp_path, ["quick"], beside=["/tf_static"])
    assert taker.has_devices
    found = Recording(recorder.series.paths[0])
    assert set(found.topics) == {"/other/quick", "/tf_static"}
    (message,) = found.messages("/tf_static")
    assert [each.child for each in decode_transforms(message.data)] == ["tip"]


def test_where_frames_are_by_several_publishers_is_in_each_file(tmp_path):
    """Each tells of its own, once."""
    recorder = Recorder(tmp_path / "run.mcap", period=0.001, split=Split(seconds=0.1))
    link = Link("recorder")
    link.start()
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with RosClient("/frames") as client, recorder:
        for child in ("tip", "camera"):
            publisher = client.node.create_publisher(TFMessage, "/tf_static", kept)
            publisher.publish(TFMessage(transforms=[TransformStamped(child_frame_id=child)]))
        taker = TopicRecorder(link, recorder, [], beside=["/tf_static"])

        def both():
            taker.look()
            return recorder.totals.written == 2

        eventually(both, "both messages")
        files = recorder.totals.files
        eventually(lambda: recorder.totals.files > files, "a next file")
        taker.close()
    link.close()
    found = Recording(recorder.series.paths[-1]).messages("/tf_static")
    children = [each.child for message in found for each in decode_transforms(message.data)]
    assert set(children) == {"tip", "camera"}


def run(*arguments, **options):
    command = [sys.executable, "-m", "crtk_drivers.cli", *map(str, arguments)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.slow
def test_killed_it_is_mended_and_ordinary_readers_read_it(tmp_path):
    path = tmp_path / "run.mcap"
    driver = run("loopback", "--ns", "/killed", "--record", path)
    try:
        eventually(lambda: path.exists() and path.stat().st_size > 50_000, "it records")
        driver.send_signal(signal.SIGKILL)
    finally:
        driver.kill()
        driver.communicate()
    assert mend(path)
    found = Recording(path)
    assert found.is_complete
    assert found.counts["/killed/measured_js"] > 10
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert len(list(reader.iter_messages())) == sum(found.counts.values())


@pytest.mark.slow
def test_the_command_records_what_runs(tmp_path):
    path = tmp_path / "run.mcap"
    with rig_of("/heard"):
        recording = run("record", "/heard", "-o", path, "-t", "measured_js")
        try:
            eventually(lambda: path.exists() and path.stat().st_size > 20_000, "it records")
            recording.send_signal(signal.SIGINT)
            _, told = recording.communicate(timeout=30.0)
        finally:
            recording.kill()
    assert recording.returncode == 0, told
    assert "0 dropped, 0 did not come" in told
    found = Recording(path)
    assert set(found.topics) == {"/heard/measured_js"}
    for message in found.messages():
        assert message.publish_time == message.decoded().stamp_ns


def test_nobody_there_is_told_and_leaves_no_file(tmp_path, capfd):
    path = tmp_path / "run.mcap"
    assert main(["record", "/nobody", "-o", str(path), "--timeout", "0.3"]) == 1
    assert "nothing is published in /nobody" in capfd.readouterr().err
    assert not path.exists()
    path.write_text("mine")
    assert main(["record", "/nobody", "-o", str(path)]) == 2
    assert main(["loopback", "--ns", "/nobody", "--record", str(path)]) == 2
    assert capfd.readouterr().err.count("is there already") == 2
    assert path.read_text() == "mine"
