"""The pictures of the docs: ``python -m bench.screenshots`` takes them anew, of simulators that move.

It needs Chromium. A name after the command takes that one alone; ``--to FOLDER``
puts them elsewhere than into ``docs``.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

import crtk_drivers
from bench import png
from bench.browser import BROWSER, NAMES, Browser
from bench.view import address_of, running
from crtk_drivers import client
from crtk_drivers.errors import CommandRefused, CrtkError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.report import html
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.tapes.contents import contents_of
from crtk_drivers.labs.tapes.pages import all_figures
from crtk_drivers.labs.tapes.pages import html as tape_page
from crtk_drivers.recording import opened
from crtk_drivers.status.stop_request import StopRequest
from crtk_sim_backends.can import SIM as CAN

DOCS: Final = Path(__file__).parents[1] / "docs"
LARGEST: Final = 120_000
"""Bytes of a picture."""

HOST: Final = "127.0.0.2"
STREAMED: Final = 4.0
"""Seconds of a stream of commands in the picture of a recording."""
WATCHED: Final = 8.0
"""Seconds of motion before the picture: what the charts show."""


@dataclass(frozen=True)
class Shot:
    """One picture: its file, what is shown, its size in pixels, options of the simulator or the device."""

    name: str
    device: str
    size: tuple[int, int]
    options: Mapping[str, Any] = field(default_factory=dict)
    swing: tuple[float, ...] = ()  # to both sides of where it starts; rad (m)


SHOTS: Final = (
    Shot("ur_simulator", "ur", (1000, 600), swing=(0.9, 0.35, -0.5, 0.3, 0.4, 1.0)),
    Shot(
        "dynamixel_simulator",
        "dynamixel",
        (1000, 640),
        {"link": "/tmp/arm"},
        swing=(0.8, 0.4, -0.6, 0.7, 0.5, 1.0),
    ),
    Shot("canopen_simulator", "canopen", (1000, 640), swing=(0.6, -0.4, 0.5, -0.3, 0.7, -0.5)),
    Shot(
        "netft_simulator",
        "ati-netft",
        (1000, 560),
        {
            "load": "constant:fz=-20 + sine:axis=0,amplitude=15,frequency=0.3 + "
            "sine:axis=4,amplitude=1,frequency=0.5"
        },
    ),
    Shot("robotiq_simulator", "robotiq", (1000, 520), swing=(0.035,)),
    Shot("onrobot_simulator", "onrobot", (1000, 520), swing=(0.035,)),
    Shot("schunk_simulator", "schunk", (1000, 520), swing=(0.035,)),
    Shot("weiss_wsg_simulator", "weiss-wsg", (1000, 560), {"part_width": 0.03}, swing=(0.035,)),
    Shot(
        "ros2_control_simulator",
        "ros2-control",
        (1000, 640),
        swing=(0.8, 0.3, -0.4, 0.5, 0.4, 0.9),
    ),
    Shot(
        "virtual_arm",
        "virtual",
        (1000, 600),
        {"model": "seven_axis"},
        swing=(0.9, 0.35, -0.5, -0.3, 0.4, 0.3, 1.0),
    ),
    Shot("galil_simulator", "galil", (1000, 480), swing=(0.5, -0.3, 0.7)),
    Shot("can_hub", "can", (1000, 420), {"bitrate": 500_000}),
    Shot("bench", "bench", (960, 1260)),
    Shot("view", "view", (1100, 720), swing=(0.6, 0.3, -0.4)),
    Shot("view_control", "view", (1100, 720), {"control": True}, swing=(0.6, 0.3, -0.4)),
    Shot("recording", "ur", (1080, 1960)),
)

VIEWED: Final = """
name = "viewed"
[devices.arm]
plugin = "virtual"
[devices.ft]
plugin = "ati-netft"
on = "arm"
mounting = { position = [0.0, 0.0, 0.02], orientation = [0.0, 0.0, 0.0, 1.0] }
tool = { mass = 1.2, center_of_mass = [0.0, 0.0, 0.05] }
[devices.second]
plugin = "virtual"
"""
"""What the page of all devices is shown with: an arm that carries a sensor, and another arm."""

LAB: Final = """
name = "bench"
[devices.arm]
plugin = "virtual"
[devices.second_arm]
plugin = "virtual"
settings = { defects = { jump_on_enable = 0.012 } }
[devices.ft]
plugin = "ati-netft"
"""
"""What the bench is shown with: a sound arm, one that jumps when it is enabled, and a sensor."""


@contextmanager
def shown(shot: Shot) -> Iterator[str]:
    """Let a simulator or a device run and move, and yield the address of its page."""
    if shot.name in PAGES:
        with tempfile.TemporaryDirectory() as folder:
            yield PAGES[shot.name](Path(folder)).as_uri()
        return
    if shot.device == "view":
        with viewed(shot) as address:
            yield address
        return
    options = {"web": True, "web_port": 0, "host": HOST, **shot.options}
    if shot.device == "can":
        with CAN.spawn(**options) as bus:
            bus.control.inject("babbling", rate=800.0)
            yield page_of(bus)
        return
    if shot.device == "virtual":
        settings: dict[str, Any] = {"web": True, "web_port": 0, **shot.options}
    else:
        settings = {"sim": True, "sim_options": options}
    with crtk_drivers.connect(shot.device, **settings) as device:
        device.enable()
        with swinging(device, shot.swing):
            yield device.page or page_of(device.sim)


@contextmanager
def viewed(shot: Shot) -> Iterator[str]:
    """Bring a lab up, let its arms move, and yield the address of the page of all devices."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as opened:
        lab = Path(folder, "lab.toml")
        lab.write_text(VIEWED)
        opened.enter_context(running("up", str(lab), "--sim", folder=folder))
        arms = [
            opened.enter_context(client.connect(name, timeout=60.0)) for name in ("/arm", "/second")
        ]
        opened.enter_context(client.connect("/ft", timeout=60.0)).measured_cf(wait=60.0)
        for arm in arms:
            arm.enable()
            arm.setpoint_js(wait=60.0)
            way = np.zeros(arm.measured_jp().size)
            way[: len(shot.swing)] = shot.swing
            opened.enter_context(swinging(arm, way.tolist()))
        options = ["--control"] if shot.options.get("control") else []
        view = opened.enter_context(running("view", str(lab), "--port", "0", *options))
        yield address_of(view)


