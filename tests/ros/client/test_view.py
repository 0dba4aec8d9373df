"""The page of all devices over DDS: what it shows of an arm, what it may command, and when that ends."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import JointState as JointStateMessage

from crtk_drivers.client import state_commands
from crtk_drivers.client.view import pilot as piloting
from crtk_drivers.client.view import watcher as watching
from crtk_drivers.client.view.newest_values import Sampler, Seen
from crtk_drivers.client.view.pilot import MOST_POSES, Pilot, Refused
from crtk_drivers.client.view.watcher import Watcher
from crtk_drivers.device import Capabilities, Steps
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.samples import JointState, Wrench, vector
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice
from rigs.loopback_client import Node
from rigs.loopback_node import serve, slowly
from rigs.view_page import ViewPage, device_of
from rigs.viewed_arm import Viewed, viewed_arm
from rigs.waiting import LONG, eventually

ARM = "/view_arm"
FIRST_JOINT = np.array([1.2, 0.0, 0.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def shared_arm() -> Iterator[Viewed]:
    with viewed_arm(ARM) as viewed:
        yield viewed


@pytest.fixture
def arm(shared_arm: Viewed) -> Viewed:
    shared_arm.ready()
    return shared_arm


@pytest.fixture
def page(arm: Viewed) -> Iterator[ViewPage]:
    with ViewPage(arm.address) as browser:
        browser.until(lambda live: "measured_js" in live["devices"][ARM]["traces"])
        yield browser


def jog(page: ViewPage, press: int, speed: float = 0.5, axis: int = 0, **more: object) -> str:
    asked = {"do": "jog", "device": ARM, "space": "joint", "axis": axis, "speed": speed}
    return page.command(**asked | {"press": press} | more)


def store(page: ViewPage, name: str) -> str:
    """Store a pose as soon as it is known where the arm is; return the answer."""

    def answered() -> tuple[str] | None:
        told = page.command(do="store", device=ARM, name=name)
        return None if "not known now" in told else (told,)

    (answer,) = eventually(answered, "it is known where the arm is")
    return str(answer)


class Pressed:
    """A key that is held: the page says so again and again."""

    def __init__(self, page: ViewPage, press: int, **asked: object) -> None:
        self._page, self._press, self._asked = page, press, asked
        self._up = threading.Event()
        self._thread = threading.Thread(target=self._hold)

    def _hold(self) -> None:
        while not self._up.wait(0.03):
            assert jog(self._page, self._press, **self._asked) == ""  # type: ignore[arg-type]

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_: object) -> None:
        self._up.set()
        self._thread.join()


# ------------------------------------------------------------------------------------------ what is shown


def test_the_chain_of_the_description_leads_to_the_tool(arm: Viewed, page: ViewPage) -> None:
    chain = device_of(page.scene(), ARM)["chain"]
    goal = arm.joints().position + 0.01
    arm.engine.submit("servo_jp", JointState(vector(goal)))
    eventually(lambda: np.allclose(arm.joints().position, goal, atol=1e-3), "it is there")
    arm.stands()
    live = page.until(
        lambda found: np.allclose(found["devices"][ARM]["q"], arm.joints().position, atol=1e-9)
    )["devices"][ARM]
    at = np.eye(4)
    for joint, q in zip(chain["joints"], live["q"], strict=True):
        c, s = np.cos(q), np.sin(q)
        turned = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        at = at @ np.vstack((np.reshape(joint, (3, 4)), (0, 0, 0, 1))) @ turned
    at = at @ np.vstack((np.reshape(chain["tip"], (3, 4)), (0, 0, 0, 1)))
    assert np.allclose(at[:3], np.reshape(live["tool"], (3, 4)), atol=1e-6)


def test_state_values_and_health_are_told(arm: Viewed, page: ViewPage) -> None:
    def told(live: Any) -> bool:
        """What was told before may arrive first."""
        found = live["devices"][ARM]
        status = found["state"], found["level"], found["homed"], found["busy"]
        return status == ("ENABLED", "good", True, False) and bool(found["health"])

    found = page.until(told)["devices"][ARM]
    assert {name for name, _, _ in found["health"]} <= {"device", "bus", "commands"}
    position = next(each for each in found["traces"]["measured_js"] if each[0] == "position")
    assert position[2] == list(arm.engine.capabilities.joints)
    assert position[3] == pytest.approx(arm.joints().position.tolist(), abs=1e-6)


def test_a_sample_is_told_with_its_stamp(page: ViewPage) -> None:
    sampled = page.live()["sampled"]
    assert page.until(lambda live: live["sampled"] > sampled)


def test_other_values_are_shown_when_they_are_asked_for(page: ViewPage) -> None:
    assert "body/measured_cv" not in page.live()["devices"][ARM]["traces"]
    page.send({"watch": [ARM, "body/measured_cv"]})
    traces = page.until(lambda live: "body/measured_cv" in live["devices"][ARM]["traces"])
    parts = traces["devices"][ARM]["traces"]["body/measured_cv"]
    assert [part for part, *_ in parts] == ["linear", "angular"]
    for wrong in ([ARM, "fire"], ["/nobody", "measured_js"]):
        page.send({"watch": wrong})
    assert page.live()["devices"][ARM]["state"] == "ENABLED"


def test_a_refusal_is_shown_with_its_remedy(page: ViewPage) -> None:
    """The range is the device's own check, the same for every client."""
    assert page.command(do="disable", device=ARM) == ""
    page.until(lambda live: live["devices"][ARM]["state"] == "DISABLED")
    assert store(page, "here") == ""
    assert page.command(do="go", device=ARM, name="here") == ""

    def is_told(live: Any) -> bool:
        refused = [command for _, _, command, *_ in live["refusals"]][-1:] == ["move_jp"]
        return refused and any("move to here" in text for _, text in live["notices"])

    _, where, _, message, remedy = page.until(is_told)["refusals"][-1]
    assert where == ARM
    assert message
    assert "enable" in remedy


