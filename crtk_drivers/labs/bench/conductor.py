"""The process that conducts a run: it starts simulators and drivers, watches, moves and records, in order.

Its parent (`crtk_drivers.labs.bench.run`) judges what it records and tells after each acquisition whether the
device may be moved any further. When this process dies, the hosts hold and leave their devices by themselves.
"""

from __future__ import annotations

import contextlib
import logging
import os
import pickle
import secrets
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, Final

from typing_extensions import override

from crtk_drivers import plugins
from crtk_drivers.config import DeviceConfig, from_values, load
from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench import programs
from crtk_drivers.labs.bench.acquisition import Acquisition, Safety
from crtk_drivers.labs.bench.bed import Bed, Broken, Process, Tripped
from crtk_drivers.labs.bench.calls import About, ClientOrder, Glance, HostOrder
from crtk_drivers.labs.bench.catalogue import ACQUISITIONS
from crtk_drivers.labs.bench.client import start_client
from crtk_drivers.labs.bench.conducting import (
    Acquired,
    Began,
    DeviceOrder,
    Lost,
    Reached,
    RunOrder,
)
from crtk_drivers.labs.bench.door import Door, bound_waits
from crtk_drivers.labs.bench.operator import Operator, Person
from crtk_drivers.labs.bench.relay import RelayProcess
from crtk_drivers.labs.bench.taping import carrier_recording
from crtk_drivers.labs.bench.watch import Watch, let_go
from crtk_drivers.labs.reports import last_line
from crtk_drivers.labs.sim_coupling import Coupling, Told, followed
from crtk_drivers.plugins import RunningSim, SimFault
from crtk_drivers.samples import Pose, Vector, Wrench
from crtk_drivers.session import start_sim_of
from crtk_drivers.status.pulse import Pulse, pulse_ends
from crtk_drivers.status.stop_request import StopRequest, stop_signals

START_TIMEOUT: Final = 40.0
CONNECT_TIMEOUT: Final = 10.0
LEAVE_TIMEOUT: Final = 10.0

PARENT_STANDS_STILL: Final = 10.0
"""Seconds without a sign of life after which whoever started this is gone. It may reckon at length."""

TELL_TIMEOUT: Final = 30.0
"""Seconds in which a part of a message is taken."""

LEFT: Final = 3
"""Exit code: everything was held and left, since whoever started this stands still."""

_POLL_PERIOD: Final = 0.1

logger = logging.getLogger(__name__)


@dataclass
class Conducting:
    """The process that conducts a run, as whoever started it has it.

    Attributes:
        process: that was started.
        pipe: leads to it.
        pulse: by which the two hear each other.
        held: a descriptor that ends when this process has ended, and all that it has started to move devices.
    """

    process: subprocess.Popen[bytes]
    pipe: Connection
    pulse: Pulse
    held: int


def start_conductor(order: RunOrder) -> Conducting:
    """Start the process that conducts a run.

    Raises:
        OSError: its log cannot be written.
    """
    with (order.folder / "log.txt").open("ab") as log:  # what simulators print too
        ours, theirs = Pipe()
        own_end, other_end = pulse_ends()
        held, holding = os.pipe2(os.O_CLOEXEC)
        with theirs, other_end, os.fdopen(holding, "wb"):
            order = replace(order, locks=(*order.locks, holding))
            numbers = (theirs.fileno(), other_end.fileno())
            process = programs.start(
                __name__,
                *map(str, numbers),
                order=order,
                log=log.fileno(),
                files=(*numbers, *order.locks),
            )
    return Conducting(process, ours, Pulse.start(own_end), held)


def conduct(order: RunOrder, parent: Connection, pulse: Pulse) -> int:
    """Carry out a run, and return the exit code."""
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s")
    bound_waits(parent, TELL_TIMEOUT)
    with stop_signals() as told:
        ending = _Ending(told, pulse)
        try:
            _Conductor(order, parent, ending).run()
        except (EOFError, BrokenPipeError, BlockingIOError):
            logger.error("whoever started this run is gone: everything is held and left")
        return LEFT if ending.is_alone() else 0


