"""The picture of the page on a lab on several machines, from a real run: ``python -m bench.lab_picture``.

Both machines are this one. The second one's processes have another clock.
"""

from __future__ import annotations

import io
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console

from bench.tracker_pictures import DOCS
from crtk_drivers.cli.lab_view import table_of
from crtk_drivers.client import connect
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.supervisor import LOOK_PERIOD, Supervisor
from crtk_drivers.ros import environment

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from rigs.system_clock import shifted

LAB: Final = """
name = "room"
machine = "control"
environment = { ROS_DOMAIN_ID = 77, ROS_AUTOMATIC_DISCOVERY_RANGE = "LOCALHOST" }
[devices.arm]
plugin = "ur"
settings = { model = "ur5e" }
[devices.ft]
plugin = "ati-netft"
on = "arm"
[devices.polaris]
plugin = "ndi"
machine = "tracking"
[programs.follow]
command = ["sleep", "1000"]
"""

OFFSET: Final = 0.012
"""Seconds that the clock of the second machine is ahead."""

WIDTH: Final = 120
PATIENCE: Final = 60.0


def is_complete(lab: Supervisor) -> bool:
    """Return whether all of it runs, and the clock of the other machine is known."""
    seen = None if lab.observer is None else lab.observer.seen("polaris")
    return (
        seen is not None
        and seen.offset is not None
        and all(device.is_ready for device in lab.devices.values())
        and all(child.process is not None and child.cpu_before[0] for child in lab.children)
    )


def until(lab: Supervisor, seconds: float) -> None:
    """Let a lab run.

    Raises:
        TimeoutError: it does not come up.
    """
    deadline = time.monotonic() + PATIENCE
    while not is_complete(lab):
        if time.monotonic() > deadline:
            raise TimeoutError("the lab does not come up")
        lab.step()
        time.sleep(LOOK_PERIOD)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        lab.step()
        time.sleep(LOOK_PERIOD)


def drawn(lab: Supervisor) -> str:
    """Return how a lab is as SVG, in whatever font of one width a reader has."""
    console = Console(record=True, width=WIDTH, file=io.StringIO())
    console.print(table_of(lab))
    form = re.sub(r"@font-face \{\{.*?\}\}", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
    form = form.replace("Fira Code", "monospace")
    return console.export_svg(title="crtk-driver up lab.toml --sim, on control", code_format=form)


def main() -> None:
    """Draw it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "lab.toml")
        path.write_text(LAB)
        words = ("up", str(path), "--sim", "--machine", "tracking", "--logs", f"{folder}/tracking")
        with subprocess.Popen(
            [sys.executable, "-m", "crtk_drivers.cli", *words],
            env=shifted(OFFSET),
            stderr=subprocess.DEVNULL,
        ) as other:
            control = load_lab(path, sim=True, machine="control")
            lab = Supervisor(control, Path(folder, "control"))
            try:
                until(lab, 3.0)
                environment.adopt(control.environment)
                with connect("/arm", timeout=PATIENCE) as arm:
                    arm.enable()
                until(lab, 5.0)
                text = drawn(lab)
            finally:
                lab.stop()
                other.terminate()
    (DOCS / "several_machines.svg").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