def test_values_are_left_when_nobody_looks(arm: Viewed, monkeypatch: pytest.MonkeyPatch) -> None:
    (device,) = arm.watcher
    monkeypatch.setattr(watching, "UNWATCHED", 0.0)
    eventually(lambda: not device.look(), "it is not looked at any more")
    monkeypatch.undo()
    with ViewPage(arm.address) as browser:
        browser.until(lambda live: "measured_js" in live["devices"][ARM]["traces"])


def test_a_device_that_is_not_there_is_told() -> None:
    from crtk_drivers.client.view.shown import ShownDevices
    from crtk_drivers.client.view.watcher import Watcher

    with Watcher(["/view_nobody"]) as watcher:
        shown = ShownDevices(watcher, {})
        eventually(
            lambda: shown.live()["devices"]["/view_nobody"]["state"] == "silent", "it is told"
        )
        assert shown.command(1, {"do": "enable", "device": "/view_nobody"}) != ""


def test_another_makers_device_is_found_by_its_topics(shared_arm: Viewed) -> None:
    """One that tells neither a manifest nor a URDF: state, pose, force."""
    from crtk_msgs.msg import OperatingState
    from geometry_msgs.msg import PoseStamped, WrenchStamped

    from crtk_drivers.client.view.shown import ShownDevices
    from crtk_drivers.client.view.watcher import Watcher

    with Node("view_stranger") as other:
        state = other.node.create_publisher(OperatingState, "/view_stranger/operating_state", 1)
        pose = other.node.create_publisher(PoseStamped, "/view_stranger/measured_cp", 1)
        felt = other.node.create_publisher(WrenchStamped, "/view_stranger/measured_cf", 1)

        def tell() -> None:
            now = other.node.get_clock().now().to_msg()
            state.publish(OperatingState(state="ENABLED", is_homed=True))
            place = PoseStamped()
            place.header.stamp = now
            place.pose.position.x, place.pose.orientation.w = 0.25, 1.0
            pose.publish(place)
            force = WrenchStamped()
            force.header.stamp = now
            force.wrench.force.z = -7.0
            felt.publish(force)

        other.node.create_timer(0.05, tell)
        with Watcher() as watcher:
            shown = ShownDevices(watcher, {})

            felt_there = {"at": [0.25, 0.0, 0.0], "vector": [0.0, 0.0, -7.0]}

            def found() -> bool:
                device = shown.live()["devices"].get("/view_stranger", {})
                force = device.get("force")
                return device.get("state") == "ENABLED" and force is not None and "tool" in device

            eventually(found, "the stranger is shown")
            eventually(
                lambda: shown.live()["devices"]["/view_stranger"]["force"] == felt_there,
                "its force",
            )
            eventually(lambda: ARM in shown.live()["devices"], "so is ours")


