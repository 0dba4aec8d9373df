"""Commands for people: what a sensor is, its settings, and the calibration of the tool that hangs on it."""

from __future__ import annotations

import logging
import math
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import Final

import numpy as np
import yaml
from pydantic import Field
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from crtk_driver_ati_netft import connecting, settings
from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.compensation import ToolFit, fit_tool
from crtk_driver_ati_netft.config import NetFtConfig, SensorConfig
from crtk_driver_ati_netft.device import NetFtDevice
from crtk_driver_ati_netft.profiles import PROFILES, Profile, detect
from crtk_driver_ati_netft.recording import Recorder, default_name
from crtk_driver_ati_netft.residual_plot import residual_plot
from crtk_driver_ati_netft.services import TURNED
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.config import Settings
from crtk_drivers.errors import (
    ConfigError,
    ConnectionFailed,
    ConnectionLost,
    DeviceError,
    DeviceFault,
)
from crtk_drivers.geometry.quaternions import matrix_from_quaternion
from crtk_drivers.kit.averaging import Average
from crtk_drivers.plugins import Tool
from crtk_drivers.samples import Array, vector
from crtk_drivers.status.counter_groups import in_words, number_with_unit

AXES: Final = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")

UPWARDS: Final = {
    "+z": np.eye(3),
    "-z": np.diag((1.0, -1.0, -1.0)),
    "+x": np.array(((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))),
    "-x": np.array(((0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0))),
    "+y": np.array(((0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    "-y": np.array(((0.0, 0.0, -1.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))),
}
"""Rotations of the sensor in a world whose z axis points up, with this axis of the sensor upwards."""

TOLD: Final = 0.1
"""Seconds between two steps of a progress."""

_RECORDING: Final = (
    TextColumn("{task.description}"),
    BarColumn(),
    TimeElapsedColumn(),
    TextColumn("{task.fields[figures]}"),
)

_OUT = Console(highlight=False)

logger = logging.getLogger(__name__)


class InfoOptions(Settings):
    """Options of `info`."""

    seconds: float = Field(
        default=0.5,
        ge=0.0,
        le=60.0,
        description="Time to measure, in s. 0 leaves the stream to the client that has it.",
    )


def info(config: NetFtConfig, options: InfoOptions) -> int:
    """Print what the sensor is, its calibration, its rates, its status, and its load."""
    web = WebPages(config.host, config.http_port, config.http_timeout)
    if options.seconds == 0.0:
        found = connecting.identify(config, web, time.monotonic() + config.open_timeout)
        profile = PROFILES.get(config.profile) or detect(found.product)
        _OUT.print(_identity(found, profile, web))
        return 0
    with _opened(config) as device:
        average = _measure(device, options.seconds, lambda share: None)
        if device.info is not None:
            _OUT.print(_identity(device.info, device.profile, web))
        _OUT.print(_load(average, device))
        for note in device.notes:
            _OUT.print(f"{note.severity.name.lower()}: {note.key}: {note.text}", markup=False)
    return 0


class ConfigureOptions(SensorConfig):
    """Options of `configure`: what is given is written."""

    remove_bias: bool = Field(default=False, description="Remove the sensor's own bias as well.")


def configure(config: NetFtConfig, options: ConfigureOptions) -> int:
    """Write settings to the sensor, read them back, and print what it has."""
    web = WebPages(config.host, config.http_port, config.http_timeout)
    found = web.read()
    profile = PROFILES.get(config.profile) or detect(found.product)
    wanted = config.model_copy(update={"sensor": options})
    found = settings.apply(web, found, profile, connecting.wanted_settings(wanted))
    if options.remove_bias:
        found = settings.remove_bias(web)
    _OUT.print(_identity(found, profile, web))
    return 0


class CalibrateOptions(Settings):
    """Options of `calibrate`."""

    seconds: float = Field(
        default=1.0, gt=0.0, le=60.0, description="Time to measure in each pose, in s."
    )
    poses: str | None = Field(
        default=None,
        description="File with an orientation of the sensor on each line: a quaternion x y z w in a "
        "frame whose z axis points up. Otherwise each axis of the sensor is turned upwards once, or with "
        "an `arm` it is asked for each orientation.",
    )
    count: int = Field(default=6, ge=3, le=1000, description="Poses, with an `arm`.")
    ask: bool = Field(
        default=True, description="Wait for Enter before each pose; if not, begin at once."
    )
    plot: str | None = Field(
        default=None, description="File for a picture of the residuals, as SVG."
    )
    output: str | None = Field(
        default=None, description="File for the result, as YAML to be put into a configuration."
    )


def calibrate(config: NetFtConfig, options: CalibrateOptions) -> int:
    """Measure in several poses, find tool and bias, and print what is left over."""
    poses: dict[str, Array | None] = dict(UPWARDS)
    wording = "the sensor's {} axis upwards"
    if options.poses:
        poses, wording = dict(_poses_of(options.poses)), "{}"
    elif config.arm:
        poses = {f"{number}": None for number in range(1, options.count + 1)}
        wording = "as the arm holds it"
    loads, rotations = [], []
    with _opened(config) as device:
        for number, (name, rotation) in enumerate(poses.items(), start=1):
            heading = f"pose {number} of {len(poses)}: {wording.format(name)}"
            if options.ask:
                _OUT.input(f"{heading}. Hold it still and press Enter ")
            known = _arm_rotation(device) if rotation is None else rotation
            with Progress(console=_OUT) as progress:
                task = progress.add_task(heading, total=1.0)
                tell = partial(_tell, progress, task)
                loads.append(_measure(device, options.seconds, tell).mean)
            if rotation is None and not np.allclose(known, _arm_rotation(device), atol=TURNED):
                raise DeviceFault(
                    "the arm moved while the load was measured",
                    where=f"ati-netft {device.address}",
                    remedy="Hold it still, and begin anew.",
                )
            rotations.append(known)
    try:
        fit = fit_tool(np.array(loads), np.array(rotations), vector(config.gravity))
    except ValueError as error:
        raise ConfigError(
            f"no tool can be found: {error}",
            where=f"ati-netft {config.host}",
            remedy="Was the sensor turned as asked, and was nothing touching the tool?",
        ) from error
    _OUT.print(_residuals(fit, list(poses)))
    _OUT.print(_result(fit))
    _write(options.output, yaml.safe_dump(_as_configuration(fit), sort_keys=False))
    _write(options.plot, residual_plot(fit, f"Residuals of {len(poses)} poses, {fit.summary}"))
    return 0


class RecordOptions(Settings):
    """Options of `record`."""

    out: str = Field(
        default="",
        description="File to be made; .csv for text. Without it a name of sensor and time, in the "
        "directory `recordings`, or here.",
    )
    seconds: float | None = Field(
        default=None, gt=0.0, description="How long, in s; until Ctrl-C if not given."
    )


def record(config: NetFtConfig, options: RecordOptions) -> int:
    """Write every measurement to a file until the time is over or somebody presses Ctrl-C."""
    path = Path(options.out or Path(config.recordings, default_name(config)))
    with _opened(config) as device, _interrupts() as interrupts:
        recorder = device.start_recording(path)
        with Progress(*_RECORDING, console=_OUT) as progress:
            task = progress.add_task(path.name, total=options.seconds, figures="")
            for elapsed in _keep_reading(device, options.seconds, interrupts):
                progress.update(task, completed=elapsed, figures=_figures(device, recorder))
                if recorder.error:
                    break
        device.stop_recording()
        _OUT.print(f"{path}: {_figures(device, recorder)}", markup=False, soft_wrap=True)
    return 1 if recorder.error else 0


@contextmanager
def _interrupts() -> Iterator[list[int]]:
    """Put a first Ctrl-C into a list; as an exception it could come while the progress bar has its lock."""
    came: list[int] = []

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield came
    finally:
        signal.signal(signal.SIGINT, before)


def _keep_reading(
    device: NetFtDevice, seconds: float | None, interrupts: list[int]
) -> Iterator[float]:
    """Read, yielding the time that has passed, for so long; connect again when the link is lost."""
    begin = told = heard = time.monotonic()
    end = math.inf if seconds is None else begin + seconds
    while (now := time.monotonic()) < end and not interrupts:
        try:
            if device.read(min(end, now + TOLD)) is not None:
                heard = time.monotonic()
            elif now > heard + device.config.sample_timeout:  # who was held up looks once more
                raise ConnectionLost("the measurements ended", where=f"ati-netft {device.address}")
        except DeviceError as error:
            logger.warning("%s Connecting again.", error)
            device.close()
            _open_again(device, end, interrupts)
            heard = time.monotonic()
        if now >= told + TOLD:
            told = now
            yield now - begin


def _open_again(device: NetFtDevice, end: float, interrupts: list[int]) -> None:
    while (now := time.monotonic()) < end and not interrupts:
        try:
            device.open(min(end, now + device.config.open_timeout))
            return
        except DeviceError as error:  # a sensor that has just been switched on says strange things
            logger.debug("%s", error)
            time.sleep(TOLD)


def _figures(device: NetFtDevice, recorder: Recorder) -> str:
    rate, lost = device.counters["record_rate"], device.counters.get("lost", 0.0)
    missed = f", {recorder.missed} missed" if recorder.missed else ""
    return (
        f"{recorder.written} measurements ({rate:.5g}/s), {lost:.0f} lost{missed}, "
        f"{recorder.size / 1e6:.1f} MB"
    )


TOOLS: Final = (
    Tool(
        "info", "tell what a sensor is, its calibration, rates, status and load", info, InfoOptions
    ),
    Tool(
        "configure",
        "write settings to the sensor and read them back",
        configure,
        ConfigureOptions,
    ),
    Tool(
        "calibrate",
        "find mass and centre of the tool, and the bias, from several poses",
        calibrate,
        CalibrateOptions,
    ),
    Tool(
        "record",
        "write every measurement at the sensor's full rate to a file",
        record,
        RecordOptions,
    ),
)


@contextmanager
def _opened(config: NetFtConfig) -> Iterator[NetFtDevice]:
    device = NetFtDevice(config)
    try:
        device.open(time.monotonic() + config.open_timeout)
        yield device
    finally:
        device.close()


def _arm_rotation(device: NetFtDevice) -> Array:
    """Return the rotation that the arm gives the sensor, waiting for it.

    Raises:
        ConnectionFailed: there is none.
    """
    deadline = time.monotonic() + device.config.open_timeout
    while (rotation := device.pipeline.rotation) is None:
        if time.monotonic() > deadline:
            raise ConnectionFailed(
                f"the orientation of the sensor is not known: {device.orientation_problem}",
                where=f"ati-netft {device.address}",
                remedy=f"Does {device.config.arm} publish measured_cp?",
            )
        device.read(time.monotonic() + TOLD)
    return rotation


def _tell(progress: Progress, task: TaskID, share: float) -> None:
    progress.update(task, completed=share)


def _measure(device: NetFtDevice, seconds: float, tell: Callable[[float], None]) -> Average:
    averaging = device.begin_average(seconds)
    begin = heard = time.monotonic()
    while not averaging.done:
        looked = time.monotonic()
        if device.read(looked + 0.1) is not None:
            heard = time.monotonic()
        tell(min(1.0, (time.monotonic() - begin) / seconds))
        if averaging.spoilt or looked > heard + device.config.sample_timeout:
            raise DeviceFault(
                averaging.spoilt or "the measurements ended",
                where=f"ati-netft {device.address}",
                remedy="Unload the sensor, or remove the cause, and try again.",
            )
    tell(1.0)
    return averaging.result()


def _identity(found: SensorInfo, profile: Profile, web: WebPages) -> Table:
    rows = {
        "product": found.product,
        "family": f"{profile.name} ({profile.summary})",
        "serial number": found.serial,
        "firmware": found.firmware,
        "configuration": f"{_or(found.active_configuration)} {found.configuration}",
        "calibration": _calibration_text(found, web),
        "counts per force, torque": f"{found.scale.counts_per_force:g}, "
        f"{found.scale.counts_per_torque:g} (unit {found.scale.force:g} N, {found.scale.torque:g} N·m)",
        "rated load": ", ".join(f"{value:g}" for value in found.rated.tolist()),
        "internal rate": f"{_or(found.internal_rate)} Hz",
        "records per second": _or(found.rdt_rate),
        "RDT": {True: "enabled", False: "disabled", None: ""}[found.rdt_enabled],
        "filter": _filter_text(found.filter_code, profile),
        "bias of the gages": ", ".join(map(str, found.bias)),
        "tool transform": ", ".join(f"{value:g}" for value in found.transform.tolist()),
        "status": "" if found.status is None else _status_text(found.status, profile),
        "problems": "; ".join(found.problems),
    }
    return _table((name, text) for name, text in rows.items() if text.strip())


def _calibration_text(found: SensorInfo, web: WebPages) -> str:
    index = found.tags.get("cfgcalsel", "")
    if not index.isdecimal():
        return found.calibration_serial
    try:
        page = web.calibration(int(index))
    except DeviceError as error:
        return f"{found.calibration_serial} ({error.message})"
    return f"{page.serial or found.calibration_serial} {page.part} {page.family} {page.date}"


def _filter_text(code: int | None, profile: Profile) -> str:
    if code is None:
        return ""
    cutoff = profile.filters.get(code)
    return f"code {code}" + (f" ({cutoff:g} Hz)" if cutoff else " (off)" if cutoff == 0.0 else "")


def _status_text(status: int, profile: Profile) -> str:
    return f"0x{status:08x} {', '.join(profile.status.texts(status)) or 'good'}"


def _or(value: int | None) -> str:
    return "" if value is None else str(value)


def _load(average: Average, device: NetFtDevice) -> Table:
    counters = device.counters
    rows = [
        (f"load {axis}", f"{mean:.5g} ± {deviation:.2g} {'N' if axis[0] == 'F' else 'N·m'}")
        for axis, mean, deviation in zip(
            AXES, average.mean.tolist(), average.deviation.tolist(), strict=True
        )
    ]
    rows.append(("measured", f"{average.count} in {counters['record_rate']:.6g} records/s"))
    units = device.counter_units
    rows += [
        (in_words(name), number_with_unit(counters[name], units.get(name, "")))
        for name in ("lost", "duplicates", "late", "malformed", "tick_rate", "arrival_jitter_p99")
        if name in counters
    ]
    return _table(iter(rows))


def _residuals(fit: ToolFit, names: list[str]) -> Table:
    table = Table("pose", *AXES, title="Left over, in N and N·m", box=None)
    for name, row in zip(names, fit.residuals.tolist(), strict=True):
        table.add_row(name, *(f"{value:+.4f}" for value in row))
    return table


def _result(fit: ToolFit) -> Table:
    center = ", ".join(f"{value * 1e3:.2f}" for value in fit.tool.center.tolist())
    errors = ", ".join(f"{value * 1e3:.2f}" for value in fit.center_error.tolist())
    return _table(
        iter(
            [
                ("mass", f"{fit.tool.mass:.4f} ± {fit.mass_error:.4f} kg"),
                ("centre of mass", f"{center} ± {errors} mm"),
                ("bias", ", ".join(f"{value:.4f}" for value in fit.bias.tolist())),
                ("residual", f"{fit.force_residual:.4f} N, {fit.torque_residual:.5f} N·m"),
            ]
        )
    )


def _as_configuration(fit: ToolFit) -> dict[str, object]:
    return {
        "tool": {
            "mass": round(fit.tool.mass, 6),
            "center_of_mass": [round(value, 6) for value in fit.tool.center.tolist()],
        },
        "bias": [round(value, 6) for value in fit.bias.tolist()],
    }


def _poses_of(path: str) -> dict[str, Array]:
    """Return the rotations of a file of quaternions, by their text.

    Raises:
        ConfigError: the file cannot be read, or a line is no quaternion.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", where=path) from error
    poses: dict[str, Array] = {}
    for number, line in enumerate(lines, start=1):
        text = line.partition("#")[0].replace(",", " ").strip()
        if not text:
            continue
        try:
            quaternion = vector([float(part) for part in text.split()])
            length = float(np.linalg.norm(quaternion))
            if quaternion.size != 4 or not abs(length - 1.0) < 1e-3:
                raise ValueError(f"{quaternion.size} numbers of length {length:.4g}")
        except ValueError as error:
            raise ConfigError(
                f"{text[:60]!r} is no unit quaternion x y z w: {error}", where=f"{path}:{number}"
            ) from error
        poses[f"{len(poses) + 1}: {text}"] = matrix_from_quaternion(vector(quaternion / length))
    return poses


def _write(path: str | None, text: str) -> None:
    if path is None:
        return
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot be written: {error}", where=path) from error
    _OUT.print(f"written: {path}", markup=False)


def _table(rows: Iterator[tuple[str, str]]) -> Table:
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, text in rows:
        table.add_row(name, text)
    return table
