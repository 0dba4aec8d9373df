"""The folder of a run: begun with what is tested and by what, and finished with results, report and index."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.bench import history, report
from crtk_drivers.labs.bench.results import DeviceResult, Run, write_run, write_whole
from crtk_drivers.labs.lab_file import Lab, LabDevice


def default_folder(lab: Lab) -> Path:
    """Return where a run of a lab goes that begins now."""
    return Path("runs") / f"{datetime.now(UTC).strftime('%Y%m%dT%H%M%SZ')}-{lab.name}"


def make_folder(folder: Path) -> None:
    """Make the folder of a run.

    Raises:
        ConfigError: it is there, or cannot be made.
    """
    try:
        folder.mkdir(parents=True)
        (folder / "data").mkdir()
    except FileExistsError as error:
        raise ConfigError(
            "is there already",
            where=str(folder),
            remedy="Give another --out: nothing is overwritten.",
        ) from error
    except OSError as error:
        raise ConfigError(f"cannot be made: {error.strerror}", where=str(folder)) from error


def begun(lab: Lab, suite: str) -> Run:
    """Return a run of which nothing is known yet but what is tested, and on which machine."""
    return Run(
        lab=lab.name,
        lab_file=str(lab.path.resolve()),
        lab_file_sha256=_sha256(lab.path.read_bytes()),
        suite=suite,
        started=datetime.now(UTC).isoformat(timespec="seconds"),
        machine=_machine(),
    )


def described(device: LabDevice) -> DeviceResult:
    """Return a device of which nothing is known yet but what the lab file says."""
    return DeviceResult(
        name=device.name,
        plugin=device.plugin.name,
        address=device.address,
        simulated=device.simulated,
        configuration_sha256=_sha256(json.dumps(dict(device.values), sort_keys=True).encode()),
    )


def finish(
    run: Run, folder: Path, earlier: Iterable[history.Earlier] = (), enough: int = history.ENOUGH
) -> tuple[Run, str]:
    """Compare a run with earlier ones and write all that is made of it.

    Args:
        run: that has ended.
        folder: of it.
        earlier: figures of earlier runs.
        enough: earlier runs from which on a change is called a regression.

    Returns:
        the run as it is kept, and why it is not, or not all of it; that is empty if it is.
    """
    values = history.by_key(earlier)
    run = history.compared(run, values, enough)
    try:
        write_run(run, folder)
        write_whole(folder / "junit.xml", report.junit(run))
        write_whole(folder / "report.html", report.html(run, values))
        history.add_to_index(run, folder.parent, folder.name)
    except OSError as error:
        return run, f"{folder}: results cannot be written: {error.strerror}"
    return run, ""


def _machine() -> dict[str, str]:
    """Return what the results may depend on, of the machine that runs the bench."""
    return {
        "crtk-drivers": version("crtk-drivers"),
        "python": platform.python_version(),
        "kernel": platform.release(),
        "machine": platform.machine(),
        "cores": str(os.cpu_count()),
        "load": " ".join(f"{value:.2f}" for value in os.getloadavg()),
        "clock": _first_line("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
    }


def _first_line(path: str) -> str:
    try:
        return Path(path).read_text().strip().partition("\n")[0]
    except OSError:
        return ""


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
