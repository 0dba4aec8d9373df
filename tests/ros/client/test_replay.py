"""A recording again: as topics in a namespace of their own, and as commands to an arm."""

from __future__ import annotations

import math
import signal
import subprocess
import sys
import threading
import time
from itertools import pairwise

import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState as JointStateMessage
from std_msgs.msg import String

from crtk_drivers.cli import main, replay_command
from crtk_drivers.client.republishing import common_namespace, is_command
from crtk_drivers.recording import Raw, Series, cdr
from crtk_drivers.samples import JointState, Pose, vector
from crtk_drivers.testing.loopback import JOINTS
from rigs.loopback_client import Node
from rigs.loopback_node import rig_of
from rigs.ros_client import RosClient
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros

SECOND = 1_000_000_000
BEGIN = 1_700_000_000 * SECOND
JOINTS_TYPE = cdr.TYPE_NAMES[JointState]


def write_way(path, seconds=1.0, names=JOINTS, width=0.2):
    series = Series(path)
    series.message(Raw("/old/manifest", cdr.TEXT_TYPE, cdr.encode_text("{}"), BEGIN, BEGIN, True))
    where = cdr.encode_transform(
        Pose(vector((0, 0, 1)), vector((0, 0, 0, 1))), BEGIN, "base", "tip"
    )
    series.message(
        Raw("/tf", "tf2_msgs/msg/TFMessage", where, BEGIN, BEGIN, definition="")
    )  # it is of all
    for number in range(int(100 * seconds)):
        at = BEGIN + number * SECOND // 100
        swing = width * (1.0 - math.cos(number / 100))
        value = JointState(vector([0.1 + swing, 0.0, 0.0, 0.0]), name=names)
        for name in ("measured_js", "servo_jp"):
            data = cdr.encode(value, at, "base")
            series.message(Raw(f"/old/{name}", JOINTS_TYPE, data, at, at))
    series.finish()


def here(rig):
    value, _ = rig.session.engine.feedback("measured_js")
    return value.position[0]