def report_of(folder: Path) -> Path:
    """Run some tests of the bench, and return the report."""
    lab, out = folder / "lab.toml", folder / "run"
    lab.write_text(LAB)
    tests = ("T3", "J1", "M1", "M2", "M3", "S1")
    options = BenchOptions(Suite.QUICK, tests, may_move=False, out=out)
    found = run_bench(load_lab(lab, sim=True), options, lambda *_: None, StopRequest())
    path = out / "report.html"
    path.write_text(html(found), "utf-8")
    return path


def recording_of(folder: Path) -> Path:
    """Record a simulated UR that moves, streams, is refused a command and stops; return the page of it."""
    path = folder / "run.mcap"
    with crtk_drivers.connect("ur", sim=True) as arm:
        arm.recordings.place("/ur5")
        arm.recordings.start(path)
        time.sleep(0.5)
        with contextlib.suppress(CommandRefused):
            arm.move_jp(arm.measured_jp())
        arm.enable()
        arm.move_jp(arm.setpoint_jp() + np.array([0.3, -0.2, 0.2, 0.0, 0.2, 0.0])).wait()
        start, began = arm.setpoint_jp(), time.monotonic()
        while (passed := time.monotonic() - began) < STREAMED:
            wide = 0.15 * min(1.0, passed)
            once, twice = wide * np.sin(2.0 * passed), wide * np.sin(4.0 * passed)
            lifted = wide - wide * np.cos(2.0 * passed)
            arm.servo_jp(start + np.array([once, lifted, twice, 0.0, 0.0, once]))
            time.sleep(0.004)
        time.sleep(0.5)
        arm.move_jp(start)
        time.sleep(0.3)
        arm.sim.control.inject("protective_stop")
        time.sleep(1.0)
        arm.record_stop()
    recording, _ = opened(path)
    contents = contents_of(recording)
    page = folder / "run.html"
    page.write_text(tape_page(recording, contents, all_figures(contents), ""), "utf-8")
    return page


