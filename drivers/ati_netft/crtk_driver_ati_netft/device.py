"""The NetFT sensor as a CRTK device: it measures, and that is all.

What the operating state means for a device without motors. Connected, it measures, and what it measures is
published and valid in any state. ENABLED says that somebody relies on it: entering ENABLED takes a sensor
without errors and fresh measurements, and an error (status bits, a frozen transducer, a restart) ends it in
FAULT, so that a loop that is closed over the sensor is told by the state and not by its data alone. DISABLED
and PAUSED ask for nothing. There is nothing to find (`home` returns at once, is_homed is always true), and
the device is never busy.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Mapping
from pathlib import Path

from typing_extensions import override

from crtk_driver_ati_netft.blocks import Block, BlockReader
from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.compensation import Tool, ToolFit, transfer
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.connecting import Connector
from crtk_driver_ati_netft.orientation import Arm, OrientationSource, rotation_of
from crtk_driver_ati_netft.page_watch import JumpWatch, PageWatch
from crtk_driver_ati_netft.pipeline import Listener, Pipeline, Published
from crtk_driver_ati_netft.profiles import NETBOX, PROFILES, Profile
from crtk_driver_ati_netft.recording import Recorder, Recordings, describe
from crtk_driver_ati_netft.services import SensorBias, SensorServices
from crtk_driver_ati_netft.source import Source
from crtk_driver_ati_netft.stream import RECEIVE_BUFFER, Batch
from crtk_driver_ati_netft.tcp_stream import TcpStream
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.commands import Payload
from crtk_drivers.device import (
    Capabilities,
    Condition,
    Input,
    Note,
    Sensor,
    Service,
    Severity,
    StopPolicy,
)
from crtk_drivers.errors import ConnectionLost
from crtk_drivers.kit.averaging import Averaging
from crtk_drivers.kit.sensing.load_monitor import LoadMonitor
from crtk_drivers.kit.sensing.sequence import Event
from crtk_drivers.samples import Array, Sample, Stamp, Value, Vector, Wrench, vector
from crtk_drivers.state import OperatingState

logger = logging.getLogger(__name__)

_COUNTER_UNITS: Mapping[str, str] = {
    "tick_rate": "Hz",
    "record_rate": "Hz",
    **{f"arrival_jitter_{part}": "s" for part in ("p50", "p99", "max")},
    "filter_delay": "s",
    "receive_buffer": "B",
    "peak_of_rated": "share",
    **{f"bias_f{axis}": "N" for axis in "xyz"},
    **{f"bias_t{axis}": "N·m" for axis in "xyz"},
}


class NetFtDevice(Sensor):
    """One sensor.

    Besides CRTK it has the services and inputs of `crtk_driver_ati_netft.services`, and for programs in the
    same process every measurement: `blocks`, `add_listener`, `start_recording`.
    """

    def __init__(self, config: NetFtConfig) -> None:
        self._config = config
        self.info: SensorInfo | None = None
        """What the sensor said of itself when it was connected last."""
        self.profile: Profile = PROFILES.get(config.profile, NETBOX)
        self.web = self._way_to_web()
        self._source: Source | None = None
        self._aborted = False
        self._connected_before = False
        self._just_opened = False
        self._due = 0.0
        self._averaging: Averaging | None = None
        self.monitor = LoadMonitor(self.profile.status, config.alarm, config.on_saturation)
        measuring = config.measuring_frame_id or config.frame_id
        self._measuring_frame = measuring
        self.pipeline = Pipeline(
            config.rate,
            config.low_pass,
            transfer(vector(config.point), rotation_of(config.rotation)),
            vector(config.gravity),
            f"ati-netft {self.address}",
        )
        self.pipeline.set_bias(vector(config.bias))
        if config.tool is not None:
            tool = Tool(config.tool.mass, vector(config.tool.center_of_mass))
            self.pipeline.set_tool(tool)
        self._recordings = Recordings(self.pipeline.ring)
        self._orientation = OrientationSource(config, self.pipeline)
        self._page_watch = PageWatch(self._way_to_web, config.page_period, self.address)
        self._jumps = JumpWatch(vector([]))
        self._services = SensorServices(self)
        self._capabilities = Capabilities(
            measured=("measured_cf", "raw/measured_cf"),
            rate=config.rate,
            paced_by_stream=True,
            base_frame=config.frame_id,
            tool_frame=measuring,
            transition_timeout=10.0,
            stop=StopPolicy(0.0, "has nothing that moves"),
        )

    # -------------------------------------------------------------------------- programs in this process

    @property
    def source(self) -> Source:
        """What brings the measurements.

        Raises:
            ConnectionLost: the device is not open.
        """
        if self._source is None:
            raise ConnectionLost("not connected", where=self.address, remedy="Open it first.")
        return self._source

    def blocks(self) -> BlockReader:
        """Return a reader of every measurement from now on; iterate over it for blocks.

        It ends when the device is closed, and begins again after it, so that a lost link is a pause.
        """
        return self.pipeline.reader()

    def newest(self, count: int) -> Block:
        """Return the newest measurements, at most `count` and at most those of the last seconds."""
        return self.pipeline.ring.newest(count)

    def add_listener(self, listener: Listener) -> None:
        """Call `listener` with every block, in the I/O thread: it must return at once."""
        self.pipeline.add_listener(listener)

    def remove_listener(self, listener: Listener) -> None:
        """Call it no more."""
        self.pipeline.remove_listener(listener)

    @property
    def recorder(self) -> Recorder | None:
        """What writes the recording that goes on, or the one that failed last."""
        return self._recordings.recorder

    def start_recording(self, path: str | Path) -> Recorder:
        """Write every measurement from now on, until `stop_recording`; goes on after a lost connection.

        Args:
            path: of a file that is not there yet; ``.csv`` for text. See `crtk_driver_ati_netft.recording`.

        Raises:
            ConfigError: it cannot be written, or a recording goes on.
        """
        header = describe(self._config, self.profile.name, self.info, self.bias, self.pipeline.tool)
        return self._recordings.begin(Path(path), header)

    def stop_recording(self) -> Recorder | None:
        """End the recording; return what wrote it, with its figures, None if there was none."""
        return self._recordings.end()

    def follow(self, arm: Arm | None) -> None:
        """Take the orientation from the ``measured_cp`` of the arm that carries the sensor; None: from none.

        Args:
            arm: in this process (`crtk_drivers.connect`) or on ROS (`crtk_drivers.client.connect`). It is
                not closed.
        """
        self._orientation.follow(arm)

    # ---------------------------------------------------------------------------------------- the device

    @property
    @override
    def capabilities(self) -> Capabilities:
        return self._capabilities

    @property
    @override
    def address(self) -> str:
        return f"{self._config.host}:{self._config.rdt_port}"

    @property
    def config(self) -> NetFtConfig:
        """As it was given."""
        return self._config

    @override
    def open(self, deadline: float) -> None:
        connector = Connector(self._config, self.web, self._about_to_open)
        found = connector.connect(self._source, self.profile, deadline)
        self.info = found.info
        if found.profile is not self.profile:
            self.profile = found.profile
            config = self._config
            self.monitor = LoadMonitor(found.profile.status, config.alarm, config.on_saturation)
        self.monitor.clear()
        self.monitor.set_rated(found.info.rated)
        self._jumps = JumpWatch(found.info.rated)
        if found.page is not None and self._config.page_period:
            self._page_watch.begin(found.page)
        self._log_connection(found.info)
        if self._connected_before:
            self._services.doubt_bias("the connection was lost")
        self._connected_before = self._just_opened = True
        self.pipeline.restart()
        self.pipeline.ring.open()
        self._recordings.resume()
        self._orientation.start()
        self._due = 0.0

    @override
    def abort_open(self) -> None:
        self._aborted = True
        self.web.abort()
        if self._source is not None:
            self._source.abort()

    def _way_to_web(self) -> WebPages:
        config = self._config
        return WebPages(config.host, config.http_port, config.http_timeout)

    def _about_to_open(self, source: Source) -> None:
        self._source = source
        if self._aborted:
            source.abort()

    @override
    def close(self) -> None:
        self.pipeline.ring.close()
        self._recordings.pause()
        self._orientation.stop()
        self._page_watch.end()
        self._services.close()
        if self._source is not None:
            self._source.close()

    @override
    def read(self, deadline: float) -> Sample | None:
        source = self.source
        while True:
            batch = source.receive(deadline, min(self._due, deadline))
            if batch is None:
                return None
            self._follow(batch)
            published = self.pipeline.take(batch, source.record_rate)
            self._due = time.monotonic() + self.pipeline.pending
            if published is not None:
                return self._sample(published, batch)

    @property
    @override
    def condition(self) -> Condition:
        reason = self.monitor.fault(time.monotonic())
        if self._source is not None and self._source.frozen:
            reason = "the transducer is frozen: the sensor repeats one measurement"
        return Condition(OperatingState.FAULT, reason) if reason else Condition()

    # --------------------------------------------------------------------------------------- diagnostics

    @property
    @override
    def counters(self) -> Mapping[str, float]:
        counters = dict(self._source.counters) if self._source is not None else {}
        counters["record_rate"] = self._source.record_rate if self._source is not None else 0.0
        counters["error_records"] = float(self.monitor.error_records)
        counters["saturated_records"] = float(self.monitor.saturated_records)
        counters["peak_of_rated"] = self.monitor.peak
        counters["filter_delay"] = self.pipeline.delay
        counters["compensated"] = float(self.pipeline.compensation.is_known)
        bias = self.pipeline.compensation.bias
        for axis, value in zip(("fx", "fy", "fz", "tx", "ty", "tz"), bias.tolist(), strict=True):
            counters[f"bias_{axis}"] = value
        return counters

    @property
    @override
    def counter_units(self) -> Mapping[str, str]:
        return _COUNTER_UNITS

    @property
    @override
    def notes(self) -> tuple[Note, ...]:
        now = time.monotonic()
        monitor = self.monitor
        found = [
            (Severity.ERROR, "status", monitor.error(now)),
            (Severity.ERROR, "saturation", monitor.saturation(now)),
            (Severity.WARNING, "overload", monitor.overload(now)),
            (Severity.INFO, "notice", ", ".join(monitor.notices)),
            (Severity.ERROR, "compensation", self._orientation.note()),
            (Severity.WARNING, "receive_buffer", self._buffer_note()),
            (Severity.WARNING, "transport", self._transport_note()),
            (Severity.WARNING, "page", self._page_watch.trouble),
            *self._recordings.notes(),
            *self._services.notes(),
        ]
        if self.info is not None:
            found += [(Severity.WARNING, "web page", text) for text in self.info.problems]
            found.append((Severity.INFO, "sensor", _describe(self.info, self.profile)))
        return tuple(Note(severity, key, text) for severity, key, text in found if text)

    @property
    def orientation_problem(self) -> str:
        """Why the orientation is not known now; empty if it is."""
        return self._orientation.problem

    def _buffer_note(self) -> str:
        granted = self._source.counters.get("receive_buffer", 0.0) if self._source else 0.0
        if not granted or granted >= min(self._config.receive_buffer, RECEIVE_BUFFER):
            return ""
        return (
            f"the kernel grants {granted / 1024:.0f} KiB: measurements may be lost on a busy machine "
            f"(sudo sysctl net.core.rmem_max={self._config.receive_buffer})"
        )

    def _transport_note(self) -> str:
        if self._config.transport != "auto" or not isinstance(self._source, TcpStream):
            return ""
        return (
            f"nothing came from UDP port {self._config.rdt_port}: measuring over TCP, with 16 bits, "
            "until the next connection"
        )

    def _log_connection(self, info: SensorInfo) -> None:
        logger.info("%s: %s", self.address, _describe(info, self.profile))
        if text := self._buffer_note():
            logger.warning("%s: %s", self.address, text)

    # ------------------------------------------------------------------------- services and inputs

    @property
    @override
    def services(self) -> Mapping[str, Service]:
        return self._services.table

    @property
    @override
    def inputs(self) -> Mapping[str, Input]:
        taken = {
            "set_bias": Input(
                "software bias, in the sensor's frame", Payload.WRENCH, self._services.take_bias
            )
        }
        if self._orientation.has_input:
            taken["orientation"] = Input(
                "pose of the sensor, or of what it is mounted on, in a frame at rest",
                Payload.POSE,
                self._orientation.take,
            )
        return taken

    @property
    def bias(self) -> Vector:
        """The software bias (6,), in the sensor's frame, N and N·m."""
        return self.pipeline.compensation.bias

    @property
    def tool_fit(self) -> ToolFit | None:
        """The result of the last calibration, with its residuals; None if there was none."""
        return self._services.fit

    @property
    def sensor_bias(self) -> SensorBias:
        """What is known of the sensor's own bias."""
        return self._services.sensor_bias

    def begin_average(self, seconds: float) -> Averaging:
        """Average the measurements from now on; the newest average asked for is the one that goes on."""
        self._averaging = Averaging(seconds, time.monotonic())
        return self._averaging

    # --------------------------------------------------------------------------------------- inside

    def _follow(self, batch: Batch) -> None:
        now = time.monotonic()
        self.monitor.take(batch.status, batch.values, now)
        if self._jumps.take(batch.values):
            self._page_watch.look()
        if change := self._page_watch.change:
            self._services.doubt_bias("the sensor was set otherwise")
            raise ConnectionLost(
                f"the sensor's page says something else than when it was connected: {change}",
                where=self.address,
                remedy="The driver reads its configuration again. Check who sets the sensor.",
            )
        just_opened, self._just_opened = self._just_opened, False
        for event, _ in batch.events:
            self._happened(event, just_opened)
        averaging = self._averaging
        if averaging is None:
            return
        averaging.take(batch.values, batch.times)
        averaging.spoilt = self.monitor.error(now) or self.monitor.saturation(now)
        if averaging.done:
            self._averaging = None

    def _happened(self, event: Event, just_opened: bool) -> None:
        if event is Event.RESTARTED:
            self._services.doubt_bias("the sensor was restarted")
        if event is Event.RESTARTED and not just_opened:
            raise ConnectionLost(
                "the sensor was restarted: its bias is gone, and its scale may be another",
                where=self.address,
                remedy="The driver reads its configuration again. Set the bias anew.",
            )
        if event is Event.TAKEN_OVER:
            self._services.doubt_bias("another client had the sensor")
            logger.warning(
                "%s: another client seems to use the sensor, which sends to one only", self.address
            )

    def _sample(self, published: Published, batch: Batch) -> Sample:
        value, raw = published.value, published.raw
        stamp = Stamp(published.wall_ns, published.time)
        if not self.monitor.is_value_valid(self.pipeline.rest) or self.source.frozen:
            stamp = Stamp(0, float(batch.times[-1]))
        values: dict[str, Value] = {"raw/measured_cf": _wrench(raw, self._config.frame_id)}
        if value is not None:
            values["measured_cf"] = _wrench(value, self._measuring_frame)
        return Sample(stamp, values)


def _wrench(values: Array, frame_id: str) -> Wrench:
    values.setflags(write=False)
    return Wrench(values[:3], values[3:], frame_id)


def _describe(info: SensorInfo, profile: Profile) -> str:
    parts = [
        info.product or profile.summary,
        f"serial {info.serial}" if info.serial else "",
        f"firmware {info.firmware}" if info.firmware else "",
        f"calibration {info.calibration_serial}" if info.calibration_serial else "",
        f"{info.rdt_rate} records/s" if info.rdt_rate else "",
    ]
    return ", ".join(part for part in parts if part)