class _Ending(StopRequest):
    """Set when this process is told to end, or whoever started it is gone or stands still."""

    def __init__(self, told: StopRequest, pulse: Pulse) -> None:
        super().__init__()
        self._told = told
        self._parent = os.getppid()
        self._pulse = pulse
        self._stood_still = False

    @override
    def is_set(self) -> bool:
        return self._told.is_set() or self.is_alone()

    def is_alone(self) -> bool:
        """Whether whoever started this process is gone, or has stood still: it may go on later."""
        self._stood_still |= self._pulse.silence() > PARENT_STANDS_STILL
        return self._stood_still or os.getppid() != self._parent


class _Conductor:
    def __init__(self, order: RunOrder, parent: Connection, stop: _Ending) -> None:
        self._order = order
        self._parent = parent
        self._stop = stop
        self._devices = {device.name: device for device in order.devices}
        self._telling = threading.Lock()

    def run(self) -> None:
        """Test one device after the other: a simulator that is not looked at keeps none from its time."""
        with tempfile.TemporaryDirectory(prefix="crtk-bench-") as doors:
            for device in self._order.devices:
                if self._stop.is_set():
                    return
                with self._hosted(device, Path(doors)) as host, ExitStack() as stack:
                    self._test(device, host, partial(self._carrier, host, Path(doors), stack))

    def _hosted(self, device: DeviceOrder, doors: Path) -> _Hosted:
        def lost() -> None:
            with contextlib.suppress(
                OSError
            ):  # who started this is gone: the rest is held all the same
                self._tell(Lost(device.name))

        return _Hosted(device, doors, self._order.folder, self._order.locks, lost)

    def _test(self, device: DeviceOrder, host: _Hosted, find: Callable[[], _Hosted]) -> None:
        """Test a device; `find` brings up the one that carries it, once that is needed."""
        try:
            about = host.about()
        except CrtkError as error:
            self._ask(Reached(device.name, None, str(error)))
            return
        wanted: tuple[str, ...] = self._ask(Reached(device.name, about))
        for name in wanted:
            if self._stop.is_set():
                return
            if not self._acquire(host, ACQUISITIONS[name], find):
                return

    def _carrier(self, host: _Hosted, doors: Path, stack: ExitStack) -> _Hosted:
        """Bring up the device that carries another one, for as long as that is tested.

        Raises:
            CrtkError: it does not measure.
        """
        if host.carrier is None:
            order = self._devices[host.order.on]
            host.carrier = stack.enter_context(self._hosted(order, doors))
            host.carrier.about()
        return host.carrier

    def _acquire(
        self, host: _Hosted, acquisition: Acquisition, find: Callable[[], _Hosted]
    ) -> bool:
        """Carry out one acquisition and return whether the device is used any further."""
        device = host.order.name
        self._tell(Began(device, acquisition.name))
        path = self._order.folder / "data" / f"{device}-{acquisition.name}.mcap"
        begin = time.monotonic()
        moves = acquisition.safety > Safety.READ
        trouble, broken = "", False
        watches: list[Watch] = []
        kept: dict[str, Any] = {}
        try:
            with ExitStack() as stack:
                # What only reads is not stopped: a device that was found powered stays so.
                other = find() if acquisition.carrier_needs else None
                moves_own = moves and other is None
                watch = stack.enter_context(self._recorded(host, path, moves_own))
                watches.append(watch)
                carrier = None
                if other is not None:
                    for coupling in host.couplings(stack.enter_context(other.connected())):
                        stack.enter_context(coupling)
                    beside = carrier_recording(path)
                    watches.append(stack.enter_context(self._recorded(other, beside, moves)))
                    watch.join(watches[-1])
                    carrier = self._bed(other, watches[-1], other.order.sim)
                processes = host.order.sim or acquisition.relayed
                operator: Operator | None = None
                if acquisition.by_operator:
                    operator = host if host.order.sim else Person(self._tell, device)
                bed = self._bed(host, watch, processes, carrier, operator)
                kept = bed.kept
                carry_out(acquisition, bed, watch)
        except Tripped as error:
            trouble = f"{error}{host.stopped_told()}"
            broken = moves and not self._stop.is_set()
        except (Broken, CrtkError) as error:
            trouble = f"{error}{host.stopped_told()}"
            broken = moves
        except Exception as error:
            logger.exception("%s: %s", device, acquisition.name)
            trouble, broken = f"the test itself broke: {type(error).__name__}: {error}", True
        goes_on: bool = self._ask(
            Acquired(
                device,
                acquisition.name,
                time.monotonic() - begin,
                path,
                tuple(late for watch in watches for late in watch.lateness),
                " ".join(trouble.split()),
                kept,
                moves and any(watch.tripped for watch in watches) and not self._stop.is_set(),
                broken,
            )
        )
        return goes_on

    @contextmanager
    def _recorded(self, host: _Hosted, path: Path, moves: bool) -> Iterator[Watch]:
        """Within, a device is recorded and watched; it is held and disabled if something ends that."""
        box = None if host.order.space is None else host.order.space.tool_box
        with host.connected() as watching:
            watch = Watch(watching, host.known, box, self._stop, host.lose)
            host.is_touched |= moves
            host.door.call("record", str(path))
            watch.start(moves)
            try:
                yield watch
            except BaseException as error:
                if moves:
                    host.settle()
                watch.close()
                with contextlib.suppress(CrtkError):  # what ended it is told
                    host.stop_recording()
                with contextlib.suppress(CrtkError):
                    host.dump(str(error), path)
                raise
            watch.close()
            host.stop_recording()

    def _bed(
        self,
        host: _Hosted,
        watch: Watch,
        processes: bool,
        carrier: Bed | None = None,
        operator: Operator | None = None,
    ) -> Bed:
        return Bed(
            host.order.name,
            host.known,
            host.door,
            watch,
            self._order.thorough,
            host if processes else None,
            carrier,
            operator,
            self._order.features,
        )

    def _ask(self, message: object) -> Any:
        self._tell(message)
        while not self._parent.poll(_POLL_PERIOD):
            if self._stop.is_alone():
                raise EOFError
        return self._parent.recv()

    def _tell(self, message: object) -> None:
        with self._telling:  # a watch tells what is lost
            self._parent.send(message)


