"""What the page of all devices costs, how late its pictures are, and how soon a jog ends.

A virtual arm at 500 Hz that moves, and a simulated force sensor; `crtk-driver view` beside them. Browsers are
Chromium without a window where there is one, and programs that ask for pictures as a browser does.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from bench import report
from bench.browser import BROWSER, Browser
from bench.processes import CRTK_DRIVER, Usage, child_running, usage
from crtk_drivers import client

ARM, SENSOR = "/view_arm", "/view_ft"
AGAIN: Final = 0.05
"""Seconds between two words of a page that jogs."""
STANDS: Final = 1e-4
"""rad/s under which the arm stands."""


class Page:
    """A program that looks as a browser does."""

    def __init__(self, address: str) -> None:
        parts = urlsplit(address)
        self.socket = connect(
            f"ws://{parts.netloc}/socket",
            additional_headers={"Origin": f"http://{parts.netloc}"},
            proxy=None,
            max_size=None,
        )
        if parts.fragment:
            self.ask({"token": parts.fragment})

    def ask(self, message: object) -> Any:
        """Return the answer."""
        self.socket.send(json.dumps(message))
        return json.loads(self.socket.recv(timeout=30.0))


@contextmanager
def running(*arguments: str, folder: str | None = None) -> Iterator[subprocess.Popen[str]]:
    """Run `crtk-driver` with these arguments, in a folder."""
    process = subprocess.Popen(
        [*CRTK_DRIVER, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=folder,
    )
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def address_of(view: subprocess.Popen[str]) -> str:
    """Return the address that it tells."""
    assert view.stdout is not None
    return view.stdout.readline().strip()


@contextmanager
def looking(address: str, count: int) -> Iterator[list[float]]:
    """Let so many programs look, and collect how old the samples are when their picture arrives, s."""
    over, ages = threading.Event(), list[float]()

    def look() -> None:
        page = Page(address)
        with suppress(ConnectionClosed):
            while not over.is_set():
                sampled = page.ask({"look": True})["live"]["sampled"]
                ages.append(time.time() - 1e-3 * sampled)
        page.socket.close()

    threads = [threading.Thread(target=look) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        yield ages
    finally:
        over.set()
        for thread in threads:
            thread.join()


@contextmanager
def swinging(arm: client.RemoteDevice) -> Iterator[None]:
    """Let the arm move to and fro."""
    over = threading.Event()
    home = arm.measured_jp()
    way = np.array([0.6, 0.2, -0.3, 0.2, 0.3, 0.4])[: home.size]

    def swing() -> None:
        while not over.is_set():
            for goal in (home + way, home - way):
                if not over.is_set():
                    arm.move_jp(goal).wait(60.0)

    thread = threading.Thread(target=swing)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def costs(pids: Sequence[int], seconds: float) -> list[float]:
    """Return what processes take of a core, %."""
    before: list[Usage] = [usage(pid) for pid in pids]
    time.sleep(seconds)
    return [usage(pid).share_since(start) for pid, start in zip(pids, before, strict=True)]


def cost_rows(seconds: float) -> Iterator[list[str]]:
    """Measure the page with nobody, one and five who look."""
    with running("view", ARM, SENSOR, "--port", "0") as view:
        address = address_of(view)
        server = child_running(view.pid, "crtk_sim_backends.page")
        Page(address).ask({"scene": True})
        time.sleep(8.0)  # nobody looks any more
        for count in (0, 1, 5):
            with looking(address, count) as ages:
                time.sleep(3.0)
                ages.clear()
                own, page = costs((view.pid, server), seconds)
                told = list(ages)
            rate = len(told) / seconds / max(1, count)
            yield [
                f"{count} look",
                f"{own:.1f}",
                f"{page:.1f}",
                f"{rate:.1f}",
                *report.spread(told, 1e3),
            ]
        if BROWSER is not None:
            yield browser_row(address, view.pid, server, seconds)


def browser_row(address: str, view: int, server: int, seconds: float) -> list[str]:
    """Measure with a real browser: its delays are to the end of drawing."""
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile)) as browser:
        browser.resize(1200, 760)
        browser.open(address)
        time.sleep(4.0)
        browser.run("told.delays.length = told.draws.length = told.pictures = 0")
        own, page = costs((view, server), seconds)
        pictures, delays, draws = browser.run("[told.pictures, told.delays, told.draws]")
    print(f"Chromium draws a picture in {' / '.join(report.spread(draws, 1.0, 1))} ms")
    row = ["Chromium, drawn", f"{own:.1f}", f"{page:.1f}", f"{pictures / seconds:.1f}"]
    return [*row, *report.spread(delays)]


# ------------------------------------------------------------------------------------------- dead man


def can_jog(device: dict[str, Any]) -> bool:
    """Whether the page knows what can be asked of a device, and which joints it has."""
    return bool(device["actions"] and device["joints"])


def jog_for(page: Page, press: int, seconds: float) -> float:
    """Jog to and fro, by the number of the press, as a page does; return when the last word was sent (s)."""
    speed = 1.0 if press % 2 else -1.0  # all one way it would come to the end of the joint
    asked = {
        "do": "jog",
        "device": ARM,
        "space": "joint",
        "axis": 0,
        "speed": speed,
        "press": press,
    }
    end = time.monotonic() + seconds
    while True:
        last = time.time()
        answer = page.ask({"command": asked})["answer"]
        if answer:
            sys.exit(f"it does not jog: {answer}")
        if time.monotonic() > end:
            return last
        time.sleep(AGAIN)


def ended_by(page: Page, view: subprocess.Popen[str], how: str) -> None:
    """End a jog."""
    if how == "release":
        page.ask({"command": {"do": "release", "device": ARM}})
    elif how == "hold":
        page.ask({"command": {"do": "hold"}})
    elif how == "connection cut":
        page.socket.socket.shutdown(2)
    elif how == "view killed":
        view.kill()


@contextmanager
def speeds(arm: client.RemoteDevice) -> Iterator[list[tuple[float, float]]]:
    """Collect stamps (s) and how fast the first joint turns (rad/s)."""
    found: list[tuple[float, float]] = []

    def heard(value: Any, stamp: float) -> None:
        found.append((stamp, abs(float(value.velocity[0]))))

    end = arm.on("measured_js", heard)
    try:
        yield found
    finally:
        end()


def stop_times(how: str, runs: int) -> list[float]:
    """Return how long after the end of a jog the arm stands, by the stamps of its samples, s."""
    found = []
    for run in range(runs):
        with ExitStack() as opened:
            view = opened.enter_context(running("view", ARM, "--control", "--port", "0"))
            arm = opened.enter_context(client.connect(ARM))
            arm.enable()
            samples = opened.enter_context(speeds(arm))
            page = Page(address_of(view))
            wait_for(lambda page=page: can_jog(page.ask({"scene": True})["scene"]["devices"][0]))
            last = jog_for(page, run + 1, 0.7)
            began = last if how == "silence" else time.time()
            ended_by(page, view, how)
            time.sleep(1.5)
            moving = [stamp for stamp, speed in samples if speed > STANDS]
            if not moving:
                sys.exit("it did not move")
            found.append(max(0.0, max(moving) - began))
    return found


def wait_for(test: Callable[[], bool]) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + 20.0
    while not test():
        if time.monotonic() > deadline:
            sys.exit("the view does not command the arm")
        time.sleep(0.1)


def main() -> None:
    """Measure, and print."""
    given = report.options(
        __doc__ or "", seconds=(10.0, "of each figure"), runs=(7, "ends of a jog of each kind")
    )
    with running("virtual", "--ns", ARM), running("ati-netft", "--ns", SENSOR, "--sim"):
        with client.connect(ARM, timeout=30.0) as arm:
            arm.enable()
            with swinging(arm):
                rows = list(cost_rows(given.seconds))
        heading = [
            "",
            "view, % of a core",
            "server of the page, %",
            "pictures/s",
            "age p50",
            "p99",
            "max, ms",
        ]
        report.show("Two devices, the arm at 500 Hz", heading, rows)
        ends = ("release", "hold", "connection cut", "silence", "view killed")
        jogs = [[how, *report.spread(stop_times(how, int(given.runs)), 1e3)] for how in ends]
        report.show(
            "From the end of a jog until the arm stands", ["", "p50", "p99", "max, ms"], jogs
        )


if __name__ == "__main__":
    main()