PAGES: Final[Mapping[str, Callable[[Path], Path]]] = {
    "bench": report_of,
    "recording": recording_of,
}
"""Pages that are files: what makes them in a folder."""


def page_of(sim: Any) -> str:
    """Return the address of the page of a simulator."""
    (address,) = (hint.removeprefix("page: ") for hint in sim.hints if hint.startswith("page: "))
    return str(address)


@contextmanager
def swinging(device: Any, swing: Sequence[float]) -> Iterator[None]:
    """Let an arm move to and fro meanwhile.

    Raises:
        RuntimeError: it has stopped.
    """
    over = threading.Event()
    failures: list[Exception] = []

    def swings() -> None:
        start, way = device.setpoint_jp(), np.array(swing)
        other_way = way.copy()
        other_way[1:2] = -way[1:2]
        goals = [start + way, start + other_way, start - way]
        while not over.is_set():
            for goal in goals:
                if over.is_set():
                    return
                try:
                    device.move_jp(goal).wait()
                except CrtkError as error:
                    failures.append(error)
                    return

    if not len(swing):
        yield
        return
    moving = threading.Thread(target=swings)
    moving.start()
    try:
        yield
    finally:
        over.set()
        moving.join()
    if failures:
        raise RuntimeError(f"it does not move in the picture: {failures[0]}") from failures[0]


def take(shot: Shot, browser: Browser, folder: Path, watched: float = WATCHED) -> Path:
    """Take one picture and return its file.

    Raises:
        ValueError: it is larger than a page should carry, or the page had errors.
    """
    with shown(shot) as address:
        browser.resize(*shot.size)
        if address.startswith("file:"):
            browser.call("Page.navigate", url=address)
            browser.until("document.readyState === 'complete'")
        else:
            browser.open(address)
            time.sleep(watched)
        pixels = browser.pixels()
    data = png.encode(
        pixels
    )  # takes its time, in which a driver in this process would not be served
    if browser.problems:
        raise ValueError(f"{shot.name}: the page had errors: {browser.problems}")
    if len(data) > LARGEST:
        raise ValueError(
            f"{shot.name}: {len(data)} bytes, of {LARGEST} at most: take a smaller one"
        )
    path = folder / f"{shot.name}.png"
    path.write_bytes(data)
    return path


def main(arguments: Sequence[str] | None = None, tell: Callable[[str], object] = print) -> int:
    """Take the pictures that are asked for, or all; 1 where there is no browser."""
    parser = argparse.ArgumentParser(prog="python -m bench.screenshots")
    parser.description = "Take the pictures of the docs anew."
    names = [shot.name for shot in SHOTS]
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--to", type=Path, default=DOCS, help="folder (default: docs)")
    given = parser.parse_args(arguments)
    for name in given.names:
        if name not in names:
            parser.error(f"there is no picture {name}; there are {', '.join(names)}")
    if BROWSER is None:
        tell(f"no browser: install one of {', '.join(NAMES)}, or give its path in CRTK_BROWSER")
        return 1
    with tempfile.TemporaryDirectory() as profile, Browser(Path(profile)) as browser:
        for shot in SHOTS:
            if not given.names or shot.name in given.names:
                path = take(shot, browser, given.to)
                tell(f"{path}: {path.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
