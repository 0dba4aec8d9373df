"""What a NetFT sensor does beyond CRTK: bias, and finding the tool that hangs on it.

Each is a procedure of the I/O thread. A bias is never set by itself. The software bias is ours: it can be
read, set, and removed exactly. The sensor's own bias it keeps to itself, and it is unknown after the sensor
was off or another client had it.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np

from crtk_driver_ati_netft import settings
from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.compensation import NO_LOAD, ToolFit, fit_tool
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.pipeline import Pipeline
from crtk_driver_ati_netft.profiles import Action, Profile
from crtk_driver_ati_netft.recording import Recorder, default_name
from crtk_driver_ati_netft.residual_plot import residual_plot
from crtk_driver_ati_netft.source import Source
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.device import Answer, Service, Severity
from crtk_drivers.errors import CommandRefused, Reason, TransitionFailed
from crtk_drivers.kit.averaging import Average, Averaging, differ
from crtk_drivers.kit.sensing.load_monitor import LoadMonitor
from crtk_drivers.kit.software_bias import AVERAGED, CHECKED, DRIFT, check_bias, load_text
from crtk_drivers.samples import Array, Vector, Wrench, vector

POSE: Final = 0.5
"""Seconds of measurements in each pose of a calibration."""
ANEW: Final = 2.0
"""Seconds in which a stream begins anew; one that does not goes on as it was."""
TURNED: Final = 2e-3
"""By how much the entries of a rotation may change while a load is measured."""

_Result = TypeVar("_Result")

logger = logging.getLogger(__name__)


class SensorBias(StrEnum):
    """What is known of the sensor's own bias."""

    UNTOUCHED = "untouched"
    """As the driver found it."""
    SET = "set"
    """Set by this driver."""
    REMOVED = "removed"
    """Removed by this driver."""
    UNKNOWN = "unknown"
    """The sensor was out of our hands."""


class Sensor(Protocol):
    """What the services need of the device.

    Attributes:
        info: what the sensor said of itself; None before it was connected.
        profile: of its family.
        web: its pages.
        monitor: of overloads and latches.
        pipeline: from measurements to loads.
    """

    info: SensorInfo | None
    profile: Profile
    web: WebPages
    monitor: LoadMonitor
    pipeline: Pipeline

    @property
    def config(self) -> NetFtConfig:
        """Of the device."""

    @property
    def source(self) -> Source:
        """Of the measurements."""

    @property
    def address(self) -> str:
        """Where it is, for messages."""

    @property
    def bias(self) -> Vector:
        """The software bias (6,), in the sensor's frame, N and N·m."""

    @property
    def orientation_problem(self) -> str:
        """Why the orientation is not known now; empty if it is."""

    def begin_average(self, seconds: float) -> Averaging:
        """Average the measurements from now on."""

    def start_recording(self, path: Path) -> Recorder:
        """Write every measurement from now on, until `stop_recording`."""

    def stop_recording(self) -> Recorder | None:
        """End the recording; return what wrote it, None if there was none."""


