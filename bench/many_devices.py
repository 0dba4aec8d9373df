"""Ten devices with their simulators on one machine: what each costs beside the others, in two ways.

One process a device, as ``crtk-driver up --sim`` runs them; and all devices in one process
(`bench.together`), whose simulators are processes all the same. Nobody listens; all are DISABLED and measure.
CPU in percent of a core, of the driver and of its simulator; memory is what the driver has in RAM; late are
cycles that took longer than twice their period.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

from bench import processes
from bench.processes import Usage, usage
from bench.report import options, show
from crtk_drivers.labs import load_lab, supervisor
from crtk_drivers.labs.reports import Report
from crtk_drivers.labs.supervisor import Supervisor

DEVICES: Mapping[str, str] = {
    "ur_left": "ur",
    "ur_right": "ur",
    "servos_left": "dynamixel",
    "servos_right": "dynamixel",
    "drives_left": "canopen",
    "drives_right": "canopen",
    "force_left": "ati-netft",
    "force_right": "ati-netft",
    "gantry": "loopback",
    "virtual": "virtual",
}
"""Name and plugin."""

PATIENCE = 60.0
SETTLE = 3.0
MB = 1e-6


def descendants(pid: int) -> list[int]:
    """Return the processes that a process has started, and those that they have."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found += [child, *descendants(child)]
    return found


def cpu(pids: list[int], before: Mapping[int, Usage]) -> float:
    """Return the share of a core of some processes since `before`, in percent."""
    return sum(usage(pid).share_since(before[pid]) for pid in pids)


def late(now: Report, before: Report, seconds: float) -> str:
    """Return the share of late cycles, in percent."""
    return f"{100.0 * (now.late - before.late) / (now.expected * seconds):.2f}"


def apart(folder: Path, seconds: float) -> list[list[str]]:
    """Return the rows of one process a device."""
    lines = (f'[devices.{name}]\nplugin = "{plugin}"\n' for name, plugin in DEVICES.items())
    (folder / "lab.toml").write_text("".join(lines))
    lab = Supervisor(load_lab(folder / "lab.toml", sim=True), folder)
    try:
        deadline = time.monotonic() + PATIENCE
        while not all(child.is_ready for child in lab.children):
            if time.monotonic() > deadline:
                raise TimeoutError([child.name for child in lab.children if not child.is_ready])
            step(lab, supervisor.LOOK_PERIOD)
        step(lab, SETTLE)
        drivers = {name: child.process.pid for name, child in lab.devices.items() if child.process}
        sims = {name: descendants(pid) for name, pid in drivers.items()}
        every = [*drivers.values(), *(pid for pids in sims.values() for pid in pids)]
        before = {pid: usage(pid) for pid in every}
        told = {name: child.report for name, child in lab.devices.items()}
        step(lab, seconds)
        rows = []
        for name, child in lab.devices.items():
            now, then = child.report, told[name]
            assert now is not None
            assert then is not None
            rows.append(
                [
                    name,
                    f"{now.rate:.0f}",
                    late(now, then, seconds),
                    f"{cpu([drivers[name]], before):.1f}",
                    f"{cpu(sims[name], before):.1f}",
                    f"{usage(drivers[name]).rss * MB:.0f}",
                ]
            )
        return rows
    finally:
        lab.stop()


def step(lab: Supervisor, seconds: float) -> None:
    """Look after the lab for so long."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        lab.step()
        time.sleep(supervisor.LOOK_PERIOD)


def together(folder: Path, seconds: float) -> list[list[str]]:
    """Return the rows of all devices in one process, of which the last is that of the process."""
    command = [*processes.module("bench.together"), *(f"{n}={p}" for n, p in DEVICES.items())]
    with processes.running(command, folder) as child:
        processes.wait_ready(child)
        time.sleep(SETTLE)
        sims = descendants(child.pid)
        before = {pid: usage(pid) for pid in (child.pid, *sims)}
        assert child.stdout is not None
        os.kill(child.pid, signal.SIGUSR1)
        then = json.loads(child.stdout.readline())
        time.sleep(seconds)
        os.kill(child.pid, signal.SIGUSR1)
        now = json.loads(child.stdout.readline())
        rows = [
            [name, f"{report.rate:.0f}", late(report, Report(**then[name]), seconds), "", "", ""]
            for name, report in ((name, Report(**told)) for name, told in now.items())
        ]
        of_all = [
            f"{cpu([child.pid], before):.1f}",
            f"{cpu(sims, before):.1f}",
            f"{usage(child.pid).rss * MB:.0f}",
        ]
        return [*rows, ["all", "", "", *of_all]]


def with_sum(rows: list[list[str]]) -> list[list[str]]:
    """Add a row with the sums of what can be added."""
    sums = [f"{sum(float(row[column]) for row in rows):.1f}" for column in (3, 4)]
    return [*rows, ["all", "", "", *sums, f"{sum(float(row[5]) for row in rows):.0f}"]]


def main() -> None:
    """Measure and print."""
    given = options(__doc__ or "", seconds=(20.0, "of each way"))
    logging.disable(logging.CRITICAL)
    columns = ("device", "cycles a second", "late %", "CPU %", "CPU % simulator", "MB")
    with tempfile.TemporaryDirectory() as folder:
        show("One process a device", columns, with_sum(apart(Path(folder), given.seconds)))
        show("All devices in one process", columns, together(Path(folder), given.seconds))


if __name__ == "__main__":
    main()
