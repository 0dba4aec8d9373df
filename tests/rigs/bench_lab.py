"""Runs of the bench over a lab of a virtual arm that carries a simulated force sensor."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from crtk_drivers.labs import load_lab
from crtk_drivers.labs.bench.acquisition import Suite
from crtk_drivers.labs.bench.allowed import BenchOptions
from crtk_drivers.labs.bench.results import Run
from crtk_drivers.labs.bench.run import run_bench
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.status.stop_request import StopRequest

ARM_200 = {"rate": 200.0}
"""Settings of the arm."""
ARM = '[devices.arm]\nplugin = "virtual"\nsettings.rate = 200\n'
FT = """
[devices.ft]
plugin = "ati-netft"
on = "arm"
sim = true
mounting = { rpy = [0.0, 0.0, 1.0] }
tool = { mass = 0.8, center_of_mass = [0.0, 0.02, 0.06] }
settings = { rate = 200 }
"""

Progress = Callable[[str, str, Verdict | None, str], None]


def carried_out(
    folder: Path,
    lab: str,
    *only: str,
    progress: Progress = lambda *_: None,
    stop: StopRequest | None = None,
) -> Run:
    path = folder / "lab.toml"
    path.write_text(lab)
    options = BenchOptions(Suite.QUICK, only, may_move=False, out=folder / "run")
    return run_bench(load_lab(path), options, progress, stop or StopRequest())


def with_defects(text: str) -> str:
    return f'{ARM}{FT}sim_options = {{ defects = "{text}" }}\n'


def of_sensor(run: Run) -> dict[str, tuple[Verdict, str]]:
    return {
        test.id: (test.verdict, test.reason) for device, test in run.tests if device.name == "ft"
    }


def measured(run: Run) -> dict[str, Verdict]:
    return {one.id: one.verdict for _, test in run.tests for one in test.measurements}