def carry_out(acquisition: Acquisition, bed: Bed, watch: Watch) -> None:
    """Carry out an acquisition to its end.

    Raises:
        Tripped: the watch has stopped the device; what the device refuses after that has this reason, too.
        CrtkError: it failed otherwise.
    """
    try:
        acquisition.run(bed)
        bed.check()
    except CrtkError as error:
        if watch.tripped:
            raise Tripped(watch.tripped) from error
        raise


class _Hosted:
    """A device's simulator, if it has one, and the process of its driver. A context manager."""

    def __init__(
        self,
        order: DeviceOrder,
        doors: Path,
        folder: Path,
        locks: Sequence[int],
        lost: Callable[[], None],
    ) -> None:
        self.is_touched = False
        """More was done to it than to read: it is left disabled."""
        self.is_lost = False
        """It did not answer when it was to be held, or kept its power: nobody knows whether it stands."""
        self.carrier: _Hosted | None = None
        """The device that carries it, once that was needed."""
        self._order = order
        self._path = str(doors / f"{order.name}.door")
        self._key = secrets.token_bytes(32)
        self._log = folder / f"{order.name}.log"
        self._locks = locks
        self._lost = lost
        self._process: subprocess.Popen[bytes] | None = None
        self._client: subprocess.Popen[bytes] | None = None
        self._sim: RunningSim | None = None
        self._door: Door | None = None
        self._about: About | None = None
        self._trouble: CrtkError | None = None
        self._host: HostOrder | None = None
        self._pulse: Pulse | None = None
        self._direct: HostOrder | None = None
        self._relay: RelayProcess | None = None

    def __enter__(self) -> _Hosted:
        try:
            self._start()
        except CrtkError as error:
            self._trouble = error
        return self

    def __exit__(self, *_: object) -> None:
        if self._door is not None and self.is_touched:
            self.settle()
        self._leave_driver()
        if self._process is not None and self._process.returncode != 0:
            code = self._process.returncode
            logger.error("%s: its driver ended with exit code %d", self._order.name, code)
            self.lose()
        if self._pulse is not None:
            self._pulse.close()
        if self._relay is not None:
            self._relay.close()
        if self._sim is not None:
            self._sim.stop()

    def _leave_driver(self) -> None:
        """Let the driver end, which leaves its device holding."""
        if self._door is not None:
            with contextlib.suppress(CrtkError):
                self._door.call("leave")
            self._door.close()
        if self._process is not None:
            try:
                self._process.wait(LEAVE_TIMEOUT)
            except subprocess.TimeoutExpired:
                logger.error("%s: its driver did not end, and was killed", self._order.name)
                self._process.kill()
                self._process.wait()
                self.lose()

    @property
    def order(self) -> DeviceOrder:
        """Which device it is."""
        return self._order

    @property
    def door(self) -> Door:
        """The connection by which it is supervised and moved."""
        assert self._door is not None
        return self._door

    def about(self) -> About:
        """Return what it is, once it measures.

        Raises:
            CrtkError: it does not.
        """
        if self._trouble is not None:
            raise self._trouble
        self._door = Door(self._path, self._key, START_TIMEOUT, self._gone)
        self._about = self._door.call("about", within=START_TIMEOUT)
        return self.known

    def _gone(self) -> str:
        """Return that the driver's process has ended, and its last words; empty while it runs."""
        code = None if self._process is None else self._process.poll()
        if code is None:
            return ""
        said = last_line(self._log)
        return f"the driver's process ended with exit code {code}{said and ': '}{said}"

    @property
    def known(self) -> About:
        """What it is, as `about` found it."""
        assert self._about is not None
        return self._about

    def connected(self) -> Door:
        """Return another connection."""
        return Door(self._path, self._key, CONNECT_TIMEOUT, self._gone)

    def couplings(self, watching: Door) -> Iterator[Coupling]:
        """Yield what lets its simulator follow the device to which a connection leads."""
        entry, plugin = self._order.coupled, plugins.device(self._order.plugin)
        if entry is None:
            return

        def look() -> Told | None:
            glance: Glance = watching.call("glance")
            pose, stamp = glance.values.get("measured_cp", (None, None))
            if not isinstance(pose, Pose) or stamp is None or not stamp.wall_ns:
                return None
            return pose, stamp.wall_ns

        assert self._host is not None
        for each in followed(plugin, self._host.config, self._simulator, entry, self._order.name):
            yield Coupling(self._simulator, each, look)

    def stopped_told(self) -> str:
        """Return which of its processes stands still, to be put behind a reason; empty if none does."""
        pids = {
            Process.DRIVER: self._process and self._process.pid,
            Process.SIMULATOR: self._sim and self._sim.pid,
        }
        return "".join(
            f"; the {which}'s process {pid} is stopped"
            for which, pid in pids.items()
            if pid and programs.is_stopped(pid)
        )

    def stop_recording(self) -> None:
        """End the recording that is under way."""
        self.door.call("stop_recording", within=10.0)

    def dump(self, reason: str, path: Path) -> None:
        """Write its last seconds, commands and refusals among them, beside a recording."""
        beside = path.with_suffix(".black_box.mcap")
        self.door.call("dump", reason, str(beside), within=10.0)

    def settle(self) -> None:
        """Hold it, and disable it once it stands, however it is; not what does not answer any more."""
        if self.is_lost:
            return
        about = self._about
        timeout = LEAVE_TIMEOUT if about is None else about.capabilities.transition_timeout
        if not let_go(self.door, self._order.name, timeout):
            self.lose()

    def lose(self) -> None:
        """Tell that it could not be held or left, if more was done to it than to read."""
        if self.is_touched and not self.is_lost:
            self.is_lost = True
            self._lost()

    def _start(self) -> None:
        order = self._order
        plugin = plugins.device(order.plugin)
        own = from_values(dict(order.values))
        config: DeviceConfig = load(plugin.config, own)
        if order.space is not None:
            space = order.space.within(config.space)
            confined = from_values({"space": space.model_dump(exclude_none=True)})
            config = load(plugin.config, own, confined)
        if order.sim and plugin.sim is not None:
            self._sim = start_sim_of(plugin, config, order.sim_options)
            config = plugin.sim_config(config, self._sim)
        self._host = HostOrder(plugin.name, config, self._path, self._key)
        self._start_driver()

    def _start_driver(self) -> None:
        assert self._host is not None
        if self._pulse is not None:
            self._pulse.close()
        own_end, other_end = pulse_ends()
        self._pulse = Pulse.start(own_end)
        with other_end, self._log.open("ab") as log:
            self._process = programs.start(
                "crtk_drivers.labs.bench.host",
                order=replace(self._host, pulse=other_end.fileno()),
                log=log.fileno(),
                files=(other_end.fileno(), *self._locks),
            )

    # ------------------------------------------------------------------------------- as `Processes`

    def pid(self, which: Process) -> int:
        """Return the id of a process."""
        if which is Process.SIMULATOR:
            return self._simulator.pid
        assert self._process is not None
        return self._process.pid

    def inject(self, fault: str, **parameters: Any) -> None:
        """Begin a fault of the simulator."""
        try:
            self._simulator.control.inject(fault, **parameters)
        except RuntimeError as error:
            raise Broken(str(error)) from error

    is_person: Final = False

    def press_stop(self) -> None:
        """Press the emergency stop of the simulator."""
        self.begin(SimFault.EMERGENCY_STOP)

    def release_stop(self) -> None:
        """Pull it out again."""
        self.end(SimFault.EMERGENCY_STOP)

    def begin(self, fault: SimFault, **parameters: Any) -> None:
        """Let something happen to the simulated device, until `end`."""
        self.inject(plugins.device(self._order.plugin).sim_faults[fault], **parameters)

    def end(self, fault: SimFault) -> None:
        """Let it end."""
        self._simulator.control.clear(plugins.device(self._order.plugin).sim_faults[fault])

    def load(self, wrench: Wrench) -> None:
        """Let a wrench act on the simulated sensor, in its frame, until the next one."""
        load = plugins.device(self._order.plugin).sim_load
        assert load is not None
        try:
            load(self._simulator, wrench)
        except RuntimeError as error:
            raise Broken(str(error)) from error

    def pressing(self) -> float:
        """Return the N with which the fingers of the simulated gripper press on what they hold."""
        return float(self._simulator.control.status()["pressing"])

    @property
    def _simulator(self) -> RunningSim:
        if self._sim is None:
            raise Broken(f"it has no {Process.SIMULATOR}")
        return self._sim

    def kill_driver(self) -> None:
        """End the driver as by a power cut of its computer."""
        assert self._process is not None
        self._process.kill()
        self._process.wait()
        self.door.close()
        Path(self._path).unlink(missing_ok=True)

    def start_client(self, command: str, home: Vector, speed: Vector, rate: float) -> None:
        """Start a process that streams to the driver."""
        order = ClientOrder(self._path, self._key, command, home, speed, rate)
        self._client = start_client(order)

    def kill_client(self) -> None:
        """End that process as by ``kill -9``."""
        client, self._client = self._client, None
        if client is not None:
            client.kill()
            client.wait()

    def revive_driver(self) -> tuple[Door, Door]:
        """Start the driver again; return the connection that supervises it, and one for the watch."""
        self._start_driver()
        self.about()
        return self.door, self.connected()

    def put_relay(self) -> tuple[Door, Door, RelayProcess]:
        """Start the driver anew, at a relay to its device; return two connections, and the relay."""
        assert self._host is not None
        plugin, config = plugins.device(self._host.plugin), self._host.config
        link = None if plugin.link is None else plugin.link.of(config, self._sim)
        if plugin.link is None or link is None:
            raise Broken("its driver reaches it over nothing that a relay could cut")
        self._direct = self._host
        self._leave_driver()  # a serial line has one user
        try:
            self._relay = RelayProcess(link)
            self._restart(replace(self._host, config=plugin.link.at(config, self._relay.link)))
        except CrtkError:
            with contextlib.suppress(CrtkError):  # that it is not there is seen when it is held
                self._return_to_device()
            raise
        return self.door, self.connected(), self._relay

    def take_relay(self) -> tuple[Door, Door]:
        """Start the driver anew, at its device; return two connections."""
        self._return_to_device()
        return self.door, self.connected()

    def _return_to_device(self) -> None:
        assert self._direct is not None
        self._leave_driver()
        if self._relay is not None:
            self._relay.close()
            self._relay = None
        self._restart(self._direct)

    def _restart(self, order: HostOrder) -> None:
        Path(self._path).unlink(missing_ok=True)
        self._host = order
        self._start_driver()
        self.about()


def hosted(
    order: DeviceOrder,
    doors: Path,
    folder: Path,
    locks: Sequence[int],
    lost: Callable[[], None],
) -> _Hosted:
    """Return a device with its simulator and the process of its driver, which run while its context lasts.

    Args:
        order: the device.
        doors: folder for the socket of its process.
        folder: for its log.
        locks: files of `locks.alone`.
        lost: called when it cannot be held or left.
    """
    return _Hosted(order, doors, folder, locks, lost)


def main() -> int:
    """Conduct the run whose order comes on standard input; two descriptors lead to its parent."""
    order: RunOrder = pickle.load(sys.stdin.buffer)
    parent, pulse = map(int, sys.argv[1:])
    return conduct(order, Connection(parent), Pulse.start(socket.socket(fileno=pulse)))


if __name__ == "__main__":
    sys.exit(main())