def test_topics_come_again_byte_for_byte_and_commands_do_not(tmp_path, monkeypatch):
    look = replay_command._taken

    def look_when_found(link, namespace):
        listening = ("measured_js", "servo_jp", "manifest")
        eventually(
            lambda: all(link.node.count_subscribers(f"{namespace}/{name}") for name in listening),
            "who listens is found",
        )
        return look(link, namespace)

    monkeypatch.setattr(replay_command, "_taken", look_when_found)
    monkeypatch.setattr(replay_command, "LOOK_TIME", 0.0)
    path = tmp_path / "run.mcap"
    write_way(path, seconds=0.3)
    heard: dict[str, list[bytes]] = {"measured_js": [], "servo_jp": [], "manifest": []}
    with RosClient("/listener") as client:
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for name, kind, profile in (
            ("measured_js", JointStateMessage, 10),
            ("servo_jp", JointStateMessage, 10),
            ("manifest", String, kept),
        ):
            client.node.create_subscription(
                kind, f"/again/{name}", heard[name].append, profile, raw=True
            )
        assert main(["replay", str(path), "--ns", "/again", "--rate", "0.2"]) == 0
        eventually(lambda: heard["manifest"], "what was latched")
        eventually(lambda: len(heard["measured_js"]) > 3, "what was measured")
    stamps = [cdr.stamp_of(bytes(data)) for data in heard["measured_js"]]
    assert stamps == sorted(stamps)
    assert {(stamp - BEGIN) % (SECOND // 100) for stamp in stamps} == {0}  # those of then
    assert heard["servo_jp"] == []


def test_where_a_device_is_nothing_is_published(tmp_path, capfd, monkeypatch):
    """It may be found late: when DDS loses the first exchange, after three seconds."""
    monkeypatch.setattr(replay_command, "LOOK_TIME", LONG)
    path = tmp_path / "run.mcap"
    write_way(path)
    with Node("busy") as node:
        make = node.node.create_publisher
        later = threading.Timer(1.5, make, (JointStateMessage, "/busy/measured_js", 10))
        later.start()
        assert main(["replay", str(path), "--ns", "/busy"]) == 2
        later.join()
    assert "a device is there: /busy/measured_js is published" in capfd.readouterr().err


def test_an_arm_goes_the_way_again(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(replay_command, "LONGEST_PAUSE", LONG)  # the machine may be busy
    path = tmp_path / "run.mcap"
    write_way(path)
    # The driver may be held up: the next command that it hears is further on.
    with rig_of("/arm", stream_timeout=5.0, limits={"max_step": 1.0}) as rig:
        arguments = ["replay", str(path), "--ns", "/arm", "--commands", "--timeout", str(LONG)]
        assert main([*arguments, "--yes"]) == 1
        assert "the device is DISABLED" in capfd.readouterr().err
        rig.client.reach("enable", "ENABLED")
        assert main([*arguments, "--rate", "50"]) == 1
        assert "its limit is 1" in " ".join(capfd.readouterr().err.split())
        assert here(rig) == 0.0  # nothing of that moved it
        assert main([*arguments, "--yes"]) == 0
        assert "done" in capfd.readouterr().out
        end = 0.1 + 0.2 * (1.0 - math.cos(0.99))
        # Of a driver that is held up the hold at the end may overtake the last commands.
        eventually(lambda: abs(here(rig) - end) < 0.04, lambda: f"{end}, only {here(rig)}")


def test_another_device_is_not_moved(tmp_path, capfd):
    path = tmp_path / "run.mcap"
    write_way(path, names=("a", "b", "c", "d"))
    with rig_of("/other") as rig:
        rig.client.reach("enable", "ENABLED")
        words = ["--ns", "/other", "--commands", "--yes", "--timeout", str(LONG)]
        assert main(["replay", str(path), *words]) == 1
    assert "it is of another device: a, b, c, d, not x, y, z, yaw" in " ".join(
        capfd.readouterr().err.split()
    )


@pytest.mark.slow
def test_interrupted_it_holds(tmp_path):
    path = tmp_path / "run.mcap"
    write_way(path, seconds=30.0, width=0.01)
    command = [sys.executable, "-m", "crtk_drivers.cli", "replay", str(path), "--ns", "/held"]
    with rig_of("/held") as rig:
        rig.client.reach("enable", "ENABLED")
        child = subprocess.Popen(
            [*command, "--commands", "--yes"], stderr=subprocess.PIPE, text=True
        )
        try:
            stream = rig.session.engine.health
            eventually(lambda: stream().stream == "servo_jp", "it streams")
            child.send_signal(signal.SIGINT)
            _, told = child.communicate(timeout=30.0)
        finally:
            child.kill()
        assert child.returncode == 130, told
        assert "and it stands still" in " ".join(told.split())


@pytest.mark.slow
def test_after_it_stood_still_it_does_not_go_across(tmp_path):
    path = tmp_path / "run.mcap"
    write_way(path, seconds=30.0)
    command = [sys.executable, "-m", "crtk_drivers.cli", "replay", str(path), "--ns", "/still"]
    sent: list[float] = []
    with rig_of("/still") as rig:
        rig.client.node.create_subscription(
            JointStateMessage, "/still/servo_jp", lambda told: sent.append(told.position[0]), 100
        )
        rig.client.reach("enable", "ENABLED")
        child = subprocess.Popen(
            [*command, "--commands", "--yes"], stderr=subprocess.PIPE, text=True
        )
        try:
            eventually(lambda: sent and sent[-1] > 0.2, "it is on its way")
            child.send_signal(signal.SIGSTOP)
            time.sleep(1.0)
            child.send_signal(signal.SIGCONT)
            _, told = child.communicate(timeout=30.0)
        finally:
            child.kill()
        assert child.returncode == 1, told
        assert "this program stood still for" in " ".join(told.split())
    assert max(abs(after - before) for before, after in pairwise(sent)) < 0.02


def test_names_of_topics():
    assert common_namespace(["/a/b/c", "/a/b/d", "/a/b/x/y"]) == "/a/b"
    assert common_namespace(["/a/c", "/b/c"]) == ""
    assert common_namespace([]) == ""
    for topic in ("/a/servo_jp", "/a/local/servo_cp", "/a/state_command", "/a/gripper/move_jp"):
        assert is_command(topic)
    for topic in ("/a/measured_js", "/a/operating_state", "/a/mine", "/tf"):
        assert not is_command(topic)