def test_a_sensor_on_an_arm_is_felt_at_its_tool(arm: Viewed) -> None:
    """The mounting turns the sensor's z into the tool's x."""
    from crtk_drivers.client.view.shown import ShownDevices

    mounting = np.array(
        [[0.0, 0.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.1], [0, 0, 0, 1]]
    )
    shown = ShownDevices(arm.watcher, {"/ft": (ARM, mounting)})
    felt = Wrench(vector([0.0, 0.0, 5.0]), vector([0.0, 0.0, 0.0]))
    pose = arm.engine.feedback("measured_cp")[0]
    seen = {"/ft": {"measured_cf": Seen(felt, 1, 0.0)}, ARM: {"measured_cp": Seen(pose, 1, 0.0)}}
    force = shown._force("/ft", seen)
    assert force is not None
    from crtk_drivers.kinematics.joint_axes import matrix_of

    tool = matrix_of(pose)
    assert np.allclose(force["vector"], 5.0 * tool[:3, 0])
    assert np.allclose(force["at"], (tool @ [0.0, 0.0, 0.1, 1.0])[:3])


def test_a_publisher_never_waits_for_who_looks(arm: Viewed) -> None:
    """A sampled topic asks for no acknowledgements, and keeps the newest only."""
    link = next(iter(arm.watcher)).space.link
    sampler = Sampler(link)
    try:
        from sensor_msgs.msg import JointState as JointMessage

        sampled = sampler.topic(f"{ARM}/measured_js", JointMessage)

        def valid() -> Seen | None:
            seen = sampled.look()
            return seen if seen is not None and seen.wall_ns else None

        first = eventually(valid, "there is a value")
        others = link.inbox(f"{ARM}/measured_js", JointMessage, latched=False)
        eventually(
            lambda: others.latest is not None and others.latest.wall_ns - first.wall_ns > 2e8,
            "twenty values have gone by",
        )
        assert eventually(valid, "the newest").wall_ns - first.wall_ns > 1e8
    finally:
        sampler.close()


# --------------------------------------------------------------------------------------------- commands


def test_it_is_enabled_and_disabled(arm: Viewed, page: ViewPage) -> None:
    assert page.command(do="disable", device=ARM) == ""
    eventually(lambda: arm.engine.status.state == "DISABLED", "it is disabled")
    arm.stands()  # until it has been told so for the second time
    assert page.command(do="enable", device=ARM) == ""
    eventually(lambda: arm.engine.status.state == "ENABLED", "it is enabled")


@pytest.mark.parametrize(
    "wrong",
    [
        {"axis": 99},
        {"axis": -1},
        {"axis": True},
        {"axis": "0"},
        {"speed": 1.5},
        {"speed": "fast"},
        {"speed": None},
        {"speed": 10**400},
        {"space": "moon"},
        {"press": None},
        {"device": "/nobody"},
    ],
)
def test_what_cannot_be_jogged_is_refused_and_moves_nothing(
    arm: Viewed, page: ViewPage, wrong: dict[str, object]
) -> None:
    before = arm.joints().position
    asked = {"do": "jog", "device": ARM, "space": "joint", "axis": 0, "speed": 0.5, "press": 1}
    assert page.command(**asked | wrong) != ""
    assert arm.joints().position == pytest.approx(before, abs=1e-6)


@pytest.mark.parametrize("what", ["fire", "", None, 7, "__init__", "close"])
def test_what_is_no_command_is_refused(page: ViewPage, what: object) -> None:
    assert page.command(do=what, device=ARM) != ""