class SensorServices:
    """The services of one device."""

    def __init__(self, device: Sensor) -> None:
        self.sensor_bias = SensorBias.UNTOUCHED
        self.table: Mapping[str, Service] = {
            "bias": Service("make the present load zero, in software", self._bias),
            "unbias": Service("remove the software bias", self._unbias),
            "get_bias": Service("tell the software bias", self._get_bias),
            "sensor_bias": Service("make the present load zero, in the sensor", self._bias_sensor),
            "sensor_unbias": Service("remove the sensor's own bias", self._unbias_sensor),
            "clear_latch": Service("clear the latched monitor condition", self._clear_latch),
            "calibration_add": Service(
                "average the load in the present pose, for calibration_finish", self._add_pose
            ),
            "calibration_finish": Service(
                "find tool and bias from the poses, and take them off", self._finish
            ),
            "calibration_clear": Service("forget the poses", self._clear_poses),
            "record_start": Service("write every measurement to a new file", self._record),
            "record_stop": Service("end the recording", self._end_recording),
        }
        self.fit: ToolFit | None = None
        """The result of the last calibration."""
        self._device = device
        self._doubt = ""
        self._poses: list[tuple[Average, Array]] = []
        self._worker: ThreadPoolExecutor | None = None

    def close(self) -> None:
        """End what still runs in the background."""
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.shutdown(wait=True, cancel_futures=True)

    def doubt_bias(self, reason: str) -> None:
        """The sensor was out of our hands: what it subtracts is not known any more.

        Poses of a calibration that were taken before it do not go with those that follow.
        """
        self.sensor_bias = SensorBias.UNKNOWN
        self._doubt = reason
        if self._poses:
            logger.warning(
                "%s: the poses of the calibration count no more: %s", self._device.address, reason
            )
            self._poses.clear()

    def notes(self) -> list[tuple[Severity, str, str]]:
        """Return what people should know: severity, key, text."""
        notes = []
        if self.sensor_bias is SensorBias.UNKNOWN:
            text = f"unknown: {self._doubt}. Set the bias anew, with the sensor unloaded"
            notes.append((Severity.WARNING, "bias", text))
        else:
            notes.append((Severity.INFO, "bias", f"of the sensor: {self.sensor_bias}"))
        if self._poses:
            notes.append((Severity.INFO, "calibration", f"{len(self._poses)} poses taken"))
        return notes

    def take_bias(self, value: Any) -> None:
        """Take a software bias, in the sensor's frame.

        Raises:
            CommandRefused: it is not finite, beyond any sensor, or stated in another frame.
        """
        assert isinstance(value, Wrench)
        check_bias(value.vector, value.frame_id, self._device.config.frame_id)
        self._device.pipeline.set_bias(vector(value.vector))

    # ------------------------------------------------------------------------------------- software

    def _bias(self) -> Answer:
        pipeline = self._device.pipeline
        if pipeline.tool is not None:
            self._known_rotation("bias")
        before = pipeline.compensation
        average = yield from self._average(AVERAGED)
        bias = vector(average.mean - before.weight)
        pipeline.set_bias(bias)
        is_checked = False
        try:
            after = yield from self._average(CHECKED)
            left = after.mean - average.mean
            if differ(average, after, left, self._drift):
                raise TransitionFailed(
                    "the load changed while the bias was set; the bias is what it was",
                    where=self._device.address,
                    remedy="Leave the sensor alone for half a second, and try again.",
                )
            is_checked = True
        finally:
            # One that was set meanwhile stays.
            if not is_checked and pipeline.compensation.bias is bias:
                pipeline.set_bias(before.bias)
        self._trust()
        return f"software bias {load_text(bias)}; left over {load_text(left)}"

    def _unbias(self) -> Answer:
        self._device.pipeline.set_bias(NO_LOAD)
        yield from ()
        return "software bias removed"

    def _get_bias(self) -> Answer:
        yield from ()
        return f"software bias {load_text(self._device.bias)}; of the sensor: {self.sensor_bias}"

    # --------------------------------------------------------------------------------- in the sensor

    def _bias_sensor(self) -> Answer:
        device = self._device
        self.doubt_bias("it was being set, and that was not finished")
        yield from self._asked_for(Action.BIAS)
        yield from self._average(CHECKED)  # what was on its way when it was set
        average = yield from self._average(AVERAGED)
        if differ(average, average, average.mean, self._drift):
            self.doubt_bias("the sensor did not do what it was asked for")
            raise TransitionFailed(
                f"the sensor measures {load_text(average.mean)} after its bias was set",
                where=device.address,
                remedy="Leave it alone for a second, and try again; or use `bias`.",
            )
        device.pipeline.set_bias(NO_LOAD)
        self.sensor_bias = SensorBias.SET
        return f"bias set in the sensor; left over {load_text(average.mean)}. Software bias removed"

    def _unbias_sensor(self) -> Answer:
        device = self._device
        by_request = Action.UNBIAS in device.profile.actions
        if not by_request and not (device.config.http and device.profile.has_web):
            raise CommandRefused(
                "sensor_unbias",
                Reason.UNSUPPORTED,
                "its bias can only be removed by its web page, which is switched off",
                where=device.address,
                remedy="Set http to true, or switch the sensor off and on.",
            )
        self.doubt_bias("it was being removed, and that was not finished")
        if by_request:
            yield from self._asked_for(Action.UNBIAS)
        else:
            yield from self._in_background(lambda: settings.remove_bias(device.web))
            device.source.resume()
        average = yield from self._average(AVERAGED)
        self.sensor_bias = SensorBias.REMOVED
        return f"bias of the sensor removed; it measures {load_text(average.mean)}"

    def _clear_latch(self) -> Answer:
        device = self._device
        if Action.CLEAR_LATCH not in device.profile.actions:
            raise CommandRefused(
                "clear_latch",
                Reason.UNSUPPORTED,
                f"the family {device.profile.name} has no request for it",
                where=device.address,
                remedy="Use the sensor's web page.",
            )
        yield from self._asked_for(Action.CLEAR_LATCH)
        yield from self._average(CHECKED)
        return ", ".join(device.monitor.notices) or "cleared"

    # ----------------------------------------------------------------------------------- calibration

    def _add_pose(self) -> Answer:
        rotation = self._known_rotation("calibration_add")
        average = yield from self._average(POSE)
        if not np.allclose(rotation, self._known_rotation("calibration_add"), atol=TURNED):
            raise TransitionFailed(
                "the sensor was turned while it was measuring; the pose does not count",
                where=self._device.address,
                remedy="Hold it still, and try again.",
            )
        self._poses.append((average, rotation))
        noise = float(np.linalg.norm(average.deviation[:3]))
        return f"pose {len(self._poses)}: {load_text(average.mean)}, noise {noise:.3g} N"

    def _finish(self) -> Answer:
        pipeline = self._device.pipeline
        yield from ()
        loads = np.array([average.mean for average, _ in self._poses]).reshape(-1, 6)
        rotations = np.array([rotation for _, rotation in self._poses]).reshape(-1, 3, 3)
        try:
            fit = fit_tool(loads, rotations, vector(self._device.config.gravity))
        except ValueError as error:
            raise CommandRefused(
                "calibration_finish",
                Reason.OUT_OF_RANGE,
                str(error),
                where=self._device.address,
                remedy="Add poses with calibration_add, or begin anew with calibration_clear.",
            ) from error
        self.fit = fit
        pipeline.set_tool(fit.tool)
        pipeline.set_bias(fit.bias)
        self._poses.clear()
        self._trust()
        drawn = yield from self._draw(fit)
        center = ", ".join(f"{value * 1e3:.2f}" for value in fit.tool.center.tolist())
        return (
            f"mass {fit.tool.mass:.4f} kg (± {fit.mass_error:.4f}), centre of mass {center} mm "
            f"(± {np.max(fit.center_error) * 1e3:.2f}), bias {load_text(fit.bias)}; "
            f"residuals {fit.force_residual:.3g} N, {fit.torque_residual:.3g} N·m, in each pose "
            f"{', '.join(f'{left:.3g}' for left in np.linalg.norm(fit.residuals[:, :3], axis=1))} N{drawn}"
        )

    def _draw(self, fit: ToolFit) -> Generator[None, None, str]:
        """Draw the residuals where recordings go; return what to add to the answer."""
        config = self._device.config
        if not config.recordings:
            return ""
        path = Path(config.recordings, default_name(config)).with_suffix(".svg")
        picture = residual_plot(fit, f"Residuals of {len(fit.residuals)} poses, {fit.summary}")
        try:
            yield from self._in_background(lambda: path.write_text(picture, encoding="utf-8"))
        except OSError as error:
            return f". No picture: {path} cannot be written: {error.strerror}"
        return f", drawn in {path}"

    def _clear_poses(self) -> Answer:
        self._poses.clear()
        yield from ()
        return "no poses"

    # ------------------------------------------------------------------------------------- recording

    def _record(self) -> Answer:
        device = self._device
        directory = device.config.recordings
        if not directory:
            raise CommandRefused(
                "record_start",
                Reason.UNSUPPORTED,
                "no directory is configured for recordings",
                where=device.address,
                remedy="Set `recordings` to one, or use `crtk-driver ati-netft record`.",
            )
        path = Path(directory, default_name(device.config))
        recorder = yield from self._in_background(lambda: device.start_recording(path))
        return f"recording {recorder.path}"

    def _end_recording(self) -> Answer:
        recorder = yield from self._in_background(self._device.stop_recording)
        if recorder is None:
            raise CommandRefused(
                "record_stop",
                Reason.INVALID_TRANSITION,
                "nothing is recorded",
                where=self._device.address,
                remedy="Begin with record_start.",
            )
        if recorder.error:
            raise TransitionFailed(
                recorder.error,
                where=self._device.address,
                remedy=f"The {recorder.written} measurements before it are in the file.",
            )
        return f"{recorder.written} measurements in {recorder.path}, {recorder.missed} missed"

    # --------------------------------------------------------------------------------------- inside

    def _asked_for(self, action: Action) -> Generator[None, None, None]:
        """Ask the sensor for something, and wait until its stream begins anew, which is asked for after it.

        What comes before that may have been measured before it. Over TCP it goes with a measurement.
        """
        source = self._device.source
        before, begun = source.counters.get("series"), time.monotonic()
        source.request(action)
        if before is None:
            return
        while source.counters.get("series") == before and time.monotonic() < begun + ANEW:
            yield

    def _average(self, seconds: float) -> Generator[None, None, Average]:
        averaging = self._device.begin_average(seconds)
        while not averaging.done:
            yield
            if averaging.spoilt:
                raise TransitionFailed(
                    f"the measurements cannot be used: {averaging.spoilt}",
                    where=self._device.address,
                    remedy="Unload the sensor, or remove the cause, and try again.",
                )
        return averaging.result()

    @property
    def _drift(self) -> Vector:
        """By how much two means may differ besides their noise (6,)."""
        info = self._device.info
        return vector(DRIFT * (info.rated if info is not None and info.rated.size else NO_LOAD))

    def _known_rotation(self, service: str) -> Array:
        rotation = self._device.pipeline.rotation
        if rotation is None:
            raise CommandRefused(
                service,
                Reason.EMPTY,
                f"the orientation of the sensor is not known: {self._device.orientation_problem}",
                where=self._device.address,
                remedy="Send its pose to the input `orientation` all the time, or set `arm` or "
                "`orientation`.",
            )
        return rotation

    def _in_background(self, work: Callable[[], _Result]) -> Generator[None, None, _Result]:
        """Do what waits for the network in another thread, and go on measuring."""
        if self._worker is None:
            self._worker = ThreadPoolExecutor(1, "netft settings")
        future = self._worker.submit(work)
        while not future.done():
            yield
        return future.result()

    def _trust(self) -> None:
        """The software bias covers whatever the sensor subtracts."""
        if self.sensor_bias is SensorBias.UNKNOWN:
            self.sensor_bias = SensorBias.UNTOUCHED
