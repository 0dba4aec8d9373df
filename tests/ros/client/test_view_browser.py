"""The page of all devices in a browser without a window: what is drawn, and that hold stops the arm."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.browser import BROWSER, Browser
from crtk_drivers.samples import JointState, vector
from rigs.loopback_node import slowly
from rigs.viewed_arm import Viewed, viewed_arm
from rigs.waiting import eventually

ARM = "/view_browser"
FAR = np.array([1.2, 0.0, 0.0, 0.0, 0.0, 0.0])
CARD = "card-view-browser"
DRAWN = """(() => {
  const canvas = document.getElementById("picture");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  return data.filter((value, i) => i % 4 === 3 && value).length;
})()"""
PLUS = 'document.querySelector(\'[data-space=joint][data-axis="0"][data-sign="1"]\')'


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if BROWSER is None:
        pytest.skip("needs chromium (or CRTK_BROWSER, the path of one)")
    profile: Path = tmp_path_factory.mktemp("browser")
    with Browser(profile) as opened:
        yield opened


@pytest.fixture(scope="module")
def shared_arm(browser: Browser) -> Iterator[Viewed]:
    with viewed_arm(ARM) as viewed:
        yield viewed


@pytest.fixture
def arm(shared_arm: Viewed, browser: Browser) -> Viewed:
    shared_arm.ready()
    browser.open(shared_arm.address)
    browser.until(f"{PLUS} !== null")
    browser.problems.clear()
    return shared_arm


def press(browser: Browser, element: str, kind: str = "mousePressed") -> None:
    """Press the left button in the middle of an element, or let it go there."""
    browser.run(f"{element}.scrollIntoView({{block: 'center'}})")
    x, y = browser.run(
        f"(({{left, top, width, height}}) => [left + width / 2, top + height / 2])"
        f"({element}.getBoundingClientRect())"
    )
    browser.call(
        "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1
    )


def test_the_arm_is_drawn_with_its_state_and_its_values(browser: Browser, arm: Viewed) -> None:
    browser.until(f"{DRAWN} > 5000")
    browser.until(f"document.getElementById('{CARD}-state').textContent === 'ENABLED'")
    gauges = f"document.querySelectorAll('#{CARD} .gauge').length"
    assert browser.until(gauges) >= len(arm.engine.capabilities.joints)
    browser.until("document.querySelector('#chosen button')?.textContent.endsWith('position')")
    assert browser.run("location.hash") == ""  # the token is not in the address any more
    assert browser.problems == []


def test_nothing_is_asked_of_another_host(browser: Browser, arm: Viewed) -> None:
    names = "performance.getEntriesByType('resource').map(({ name }) => name)"
    for each in browser.run(names):
        assert each.startswith(arm.page.address)


def test_a_moving_arm_is_stopped_by_a_press_of_hold(browser: Browser, arm: Viewed) -> None:
    start = arm.joints().position
    with slowly(arm.engine):
        arm.engine.submit("move_jp", JointState(vector(start + FAR)))
        arm.moves(start)
        for kind in ("mousePressed", "mouseReleased"):
            press(browser, "document.getElementById('hold')", kind)
        arm.stands()
    assert 0.0 < arm.joints().position[0] - start[0] < 1.19


def test_it_jogs_as_long_as_the_button_is_pressed(browser: Browser, arm: Viewed) -> None:
    press(browser, PLUS)
    arm.moves()
    browser.until(f"document.getElementById('{CARD}-state').textContent.endsWith('jogged')")
    press(browser, PLUS, "mouseReleased")
    arm.stands()


@pytest.mark.slow
@pytest.mark.parametrize(
    "leave",
    [
        "dispatchEvent(new Event('blur'))",
        "Object.defineProperty(document, 'hidden', {value: true, configurable: true}),"
        "document.dispatchEvent(new Event('visibilitychange'))",
    ],
)
def test_a_window_that_is_left_ends_the_jog(browser: Browser, arm: Viewed, leave: str) -> None:
    press(browser, PLUS)
    arm.moves()
    browser.run(leave)
    arm.stands()
    press(browser, PLUS, "mouseReleased")


@pytest.mark.slow
def test_a_page_that_is_closed_ends_the_jog(browser: Browser, arm: Viewed) -> None:
    press(browser, PLUS)
    arm.moves()
    browser.call("Page.navigate", url="about:blank")
    arm.stands()
    eventually(lambda: not any(pilot.jogs for pilot in arm.shown._pilots.values()), "it is over")


def test_without_the_token_there_are_no_buttons(browser: Browser, arm: Viewed) -> None:
    browser.run("sessionStorage.clear()")
    browser.open(arm.page.address)
    browser.until(f"document.getElementById('{CARD}-state')?.textContent === 'ENABLED'")
    assert browser.run("getComputedStyle(document.getElementById('hold')).display") == "none"
    assert browser.run(f"document.querySelectorAll('#{CARD} button').length") == 0


def test_a_refusal_stands_there_with_its_remedy(browser: Browser, arm: Viewed) -> None:
    arm.engine.submit("servo_jp", JointState(vector(arm.joints().position)))
    arm.stands()
    with pytest.raises(Exception, match="refused"):
        arm.engine.submit("move_jp", JointState(vector(np.full(6, 100.0))))
    browser.until("document.getElementById('told').textContent.includes('refused move_jp')")
    browser.until(
        "[...document.querySelectorAll('#told em')].some((each) => each.textContent.includes('limits'))"
    )