@pytest.mark.parametrize(("space", "axis"), [("joint", 1), ("tool", 2)])
def test_it_jogs_while_the_key_is_pressed_and_stands_when_it_is_let_go(
    arm: Viewed, page: ViewPage, space: str, axis: int
) -> None:
    with Pressed(page, 1, space=space, axis=axis):
        arm.moves()
    assert page.command(do="release", device=ARM) == ""
    arm.stands()
    assert not any("heard" in text for _, text in page.live()["notices"])


def test_a_page_that_falls_silent_ends_the_jog(
    arm: Viewed, page: ViewPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection stays open: nothing but the dead-man's time tells, longer here for busy machines."""
    monkeypatch.setattr(piloting, "DEADMAN", 1.0)
    with Pressed(page, 2):
        arm.moves()
    arm.stands()
    told = "nothing was heard of the page for 1 s"
    page.until(lambda live: any(told in text for _, text in live["notices"]))


def test_a_page_that_dies_while_it_jogs_leaves_the_arm_standing(arm: Viewed) -> None:
    dying = ViewPage(arm.address)
    with Pressed(dying, 3):
        arm.moves()
    dying.socket.socket.shutdown(2)
    arm.stands()


@pytest.mark.slow
def test_the_server_of_the_page_dies_while_it_jogs() -> None:
    with viewed_arm("/view_killed") as other, ViewPage(other.address) as browser:
        other.ready()
        jogging = {"do": "jog", "device": "/view_killed", "space": "joint", "axis": 0}
        for _ in range(4):
            assert browser.command(**jogging, speed=0.5, press=1) == ""
            time.sleep(0.05)
        os.kill(other.page.pid, signal.SIGKILL)
        assert other.shown.is_over.wait(30.0)
        other.stands()


def test_hold_ends_the_jog_of_another_page_which_must_press_anew(
    arm: Viewed, page: ViewPage
) -> None:
    with ViewPage(arm.address) as other, Pressed(other, 4):
        arm.moves()
        assert page.command(do="hold") == ""
        arm.stands()  # the key is still pressed
    with ViewPage(arm.address) as other, Pressed(other, 5):
        arm.moves()
    arm.stands()


def test_a_home_that_takes_long_is_held_when_its_page_has_gone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However long: a client waits for a minute, by itself."""

    class Homing(LoopbackDevice):
        @property
        def capabilities(self) -> Capabilities:
            return replace(super().capabilities, transition_timeout=10.0 * LONG)

        def home(self) -> Steps:
            while True:
                yield

    is_late, seen = threading.Event(), threading.Event()

    def now() -> float:
        if not is_late.is_set():
            return time.monotonic()
        seen.set()
        return time.monotonic() + 100.0

    monkeypatch.setattr(state_commands, "time", SimpleNamespace(monotonic=now))
    told: list[str] = []
    plugin = replace(PLUGIN, create=Homing)
    with (
        serve(LoopbackConfig(needs_homing=True), "/view_homing", [], plugin=plugin) as (session, _),
        Watcher(["/view_homing"]) as watcher,
    ):
        engine = session.engine
        eventually(lambda: engine.connected, "it is connected")
        engine.state_command("enable")
        eventually(lambda: engine.status.state == "ENABLED", "it is enabled")
        pilot = Pilot(next(iter(watcher)), told.append)
        eventually(lambda: "home" in pilot.actions, "it can be homed")
        pilot.prepare()
        pilot.do("home", 1, {})
        eventually(pilot._device.is_busy, "it homes")
        is_late.set()
        assert seen.wait(LONG)
        pilot.gone(1)
        eventually(lambda: not engine.status.is_busy, "it is held")
        assert told[0] == "/view_homing: home is held: the page has gone"
        assert engine.status.state == "ENABLED"
        pilot.close()


def test_only_one_page_jogs(arm: Viewed, page: ViewPage) -> None:
    with ViewPage(arm.address) as other, Pressed(other, 6):
        arm.moves()
        assert "another page" in jog(page, 7)
    arm.stands()


def test_a_press_that_was_ended_does_not_jog_on_after_another_page_has(
    arm: Viewed, page: ViewPage
) -> None:
    with ViewPage(arm.address) as other:
        with Pressed(other, 1):
            arm.moves()
            assert page.command(do="hold") == ""
            arm.stands()
        with Pressed(page, 1):
            arm.moves()
        assert page.command(do="release", device=ARM) == ""
        arm.stands()
        before = arm.joints().position
        for _ in range(5):
            assert jog(other, 1) == ""  # its key was never let go
            time.sleep(0.03)
        arm.stands()
        assert arm.joints().position == pytest.approx(before, abs=1e-3)


def test_hold_stops_a_move_too_that_is_sent_after_it(arm: Viewed, page: ViewPage) -> None:
    """As the first one is, which waits until both ends have met."""
    pilot = arm.shown._pilots[ARM]
    goal, sent, over = (
        vector(arm.joints().position + FIRST_JOINT),
        threading.Event(),
        threading.Event(),
    )

    def late() -> None:
        sent.wait(LONG)
        try:
            pilot._device.move_jp(goal).wait()
        finally:
            over.set()

    pilot._begin(0, "a late move", late)
    assert page.command(do="hold", device=ARM) == ""
    page.until(lambda live: not live["devices"][ARM]["busy"])
    with slowly(arm.engine):
        sent.set()
        assert over.wait(LONG)
        arm.stands()
    assert not np.allclose(arm.joints().position, goal, atol=0.1)


def test_what_ends_a_move_is_commanded_again_also_if_it_failed_at_first(arm: Viewed) -> None:
    pilot = arm.shown._pilots[ARM]
    over, again = threading.Event(), threading.Event()
    tried: list[bool] = []

    def command() -> None:
        tried.append(True)
        if len(tried) == 1:
            raise ConnectionLost("nobody listens")
        again.set()

    pilot._begin(0, "a move", lambda: over.wait(LONG))
    try:
        pilot._insist("hold", command)
        assert again.wait(LONG)
    finally:
        over.set()


def test_a_move_that_nothing_is_heard_of_is_held_too_when_its_page_goes(
    arm: Viewed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody waits for it any more; the device may go on."""
    pilot = arm.shown._pilots[ARM]
    held = threading.Event()

    def move() -> None:
        raise ConnectionLost("nothing is heard of it")

    monkeypatch.setattr(pilot, "_device", SimpleNamespace(hold=held.set))
    monkeypatch.setattr(pilot, "_activity", None)
    pilot._begin(1, "a move", move)
    pilot._activity.thread.join(LONG)
    pilot.gone(1)
    assert held.wait(LONG)


def test_hold_ends_also_what_another_page_begins_in_that_moment(
    arm: Viewed, page: ViewPage, monkeypatch: pytest.MonkeyPatch
) -> None:
    pilot = arm.shown._pilots[ARM]
    spawn, end_jog, holds = pilot._spawn, pilot._end_jog, []
    has_begun, is_spawned, is_insisted = (threading.Event() for _ in range(3))
    holding = threading.Thread(target=pilot.hold, args=("hold",))

    def ended(why: str) -> None:
        end_jog(why)
        has_begun.set()
        is_spawned.wait(LONG)

    def interleaved(name: str, work: Any) -> threading.Thread:
        made = spawn(name, work)
        if name == "a move":
            is_spawned.set()
            holding.join(0.05)
        return made

    def held() -> None:
        holds.append(True)
        if len(holds) > 2:  # as often as it takes, not once
            is_insisted.set()

    monkeypatch.setattr(pilot, "_end_jog", ended)
    monkeypatch.setattr(pilot, "_spawn", interleaved)
    monkeypatch.setattr(pilot, "_device", SimpleNamespace(hold=held))
    holding.start()
    assert has_begun.wait(LONG)
    pilot._begin(0, "a move", lambda: is_insisted.wait(LONG))
    holding.join(LONG)
    assert is_insisted.wait(0.5 * LONG)
    eventually(lambda: not pilot._activity or not pilot._activity.thread.is_alive(), "it has ended")


def test_it_goes_to_a_pose_that_was_stored_and_hold_stops_it(arm: Viewed, page: ViewPage) -> None:
    start = arm.joints().position
    assert store(page, "start") == ""
    page.until(lambda scene: "start" in device_of(scene, ARM)["poses"], ViewPage.scene)
    arm.engine.submit("move_jp", JointState(vector(start + FIRST_JOINT)))
    arm.moves(start)
    arm.stands()
    far = arm.joints().position
    with slowly(arm.engine):
        assert page.command(do="go", device=ARM, name="start") == ""
        arm.moves(far)
        assert "not over yet" in page.command(do="go", device=ARM, name="start")
        assert page.command(do="hold", device=ARM) == ""
        arm.stands()
    assert not np.allclose(arm.joints().position, start, atol=0.01)
    assert not np.allclose(arm.joints().position, far, atol=9e-4)
    eventually(lambda: page.command(do="go", device=ARM, name="start") == "", "it may go again")
    eventually(lambda: np.allclose(arm.joints().position, start, atol=1e-3), "it is there")
    arm.stands()


@pytest.mark.parametrize("tokens", [[], ["another"]])
def test_a_move_is_held_when_the_page_goes_that_began_it(arm: Viewed, tokens: list[str]) -> None:
    start = arm.joints().position
    with ViewPage(arm.address) as going:
        going.until(lambda live: "measured_js" in live["devices"][ARM]["traces"])
        assert store(going, "near") == ""
        arm.engine.submit("move_jp", JointState(vector(start - FIRST_JOINT)))
        arm.moves(start)
        arm.stands()
        far = arm.joints().position
        with slowly(arm.engine):
            eventually(
                lambda: going.command(do="go", device=ARM, name="near") == "", "none is left"
            )
            arm.moves(far)
            for token in tokens:
                assert going.ask({"token": token}) == {"control": False}
            going.close()
            arm.stands()
    assert not np.allclose(arm.joints().position, start, atol=0.01)


def test_where_a_silent_device_was_is_no_pose() -> None:
    """It may have been moved since."""
    with Node("view_frozen") as other:
        topic = "/view_frozen/measured_js"
        measured = other.node.create_publisher(JointStateMessage, topic, 1)
        other.node.create_subscription(JointStateMessage, "/view_frozen/move_jp", id, 1)
        silent = threading.Event()

        def tell() -> None:
            if silent.is_set():
                return
            here = JointStateMessage(name=["a", "b"], position=[0.1, 0.2])
            here.header.stamp = other.node.get_clock().now().to_msg()
            measured.publish(here)

        other.node.create_timer(0.02, tell)
        with Watcher(["/view_frozen"]) as watcher:
            (device,) = watcher
            pilot = Pilot(device, id)

            def is_refused() -> bool:
                watcher.looked()
                try:
                    pilot.do("store", 1, {"name": "here"})
                except Refused as refused:
                    return "not known now" in str(refused)
                return False

            eventually(lambda: not is_refused(), "it tells where it is")
            assert pilot.poses == ("here",)
            silent.set()
            eventually(is_refused, "nobody knows any more")


def test_poses_have_names_and_are_not_without_end(arm: Viewed, page: ViewPage) -> None:
    for wrong in ("", " ", "x" * 41, None, 7):
        assert page.command(do="store", device=ARM, name=wrong) != ""
    assert "no pose" in page.command(do="go", device=ARM, name="nowhere")
    answers = [store(page, f"p{i}") for i in range(MOST_POSES + 1)]
    assert "already" in answers[-1]


def test_what_is_not_enabled_does_not_jog_and_says_why(arm: Viewed, page: ViewPage) -> None:
    arm.engine.state_command("disable")
    eventually(lambda: arm.engine.status.state == "DISABLED", "it is disabled")
    before = arm.joints().position
    for _ in range(8):
        jog(page, 8)
        time.sleep(0.03)
    page.until(lambda live: live["refusals"] and live["refusals"][-1][2] in ("servo_jv", "hold"))
    assert arm.joints().position == pytest.approx(before, abs=1e-6)
