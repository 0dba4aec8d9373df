"""One acquisition of the bench over a device whose time is stepped: engine, host, bed, watch, no thread."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from crtk_driver_virtual.defective_device import DefectiveDevice
from crtk_drivers import plugins, samples
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench import bed, host, recorder, watch
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.calls import About, HostOrder
from crtk_drivers.labs.bench.declared import Acquisition, Subject
from crtk_drivers.labs.bench.door import Door, Refused
from crtk_drivers.labs.bench.host import Host, Visitor
from crtk_drivers.labs.bench.trace import Row, Trace
from crtk_drivers.labs.bench.watch import Watch
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Stamp, Value
from crtk_drivers.session.opened import engine_options
from crtk_drivers.status.stop_request import StopRequest
from crtk_drivers.testing import loopback
from rigs.stepped_time import Steps

CONNECT = 1.0
"""Seconds."""


class SteppedDoor(Door):
    """A door to a host in this thread."""

    def __init__(self, hosting: Host) -> None:
        self._calls = hosting.calls(Visitor())

    def close(self) -> None:
        """It holds nothing."""

    def call(self, name: str, *arguments: Any, within: float = 0.0) -> Any:
        try:
            return self._calls[name](*arguments)
        except CrtkError as error:
            raise Refused(str(error), str(getattr(error, "reason", ""))) from error


class Rows:
    """What is recorded, as `read_recording` returns it; in place of `crtk_drivers.recording.Recorder`."""

    def __init__(self, steps: Steps) -> None:
        self.rows: list[Row] = []
        self._steps = steps

    def start(self) -> None:
        """It has no thread."""

    def take(self, topic: str, value: Value, stamp: Stamp) -> None:
        self.rows.append((topic, self._steps.time_ns(), stamp.wall_ns, value))

    def close(self) -> Any:
        return SimpleNamespace(lost=0, error="")


def _made(plugin: DevicePlugin, config: Any, steps: Steps) -> Device:
    """Return the device; one that lets time pass within a cycle has that of the steps."""
    device = plugin.make(config)
    if isinstance(device, DefectiveDevice):
        return DefectiveDevice(config, Stamp.now, steps.let_pass)
    return device


@contextmanager
def _stepped(steps: Steps, rows: Rows) -> Iterator[None]:
    with (
        steps.instead_of_time(samples, loopback, bed, host, recorder, watch),
        patch.object(recorder, "Recorder", lambda *_, **__: rows),
    ):
        yield


def acquired(
    acquisition: Acquisition,
    plugin: str,
    values: Mapping[str, Any],
    thorough: float = 1.0,
) -> tuple[Trace, Subject]:
    """Carry out an acquisition; return what its analyses are given."""
    declared = plugins.device(plugin)
    config: Any = load(declared.config, from_values(values))
    steps = Steps(1.0 / config.rate)
    rows = Rows(steps)
    with _stepped(steps, rows):
        device = _made(declared, config, steps)
        options = engine_options(config)
        engine = Engine(device, plugin, options, steps.monotonic, steps.let_pass)
        period = 1.0 / device.capabilities.rate
        session: Any = SimpleNamespace(engine=engine)
        door = SteppedDoor(Host(session, HostOrder(plugin, config, str(Path("door")), b"key")))
        engine.connect(steps.monotonic() + CONNECT)
        steps.step = cycle = lambda: engine.cycle(steps.monotonic() + period)
        with patch.object(engine, "wait_for", steps.wait):
            about: About = door.call("about")
            watching = Watch(door, about, None, StopRequest())
            under = Bed("arm", about, door, watching, thorough)
            due = steps.monotonic()

            def go_on() -> None:
                nonlocal due
                cycle()
                if steps.monotonic() >= due:
                    due += watch.PERIOD
                    watching.look()

            steps.step = go_on
            door.call("record", "recording.mcap")
            acquisition.run(under)
            door.call("stop_recording")
    return Trace.of(rows.rows), Subject.of(about, (), {}, under.kept)
