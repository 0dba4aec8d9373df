"""The page of a device: what it tells the browser, when it asks for it, and that nothing of it is left."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

import crtk_drivers
from bench.browser import BROWSER, Browser
from crtk_drivers import plugins
from crtk_drivers.device import Note, Severity
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, ConnectionFailed, PluginError
from crtk_drivers.errors.wording import SCRIPT
from crtk_drivers.front import LocalDevice
from crtk_drivers.session.scene import DeviceScene
from crtk_drivers.testing.loopback import LoopbackDevice
from crtk_sim_backends.page.device import PAGE
from crtk_sim_backends.page.server import PERIOD
from crtk_sim_backends.page.source import LIVE, SCENE
from rigs.waiting import LONG, eventually

DEGREES = 180.0 / np.pi


def ask(address: str, path: str, body: str | None = None, **headers: str) -> tuple[int, bytes]:
    connection = http.client.HTTPConnection(address.split("/")[2], timeout=LONG)
    with contextlib.closing(connection):
        connection.request("GET" if body is None else "POST", path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


class Events:
    """A browser that looks."""

    def __init__(self, address: str) -> None:
        self._connection = http.client.HTTPConnection(address.split("/")[2], timeout=LONG)
        self._connection.request("GET", "/events")
        self._answer = self._connection.getresponse()
        assert self._answer.status == 200

    def next(self) -> Any:
        line = self._answer.readline()
        assert line.startswith(b"data: "), line
        assert self._answer.readline() == b"\n"
        return json.loads(line[6:])

    def until(self, test: Callable[[Any], bool]) -> Any:
        deadline = time.monotonic() + LONG
        while not test(found := self.next()):
            assert time.monotonic() < deadline, found
        return found

    def __enter__(self) -> Events:
        return self

    def __exit__(self, *_: object) -> None:
        self._answer.close()
        self._connection.close()


@pytest.fixture(scope="module")
def arm() -> Iterator[LocalDevice]:
    options = {
        "model": "seven_axis",
        "rate": 100.0,
        "needs_homing": True,
        "web": True,
        "web_port": 0,
    }
    with crtk_drivers.connect("virtual", transition_time=0.0, **options) as opened:
        yield opened


@pytest.fixture(scope="module")
def gantry() -> Iterator[LocalDevice]:
    with crtk_drivers.connect("loopback", web=True, web_port=0) as opened:
        yield opened


def rows(found: Any, section: str) -> dict[str, tuple[str, str]]:
    return {name: (text, level) for name, text, level in found["sections"][section]}


# ---------------------------------------------------------------------------------------- what is shown


def test_the_page_is_that_of_the_simulators(arm: LocalDevice) -> None:
    status, body = ask(arm.page, "/")
    assert status == 200
    assert b'<section id="faults">' in body


def test_the_arm_comes_with_the_chain_of_its_joints(arm: LocalDevice) -> None:
    scene = json.loads(ask(arm.page, "/scene.json")[1])
    assert (scene["title"], scene["detail"], scene["buttons"]) == ("virtual", "CRTK device", [])
    with Events(arm.page) as events:
        live = events.next()
    tip = np.eye(4)
    for joint, angle in zip(scene["chain"]["joints"], live["q"], strict=True):
        c, s = np.cos(angle), np.sin(angle)
        turned = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        tip = tip @ np.vstack((np.reshape(joint, (3, 4)), (0, 0, 0, 1))) @ turned
    tip = tip @ np.vstack((np.reshape(scene["chain"]["tip"], (3, 4)), (0, 0, 0, 1)))
    assert tip[:3, 3] == pytest.approx(arm.measured_cp().position, abs=1e-6)
    assert live["tool"] == [0.0] * 6


def test_joints_stand_between_their_limits_with_what_they_are_sent(arm: LocalDevice) -> None:
    arm.disable()
    with Events(arm.page) as events:
        (joints,) = events.next()["gauges"]
        assert (joints["title"], joints["unit"], joints["rate"]) == ("Joints", "deg", "deg/s")
        assert [each["goal"] for each in joints["gauges"]] == [None] * 7
        arm.enable()
        arm.home()
        position = arm.measured_js().position
        arm.servo_jp(position + 0.01)
        goal = pytest.approx((position + 0.01) * DEGREES)
        found = events.until(
            lambda live: [each["goal"] for each in live["gauges"][0]["gauges"]] == goal
        )
    limits = arm.engine.capabilities.limits
    for gauge, name, limit in zip(
        found["gauges"][0]["gauges"], arm.engine.capabilities.joints, limits, strict=True
    ):
        assert gauge["name"] == name
        assert gauge["low"] == pytest.approx(limit.lower * DEGREES)
        assert gauge["high"] == pytest.approx(limit.upper * DEGREES)
        assert gauge["state"][0].endswith(" N·m")
    arm.hold()


def test_state_homing_wrench_and_counters_are_told(arm: LocalDevice) -> None:
    arm.disable()
    arm.unhome()
    with Events(arm.page) as events:
        live = events.until(lambda live: rows(live, "State")["homed"][0] == "no")
        assert rows(live, "State") == {
            "state": ("DISABLED", ""),
            "homed": ("no", "fair"),
            "busy": ("no", ""),
            "reason": ("none", ""),
        }
        assert rows(live, "Tool")["force, N"] == ("0.0  0.0  0.0", "")
        assert rows(live, "Tool")["position, m"][0].count(".") == 3
        with pytest.raises(CommandRefused):
            arm.move_jp(np.zeros(7))
        live = events.until(lambda live: rows(live, "Health")["refused"][0] != "none")
        assert "the device is DISABLED" in rows(live, "Health")["refused"][0]
        assert rows(live, "Health")["rate"][0].endswith("of 100 Hz")
        assert "plant time" in rows(live, "Device")["counters"][0]
        arm.enable()
        events.until(lambda live: rows(live, "State")["state"] == ("ENABLED", "good"))


def test_names_of_rows_are_there_once_and_notes_are_of_rows(arm: LocalDevice) -> None:
    with Events(arm.page) as events:
        names = [name for each in events.next()["sections"].values() for name, _, _ in each]
    assert len(set(names)) == len(names)
    assert set(json.loads(ask(arm.page, "/scene.json")[1])["notes"]) <= set(names)


def test_joints_that_slide_have_gauges_of_their_own_and_no_picture(gantry: LocalDevice) -> None:
    assert json.loads(ask(gantry.page, "/scene.json")[1])["chain"] is None
    gantry.enable()
    gantry.move_jp([0.02, 0.0, 0.0, 0.1]).wait()
    with Events(gantry.page) as events:
        sliding, turning = events.next()["gauges"]
    assert (sliding["title"], sliding["unit"]) == ("Sliding joints", "mm")
    assert [each["name"] for each in sliding["gauges"]] == ["x", "y", "z"]
    assert (sliding["gauges"][0]["low"], sliding["gauges"][0]["high"]) == (-1000.0, 1000.0)
    assert sliding["gauges"][0]["value"] == pytest.approx(20.0, abs=2.0)
    assert sliding["gauges"][0]["goal"] == pytest.approx(20.0, abs=0.1)
    assert (turning["title"], turning["unit"]) == ("Joints", "deg")
    assert turning["gauges"][0]["goal"] == pytest.approx(0.1 * DEGREES, abs=0.01)


def test_what_is_old_is_told_as_not_valid(gantry: LocalDevice) -> None:
    device = gantry.engine.device
    assert isinstance(device, LoopbackDevice)
    with Events(gantry.page) as events:
        device.reachable = False
        live = events.until(lambda live: rows(live, "State")["state"] == ("FAULT", "bad"))
        assert "the link is gone" in rows(live, "State")["reason"][0]
        assert live["gauges"][0]["gauges"][0]["state"] == ["not valid now", "bad"]
        assert rows(live, "Tool")["position, m"][1] == "bad"
        device.reachable = True
        events.until(lambda live: rows(live, "State")["state"] == ("DISABLED", ""))


def test_a_sensor_has_its_wrench_as_gauges_whose_scale_holds_it() -> None:
    options = {"load": "constant:fz=-20,ty=2"}
    with (
        crtk_drivers.connect(
            "ati-netft", sim=True, sim_options=options, web=True, web_port=0
        ) as it,
        Events(it.page) as events,
    ):
        assert json.loads(ask(it.page, "/scene.json")[1])["detail"] == "simulated"
        force, torque = events.next()["gauges"]
    assert [each["value"] for each in force["gauges"]] == pytest.approx([0, 0, -20], abs=0.5)
    assert [each["value"] for each in torque["gauges"]] == pytest.approx([0, 2, 0], abs=0.1)
    assert {each["span"] for each in force["gauges"]} <= {20.0, 50.0}
    assert {each["span"] for each in torque["gauges"]} <= {2.0, 5.0}


def test_devices_behind_it_are_shown_by_their_names() -> None:
    behind = Engine(LoopbackDevice(), "gripper")
    shown = DeviceScene(Engine(LoopbackDevice(), "gantry"), {"gripper": behind}, "CRTK device")
    live, scene = shown.live(), shown.scene()
    assert live["gauges"] == [], "nothing was read yet"
    assert rows(live, "gripper State")["gripper state"] == ("connecting", "fair")
    assert rows(live, "State")["state"] == ("connecting", "fair")
    assert set(scene["notes"]) == {"cycles", "gripper cycles"}
    assert scene["title"] == "gantry"


def test_commands_on_the_page_are_those_that_work_here(monkeypatch: pytest.MonkeyPatch) -> None:
    note = Note(Severity.WARNING, "arm", "Calibrate again: crtk-driver arm calibrate")
    shown = DeviceScene(Engine(LoopbackDevice(), "gantry"), {}, "CRTK device")
    monkeypatch.setenv(SCRIPT, "../crtk-driver")
    monkeypatch.setattr(LoopbackDevice, "notes", (note,))
    assert rows(shown.live(), "Device")["notes"] == (
        "Calibrate again: ../crtk-driver arm calibrate",
        "fair",
    )


def test_the_title_is_model_and_namespace() -> None:
    device = LoopbackDevice()
    known = replace(device.capabilities, model="Gantry 3")
    with patch.object(LoopbackDevice, "capabilities", known):
        shown = DeviceScene(Engine(device, "gantry"), {}, "CRTK device")
        shown.place = "/lab/gantry"
        assert shown.scene()["title"] == "Gantry 3 · /lab/gantry"


# ------------------------------------------------------------------------------- who may, and who is asked


def test_the_page_only_looks_and_has_no_token(arm: LocalDevice) -> None:
    assert arm.page.endswith("/")
    status, reason = ask(arm.page, "/inject", "{}", **{"Content-Type": "application/json"})
    assert (status, reason) == (405, b"this page only looks")


def test_only_requests_for_its_own_name_are_answered(arm: LocalDevice) -> None:
    for path in ("/", "/scene.json", "/events"):
        assert ask(arm.page, path, Host="evil.example")[0] == 421


class Counted:
    """Something that is shown, and counts how often it is asked for."""

    def __init__(self) -> None:
        self.asked = {SCENE: 0, LIVE: 0}
        self.free = threading.Event()
        self.free.set()
        self.failure = ""

    def scene(self) -> dict[str, Any]:
        return self._told(SCENE)

    def live(self) -> dict[str, Any]:
        return self._told(LIVE)

    def _told(self, what: str) -> dict[str, Any]:
        self.asked[what] += 1
        self.free.wait(LONG)
        if self.failure:
            raise ZeroDivisionError(self.failure)
        return {"title": what, "number": self.asked[what]}


@pytest.fixture
def counted() -> Iterator[tuple[Counted, str]]:
    shown = Counted()
    page = PAGE.serve(shown, 0)
    yield shown, page.address
    shown.free.set()
    page.stop()


def test_nothing_is_asked_for_while_nobody_looks(counted: tuple[Counted, str]) -> None:
    shown, address = counted
    for path in ("/", "/view.js", "/nothing"):
        ask(address, path)
    assert shown.asked == {SCENE: 0, LIVE: 0}
    with Events(address) as events:
        for _ in range(3):
            events.next()
    assert shown.asked[LIVE] >= 3
    quiet = threading.Event()

    def is_quiet() -> bool:
        before = shown.asked[LIVE]
        quiet.wait(10 * PERIOD)
        return shown.asked[LIVE] == before

    eventually(is_quiet)
    assert shown.asked[SCENE] == 0


def test_many_who_look_ask_no_more_often_than_one(counted: tuple[Counted, str]) -> None:
    shown, address = counted
    with contextlib.ExitStack() as stack:
        begun = time.monotonic()
        several = [stack.enter_context(Events(address)) for _ in range(6)]
        for _ in range(5):
            numbers = [events.next()["number"] for events in several]
        assert max(numbers) >= 5
        asked, elapsed = shown.asked[LIVE], time.monotonic() - begun
    assert asked <= 1 + elapsed / PERIOD


def test_what_cannot_be_shown_is_told_once_and_ends_nothing(
    counted: tuple[Counted, str], caplog: pytest.LogCaptureFixture
) -> None:
    shown, address = counted
    shown.failure = "no picture today"
    for _ in range(3):
        assert ask(address, "/scene.json") == (
            502,
            b"ZeroDivisionError: no picture today",
        )
    assert caplog.text.count("the page has no picture") == 1
    shown.failure = ""
    assert json.loads(ask(address, "/scene.json")[1])["title"] == SCENE


def test_a_process_that_hangs_is_told_and_comes_back(counted: tuple[Counted, str]) -> None:
    shown, address = counted
    with Events(address) as events:
        before = events.next()["number"]
        shown.free.clear()
        events.until(lambda found: found is None)
        shown.free.set()
        found = events.until(lambda found: found is not None)
    assert found["number"] > before + 1, "the answer that came too late is left out"


# ------------------------------------------------------------------------------------------ beginning, end


def is_closed(address: str) -> bool:
    host, port = address.split("/")[2].split(":")
    try:
        socket.create_connection((host, int(port)), 1.0).close()
    except ConnectionRefusedError:
        return True
    return False


def page_threads() -> list[str]:
    return [each.name for each in threading.enumerate() if each.name == "page"]


def test_the_page_ends_with_the_session() -> None:
    threads, files = page_threads(), len(os.listdir("/proc/self/fd"))
    with crtk_drivers.connect("loopback", web=True, web_port=0) as opened:
        address = opened.page
        with Events(address) as events:
            events.next()
            assert len(page_threads()) == len(threads) + 1
            opened.close()
    eventually(lambda: is_closed(address))
    eventually(lambda: page_threads() == threads)
    eventually(lambda: len(os.listdir("/proc/self/fd")) <= files)


def test_without_being_asked_for_there_is_none() -> None:
    with crtk_drivers.connect("loopback") as opened:
        assert opened.page == ""


def test_a_page_that_is_killed_leaves_the_device_alone(caplog: pytest.LogCaptureFixture) -> None:
    with crtk_drivers.connect("loopback", web=True, web_port=0) as opened:
        page: Any = opened._session.page
        os.kill(page.pid, signal.SIGKILL)
        eventually(lambda: f"the page at {opened.page} has ended" in caplog.text)
        opened.enable()
        assert opened.measured_js(age=1.0).position.size == 4


def test_a_port_in_use_is_an_error_that_says_what_to_do() -> None:
    threads, files = page_threads(), len(os.listdir("/proc/self/fd"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(ConnectionFailed) as caught:
            crtk_drivers.connect("loopback", web=True, web_port=port)
    assert f"cannot bind the web port 127.0.0.1:{port}: it is in use" in str(caught.value)
    assert "choose another one with web_port (0: any free one)" in str(caught.value)
    eventually(lambda: page_threads() == threads)
    eventually(lambda: len(os.listdir("/proc/self/fd")) <= files)


def test_without_the_package_that_brings_it_the_reason_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(plugins.ONLY, "loopback")
    with pytest.raises(PluginError, match=r"there is no page 'web'.*Installed: none"):
        crtk_drivers.connect("loopback", web=True, web_port=0)


# ------------------------------------------------------------------------------------------------ browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if BROWSER is None:
        pytest.skip("needs chromium (or CRTK_BROWSER, the path of one)")
    profile: Path = tmp_path_factory.mktemp("browser")
    with Browser(profile) as opened:
        yield opened


DRAWN = """(() => {
  const canvas = document.getElementById("picture");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return data.filter((value, i) => i % 4 === 3 && value).length;
})()"""


def test_the_arm_is_drawn_without_buttons(browser: Browser, arm: LocalDevice) -> None:
    browser.open(arm.page)
    browser.until(f"{DRAWN} > 5000")
    assert browser.run("document.getElementById('title').textContent") == "virtual"
    assert browser.run("document.getElementById('detail').textContent").startswith(
        "CRTK device, at"
    )
    assert browser.run("getComputedStyle(document.getElementById('faults')).display") == "none"
    assert browser.run("document.querySelectorAll('.gauge').length") == 7
    assert browser.problems == []


def test_a_browser_is_told_why_there_is_nothing_to_see(
    browser: Browser, counted: tuple[Counted, str]
) -> None:
    shown, address = counted
    shown.failure = "no picture today"
    browser.call("Page.navigate", url=address)
    browser.until(
        "document.getElementById('link')?.textContent === 'ZeroDivisionError: no picture today'"
    )
    browser.problems.clear()  # the answer was an error


def test_without_a_chain_gauges_take_its_place(browser: Browser, gantry: LocalDevice) -> None:
    browser.open(gantry.page)
    browser.until("document.querySelectorAll('#gauges .gauge').length === 4")
    assert browser.run("document.getElementById('picture').hidden") is True
    assert browser.problems == []
