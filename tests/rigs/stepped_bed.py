"""One acquisition of the bench over devices whose time is stepped: engine, host, bed, watch, no thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from operator import itemgetter
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any
from unittest.mock import patch

from crtk_driver_virtual.defective_device import DefectiveDevice
from crtk_drivers import plugins, samples
from crtk_drivers.config import BoxConfig, DeviceConfig, from_values, load
from crtk_drivers.device import Device
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench import bed, host, operated, operator, taping, watch
from crtk_drivers.labs.bench.acquisition import Acquisition, Subject
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import About, HostOrder
from crtk_drivers.labs.bench.door import Door, Refused
from crtk_drivers.labs.bench.host import Host
from crtk_drivers.labs.bench.operator import Operator
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.bench.watch import Watch
from crtk_drivers.labs.carried import Carried
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.motion.arbiter import Client
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Pose, Stamp, Value
from crtk_drivers.session.opened import engine_options
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing import loopback
from crtk_sim_backends.ndi.defects import TrackerDefects
from crtk_sim_backends.netft.defects import TransducerDefects
from rigs.carried_marker import CarriedMarker, MarkerTracker
from rigs.carried_sensor import CarriedSensor
from rigs.stepped_time import Steps

CONNECT = 1.0
"""Seconds."""

SOUND = TransducerDefects()


class SteppedDoor(Door):
    """A door to a host in this thread."""

    def __init__(self, hosting: Host) -> None:
        self._calls = hosting.calls(Client("the bench"))

    def close(self) -> None:
        """It holds nothing."""

    def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
        try:
            return self._calls[name](*arguments)
        except CrtkError as error:
            raise Refused(str(error), str(getattr(error, "reason", ""))) from error


class Rows:
    """What is recorded, as `read_recording` returns it; in place of `crtk_drivers.recording.Recorder`."""

    def __init__(self, steps: Steps, prefix: str = "") -> None:
        self.rows: list[Row] = []
        self._steps = steps
        self._prefix = prefix

    def start(self) -> None:
        """It has no thread."""

    def take(self, topic: str, value: Value, stamp: Stamp) -> None:
        at = self._steps.time_ns()
        self.rows.append((f"{self._prefix}{topic}", at, stamp.wall_ns, value))

    def close(self) -> Any:
        return SimpleNamespace(lost=0, error="")


class Seat:
    """A device in this thread that is connected: its engine, and what the bench has of it.

    Args:
        device, plugin, config: of it.
        steps: of the time.
        prefix: of the topics in its recording.
    """

    def __init__(
        self, device: Device, plugin: str, config: DeviceConfig, steps: Steps, prefix: str = ""
    ) -> None:
        options = engine_options(config)
        self.engine = Engine(device, plugin, options, steps.monotonic, steps.let_pass)
        self.recorded = Rows(steps, prefix)
        self._steps = steps
        self._period = 1.0 / device.capabilities.rate
        recordings = SimpleNamespace(may_be_asked=False)
        self._behind = {
            name: Engine(child, plugin, options, steps.monotonic, steps.let_pass)
            for name, child in device.children.items()
        }
        session: Any = SimpleNamespace(
            engine=self.engine, children=self._behind, recordings=recordings
        )
        self.door = SteppedDoor(Host(session, HostOrder(plugin, config, str(Path("door")), b"key")))
        for engine in (self.engine, *self._behind.values()):
            engine.wait_for = steps.wait  # type: ignore[method-assign]
            engine.connect(steps.monotonic() + CONNECT)

    def cycle(self) -> None:
        for engine in (self.engine, *self._behind.values()):
            engine.cycle(self._steps.monotonic() + self._period)

    def look(self) -> Pose | None:
        """Return the pose that it tells, None as long as it tells none."""
        pose, stamp = self.engine.feedback("measured_cp") or (None, None)
        return pose if isinstance(pose, Pose) and stamp is not None and stamp.wall_ns else None


def _made(plugin: DevicePlugin, config: Any, steps: Steps) -> Device:
    """Return the device; one that lets time pass within a cycle has that of the steps."""
    device = plugin.make(config)
    if isinstance(device, DefectiveDevice):
        return DefectiveDevice(config, Stamp.now, steps.let_pass)
    return device


@contextmanager
def _seated(
    plugin: str, values: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[Seat, Steps]]:
    """Give a device that is connected, and the steps of its time; each does a cycle of it."""
    declared = plugins.device(plugin)
    config: Any = load(declared.config, from_values(values))
    steps = Steps(1.0 / config.rate)
    with steps.instead_of_time(samples, loopback, bed, host, operated, operator, taping, watch):
        seat = Seat(_made(declared, config, steps), plugin, config, steps, prefix)
        steps.step = seat.cycle
        yield seat, steps


def about(plugin: str, values: Mapping[str, Any]) -> About:
    """Return what the bench is told of a device."""
    with _seated(plugin, values) as (seat, _):
        found: About = seat.door.call("about")
    return found


def acquired(
    acquisition: Acquisition,
    plugin: str,
    values: Mapping[str, Any],
    thorough: float = 1.0,
    operator: Operator | None = None,
) -> tuple[Trace, Subject]:
    """Carry out an acquisition, perhaps with somebody beside it; return what its analyses are given."""
    with _seated(plugin, values) as (seat, steps):
        told: About = seat.door.call("about")
        watching = Watch(seat.door, told, None, StopRequest())
        under = Bed("arm", told, seat.door, watching, thorough, operator=operator)
        _carry_out(acquisition, under, steps, {watching: seat})
    return Trace.of(seat.recorded.rows), Subject.of(told, (), {}, under.kept)


def acquired_carried(
    acquisition: Acquisition,
    carried: Carried,
    values: Mapping[str, Any],
    defects: TransducerDefects = SOUND,
    behind: int = 0,
) -> tuple[Trace, Subject]:
    """Carry out an acquisition of a sensor on a virtual arm; return what its analyses are given.

    Args:
        acquisition: of the sensor.
        carried: how it sits on the arm, and its tool.
        values: of the arm.
        defects: of the sensor.
        behind: cycles by which what it tells is older than its stamp.
    """

    def sensor(arm: Seat, rate: float) -> Device:
        return CarriedSensor(rate, carried, arm.look, defects, behind)

    trace, told, kept = _acquired_on_arm(acquisition, values, sensor)
    return trace, Subject.of(told, (), {}, kept, carried)


def acquired_marked(
    acquisition: Acquisition,
    values: Mapping[str, Any],
    defects: TrackerDefects,
    bounds: Mapping[str, BoundEntry] = MappingProxyType({}),
    box: BoxConfig | None = None,
) -> tuple[Trace, Subject]:
    """Carry out an acquisition of a tracker that sees the marker of a virtual arm; return the same.

    Args:
        acquisition: of the tracker.
        values: of the arm.
        defects: of the tracker.
        bounds: as of a lab file.
        box: in which the tool of the arm must stay.
    """

    def tracker(arm: Seat, rate: float) -> Device:
        return MarkerTracker(CarriedMarker(arm.look, defects))

    trace, told, kept = _acquired_on_arm(acquisition, values, tracker, box)
    return trace, Subject.of(told, (), bounds, kept, markers=("marker",))


def _acquired_on_arm(
    acquisition: Acquisition,
    values: Mapping[str, Any],
    beside: Callable[[Seat, float], Device],
    box: BoxConfig | None = None,
) -> tuple[Trace, About, Mapping[str, Any]]:
    """Carry out an acquisition of what a virtual arm carries; return its recording, what it is, and kept.

    Args:
        acquisition: of that.
        values: of the arm.
        beside: makes it, of the arm and its rate.
        box: in which the tool of the arm must stay.
    """
    with _seated("virtual", values, "carrier/") as (arm, steps):
        about_arm: About = arm.door.call("about")
        device = beside(arm, about_arm.capabilities.rate)
        carried = Seat(device, "carried", DeviceConfig(), steps)

        def both() -> None:
            arm.cycle()
            carried.cycle()

        steps.step = both
        told: About = carried.door.call("about")
        own, other = (
            Watch(seat.door, each, its, StopRequest())
            for seat, each, its in ((carried, told, None), (arm, about_arm, box))
        )
        own.join(other)
        carrier = Bed("arm", about_arm, arm.door, other, 1.0)
        under = Bed("carried", told, carried.door, own, 1.0, None, carrier)
        _carry_out(acquisition, under, steps, {own: carried, other: arm})
    rows = sorted([*carried.recorded.rows, *arm.recorded.rows], key=itemgetter(1))
    return Trace.of(rows), told, under.kept


def _carry_out(
    acquisition: Acquisition, under: Bed, steps: Steps, watched: Mapping[Watch, Seat]
) -> None:
    """Carry out an acquisition, with all of it watched and recorded."""
    cycle, due = steps.step, steps.monotonic()

    def go_on() -> None:
        nonlocal due
        cycle()
        if steps.monotonic() >= due:
            due += watch.PERIOD
            for watching in watched:
                watching.look()

    steps.step = go_on
    for seat in watched.values():
        with patch.object(taping, "Recorder", lambda *_, to=seat.recorded, **__: to):
            seat.door.call("record", "recording.mcap")
    acquisition.run(under)
    for seat in watched.values():
        seat.door.call("stop_recording")
