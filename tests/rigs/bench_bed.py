"""One acquisition of the bench over a device in this process: its host, door and watch, without theirs."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crtk_drivers import plugins
from crtk_drivers.config import from_values, load
from crtk_drivers.labs.bench.acquisition import Acquisition, Subject
from crtk_drivers.labs.bench.bed import Bed, Process
from crtk_drivers.labs.bench.calls import About, ClientOrder, HostOrder
from crtk_drivers.labs.bench.client import start_client
from crtk_drivers.labs.bench.door import Door
from crtk_drivers.labs.bench.host import Host
from crtk_drivers.labs.bench.taping import read_recording
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.bench.watch import Watch
from crtk_drivers.samples import Vector
from crtk_drivers.session import Session
from crtk_drivers.status.stop_request import StopRequest
from rigs.waiting import LONG


class Clients:
    """The one process that a device in this process has beside it: a client that can be killed."""

    def __init__(self, door: str) -> None:
        self._door = door
        self._client: subprocess.Popen[bytes] | None = None

    def start_client(self, command: str, home: Vector, speed: Vector, rate: float) -> None:
        self._client = start_client(ClientOrder(self._door, b"key", command, home, speed, rate))

    def kill_client(self) -> None:
        assert self._client is not None
        self._client.kill()
        self._client.wait()

    def pid(self, which: Process) -> int:
        raise NotImplementedError

    def kill_driver(self) -> None:
        raise NotImplementedError

    def revive_driver(self) -> tuple[Door, Door]:
        raise NotImplementedError


def acquired(
    acquisition: Acquisition,
    plugin: str,
    values: Mapping[str, Any],
    folder: Path,
) -> tuple[Trace, Subject]:
    """Carry out an acquisition; return what its analyses are given."""
    declared = plugins.device(plugin)
    config: Any = load(declared.config, from_values(values))
    door = folder / "door"
    recording = folder / "recording.mcap"
    order = HostOrder(plugin, config, str(door), b"key")
    host, stop = Host(Session(declared, config), order), StopRequest()
    serving = threading.Thread(target=host.serve, args=(stop,))
    serving.start()
    try:
        with Door(str(door), b"key", LONG) as own:
            about: About = own.call("about", within=LONG)
            watch = Watch(Door(str(door), b"key", LONG), about, None, StopRequest())
            own.call("record", str(recording))
            watch.start()
            bed = Bed("arm", about, own, watch, 1.0, Clients(str(door)))
            try:
                acquisition.run(bed)
            finally:
                watch.close()
                own.call("stop_recording", within=LONG)
                own.call("leave")
    finally:
        stop.set()
        serving.join(LONG)
    subject = Subject.of(about, tuple(watch.lateness), {}, bed.kept)
    return Trace.of(read_recording(recording)), subject
