"""One run of the bench: the judging of recordings, and results that are kept as they come.

This is the parent of the conductor. It moves nothing; what it reckons keeps no driver from its cycle, since
that is another process.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import subprocess
import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Final

from crtk_drivers.errors import ConfigError, RecordingError
from crtk_drivers.labs.bench import results
from crtk_drivers.labs.bench.acquisition import BenchTest, Subject
from crtk_drivers.labs.bench.allowed import BenchOptions, Carrier, lacking, unguarded
from crtk_drivers.labs.bench.bounds import check_bounds
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.catalogue import ACQUISITIONS, QUANTITIES, TESTS, chosen
from crtk_drivers.labs.bench.conducting import (
    Acquired,
    Asked,
    Began,
    DeviceOrder,
    Lost,
    Reached,
    RunOrder,
)
from crtk_drivers.labs.bench.conductor import LEFT, Conducting, start_conductor
from crtk_drivers.labs.bench.door import bound_waits
from crtk_drivers.labs.bench.folder import begun, described, make_folder
from crtk_drivers.labs.bench.locks import alone
from crtk_drivers.labs.bench.pressure import Pressure
from crtk_drivers.labs.bench.taping import read_recording
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.lab_file import BoundEntry, Lab, LabDevice
from crtk_drivers.labs.lab_outline import load_outline
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.status.stop_request import StopRequest

POLL_PERIOD: Final = 0.1

END_TIMEOUT: Final = 60.0
"""Seconds in which the conductor has held and left everything."""

STANDS_STILL: Final = 5.0
"""Seconds without a sign of life after which the conductor is killed. Hosts have left by then."""

STARTED_WITHIN: Final = 60.0
"""Seconds in which it gives the first one."""

LEFT_WITHIN: Final = 5.0
"""Seconds in which drivers whose conductor died hold and leave their devices, before power is taken away."""

logger = logging.getLogger(__name__)

Progress = Callable[[str, str, Verdict | None, str], None]
"""Told of each test as it begins (None) and ends: device, test, verdict, reason."""


@dataclass
class _Tested:
    """A device while it is tested."""

    lab: LabDevice
    device: results.DeviceResult
    tests: tuple[BenchTest, ...]
    about: About | None = None
    done: dict[str, results.Result] = field(default_factory=dict)
    stopped: str = ""
    is_off: bool = False

    def as_carrier(self) -> Carrier:
        """Return it as what carries another one."""
        return Carrier(self.lab, self.about, self.stopped)


@dataclass
class _Conducted:
    """A conductor, and what it was told to do."""

    conducting: Conducting
    order: RunOrder
    pressure: Pressure = field(default_factory=Pressure)
    stood_still: str = ""
    """That it was killed because it stood still, in words."""

    @property
    def process(self) -> subprocess.Popen[bytes]:
        """The conductor."""
        return self.conducting.process

    @property
    def pipe(self) -> Connection:
        """The connection to it."""
        return self.conducting.pipe

    def answer(self, value: object) -> None:
        """Answer what it asked; that it is gone is seen when it is heard next."""
        with contextlib.suppress(OSError):
            self.pipe.send(value)

    def kill_if_it_stands_still(self) -> None:
        """Kill it if no sign of life comes any more: its drivers hold and leave their devices then."""
        pulse = self.conducting.pulse
        silence = pulse.silence()
        if silence > (STANDS_STILL if pulse.has_begun else STARTED_WITHIN):
            self.kill(f"gave no sign of life for {silence:.1f} s")

    def kill(self, why: str) -> None:
        """Kill it because it stands still."""
        if not self.stood_still:
            self.stood_still = (
                f"the conductor's process {self.process.pid} stood still ({why}), and was killed"
            )
            logger.error("%s", self.stood_still)
            self.process.kill()

    def wait_until_left(self, seconds: float) -> None:
        """Wait until the drivers that it had started have left their devices and ended."""
        if not select.select([self.conducting.held], [], [], seconds)[0]:
            logger.error("a driver has not left its device within %g s", seconds)

    def close(self) -> None:
        """Close what leads to it."""
        self.pipe.close()
        self.conducting.pulse.close()
        os.close(self.conducting.held)


def run_bench(
    lab: Lab,
    options: BenchOptions,
    progress: Progress,
    stop: StopRequest,
    ask: Callable[[str], None] = logger.warning,
) -> results.Run:
    """Test the devices of a lab.

    Args:
        lab: with the devices.
        options: what is done.
        progress: is told of each test.
        stop: ends the run.
        ask: tells the operator what to do, at once.

    Returns:
        what was found; it is in the folder too.

    Raises:
        ConfigError: another bench tests one of the devices, there is no such test or device, a bound is none,
            hardware would be tested at once with others, or the folder is there.
        OSError: the folder cannot be written.
    """
    tests = chosen(options.suite, options.only)
    check_bounds(lab, QUANTITIES)
    for name in options.may_travel:
        if name not in lab.settings.devices:
            raise ConfigError(
                f"there is no device {name!r} that may travel",
                where=str(lab.path),
                remedy=f"There is: {', '.join(lab.settings.devices)}.",
            )
    hardware = [device.name for device in lab.devices.values() if not device.simulated]
    if options.at_once > 1 and hardware:
        raise ConfigError(
            f"hardware is tested one device after the other, and {', '.join(hardware)} is not simulated",
            where="--at-once",
            remedy="Leave it out, or give --sim.",
        )
    with alone(lab) as locks:
        make_folder(options.out)
        return _Bench(lab, options, tests, progress, stop, ask).run(locks)


class _Bench:
    def __init__(
        self,
        lab: Lab,
        options: BenchOptions,
        tests: tuple[BenchTest, ...],
        progress: Progress,
        stop: StopRequest,
        ask: Callable[[str], None],
    ) -> None:
        self._lab = lab
        self._options = options
        self._progress = progress
        self._stop = stop
        self._ask = ask
        self._began = time.monotonic()
        self._tested = {
            name: _Tested(device, described(device), tests) for name, device in lab.devices.items()
        }
        suite = str(options.suite) if not options.only else f"only {', '.join(options.only)}"
        self._run = begun(lab, suite)

    def run(self, locks: tuple[int, ...]) -> results.Run:
        """Start conductors, judge what they record, and return what was found."""
        results.write_run(self._run, self._options.out)
        started: list[_Conducted] = []
        try:
            ended_by = self._follow(self._orders(locks), started)
        finally:
            for each in started:
                self._leave(each)
        for tested in self._tested.values():
            for test in tested.tests:
                if test.id not in tested.done:
                    why = tested.stopped or tested.device.trouble or ended_by or "not carried out"
                    verdict = Verdict.INCONCLUSIVE if tested.device.trouble else Verdict.SKIPPED
                    self._record(tested, _untested(test, verdict, why))
        self._run = self._run.model_copy(update={"complete": not ended_by, "ended_by": ended_by})
        self._keep()
        return self._run

    def _orders(self, locks: tuple[int, ...]) -> list[RunOrder]:
        """Return what each conductor does: one does all, unless more than one device is tested at once."""
        groups: dict[str, list[DeviceOrder]] = {}
        for device in self._lab.devices.values():
            on = _carrier_of(device, self._lab.devices)
            group = (on or device.name) if self._options.at_once > 1 else ""
            groups.setdefault(group, []).append(_order(device, self._lab.devices))
        thorough = self._options.suite.thorough
        return [
            RunOrder(
                tuple(devices), self._options.out, thorough, locks, self._lab.settings.features
            )
            for devices in groups.values()
        ]

    def _follow(self, orders: list[RunOrder], started: list[_Conducted]) -> str:
        """Start a conductor for each order, and answer them; return why they ended too early, or nothing."""
        asked, ended_by = 0.0, ""
        running: dict[Connection, _Conducted] = {}
        while orders or running:
            while orders and len(running) < self._options.at_once and not self._stop.is_set():
                order = orders.pop(0)
                conducting = start_conductor(order)
                bound_waits(conducting.pipe, STANDS_STILL)
                started.append(_Conducted(conducting, order))
                running[conducting.pipe] = started[-1]
            if self._stop.is_set() and not asked:
                asked = time.monotonic()
                orders.clear()
                for each in running.values():
                    each.process.terminate()  # it holds and leaves everything
            if asked and time.monotonic() > asked + END_TIMEOUT:
                for each in running.values():
                    each.process.kill()
            heard = wait(list(running), POLL_PERIOD)
            for pipe, each in list(running.items()):
                each.kill_if_it_stands_still()
                if pipe not in heard:
                    continue
                try:
                    message = pipe.recv()
                except (EOFError, OSError) as error:
                    if isinstance(error, BlockingIOError):
                        each.kill(f"in the midst of a message, for {STANDS_STILL:g} s")
                    ended_by = _why_ended(running.pop(pipe)) or ended_by
                    continue
                self._answer(each, message)
                self._keep()
        if asked and not any(each.stood_still for each in started):
            return "stopped by the operator"
        return ended_by

    def _leave(self, conducted: _Conducted) -> None:
        """Wait for the end of a conductor; take the power from its devices if that was none of its own."""
        conducted.pipe.close()
        if _code_of(conducted.process) is None:
            logger.error("the conductor did not end, and is killed")
            conducted.process.kill()
            conducted.process.wait()
        lost = conducted.process.returncode not in (0, LEFT)
        if lost:  # a stop is a ramp: power is taken after it
            conducted.wait_until_left(LEFT_WITHIN)
        conducted.close()
        if lost:
            for device in conducted.order.devices:
                if self._tested[device.name].about is not None:
                    self._power_off_of(self._tested[device.name])

    def _answer(self, conducted: _Conducted, message: object) -> None:
        match message:
            case Reached():
                conducted.answer(self._reached(message))
            case Began():
                conducted.pressure = Pressure()
                for test in self._judging(message.device, message.acquisition):
                    self._progress(message.device, test.id, None, test.name)
            case Acquired():
                conducted.answer(self._acquired(message, conducted.pressure.share))
            case Asked():
                self._ask(message.what)
            case Lost():
                self._power_off_of(self._tested[message.device])

    # ------------------------------------------------------------------------------- what it answers

    def _reached(self, message: Reached) -> tuple[str, ...]:
        """Note what a device is, skip what it cannot do, and return the acquisitions that are wanted."""
        tested = self._tested[message.device]
        about = message.about
        if about is None:
            tested.device = tested.device.model_copy(update={"trouble": message.trouble})
            self._progress(message.device, "", Verdict.INCONCLUSIVE, message.trouble)
            return ()
        tested.about = about
        tested.device = tested.device.model_copy(
            update={"address": about.name, "firmware": dict(about.readings)}
        )
        wanted: list[str] = []
        ids = {test.id for test in tested.tests}
        for test in tested.tests:
            carrier = self._tested.get(_carrier_of(tested.lab, self._tested))
            why = lacking(
                test,
                about,
                tested.lab,
                self._options,
                carrier=carrier.as_carrier() if carrier else None,
                faults=self._lab.settings.faults,
                features=self._lab.settings.features,
            ) or unguarded(test, self._moved_by(tested, test.acquisition.name).lab, ids)
            if why:
                self._record(tested, _untested(test, Verdict.SKIPPED, why))
            elif test.acquisition.name not in wanted:
                wanted.append(test.acquisition.name)
        return tuple(wanted)

    def _acquired(self, message: Acquired, waited: float) -> bool:
        """Judge a recording; return whether the device is used any further."""
        tested = self._tested[message.device]
        assert tested.about is not None
        subject = Subject.of(
            tested.about,
            message.lateness,
            self._lab.settings.bounds,
            message.kept,
            tested.lab.entry.carried,
            tested.lab.entry.markers_on(_carrier_of(tested.lab, self._tested)),
        )
        subject = replace(subject, waited=waited)
        self._keep_subject(message.recording, subject, message.trouble)
        guarded = ""
        judge = Judge(message.recording, subject, message.trouble)
        for test in self._judging(message.device, message.acquisition):
            findings = judge.findings(test)
            stored = results.test_of(
                test,
                findings,
                message.seconds,
                str(message.recording.relative_to(self._options.out)),
            )
            self._record(tested, stored)
            is_sound = stored.verdict is Verdict.PASS or (
                tested.device.simulated and stored.verdict is Verdict.INCONCLUSIVE
            )
            if test.guards and not is_sound:
                guarded = f"no more after {test.id}: {stored.verdict}: {stored.reason}"
        moved = self._moved_by(tested, message.acquisition)
        if message.tripped or message.broken:
            moved.stopped = f"no more after {message.acquisition}: {message.trouble}"
            guarded = guarded or moved.stopped
        if message.tripped:
            self._power_off_of(moved)
        tested.stopped = guarded
        return not guarded

    def _moved_by(self, tested: _Tested, acquisition: str) -> _Tested:
        """Return the device that an acquisition moves: the one that is tested, or what carries that."""
        is_carried = ACQUISITIONS[acquisition].carrier_needs
        on = _carrier_of(tested.lab, self._tested)
        return self._tested.get(on, tested) if is_carried else tested

    def _judging(self, device: str, acquisition: str) -> tuple[BenchTest, ...]:
        tested = self._tested[device]
        found = [test for test in tested.tests if test.acquisition.name == acquisition]
        return tuple(test for test in found if test.id not in tested.done)

    def _record(self, tested: _Tested, test: results.Result) -> None:
        tested.done[test.id] = test
        self._progress(tested.lab.name, test.id, test.verdict, test.reason)

    # ----------------------------------------------------------------------------------- what is kept

    def _keep_subject(self, recording: Path, subject: Subject, trouble: str) -> None:
        """Keep beside a recording what its analysis knows."""
        try:
            _subject_of(recording).write_text(f"{trouble}\n{subject.as_json()}\n", "utf-8")
        except OSError as error:
            logger.error("%s: cannot be written: %s", recording.name, error.strerror)

    def _keep(self) -> None:
        """Write what there is so far; a full disk is told, and ends nothing that holds an arm."""
        devices = []
        for tested in self._tested.values():
            in_order = [tested.done[test.id] for test in tested.tests if test.id in tested.done]
            tested.device = tested.device.model_copy(update={"tests": tuple(in_order)})
            devices.append(tested.device)
        seconds = round(time.monotonic() - self._began, 1)
        self._run = self._run.model_copy(update={"devices": tuple(devices), "seconds": seconds})
        try:
            results.write_run(self._run, self._options.out)
        except OSError as error:
            logger.error("%s: cannot be written: %s", self._options.out, error.strerror)

    def _power_off_of(self, tested: _Tested) -> None:
        if not tested.is_off:
            tested.is_off = take_power(tested.lab, self._lab.path.parent)


def take_power(device: LabDevice, folder: Path) -> bool:
    """Run `power_off` of a device, if it has one and is not simulated; what goes wrong with that is logged.

    Returns:
        whether it is done.

    Args:
        device: of a lab.
        folder: where the program is run: that of the lab file.
    """
    command = device.entry.power_off
    if not command or device.sim:
        return False
    logger.error("%s: its power is taken away: %s", device.name, " ".join(command))
    try:
        subprocess.run(command, check=True, timeout=10.0, cwd=folder)
    except (OSError, ValueError, subprocess.SubprocessError) as error:
        logger.error("%s: power_off: %s", device.name, error)
        return False
    return True


class Judge:
    """Judges one recording by several tests; whatever goes wrong in that is told as a doubt.

    Args:
        recording: its file.
        subject: what is known beside it.
        trouble: why the acquisition was not carried out to its end.
    """

    def __init__(self, recording: Path, subject: Subject, trouble: str = "") -> None:
        self._subject = subject
        self._trouble = trouble
        self._trace: Trace | None = None
        try:
            self._trace = Trace.of(read_recording(recording))
        except RecordingError as error:
            self._trouble = trouble or str(error)

    def findings(self, test: BenchTest) -> Findings:
        """Return what a test finds."""
        if self._trace is None or (self._trouble and not (test.of_kept and self._subject.kept)):
            return Findings(doubts=(self._trouble,))
        try:
            return test.analyse(self._trace, self._subject)
        except LookupError as error:
            return Findings(doubts=(self._trouble or f"the recording lacks something: {error}",))
        except Exception as error:
            logger.exception("%s", test.id)
            return Findings(doubts=(f"the test itself broke: {type(error).__name__}: {error}",))


def judged_again(folder: Path, lab_file: Path | None) -> results.Run:
    """Judge the recordings of a run anew; nothing is written.

    Args:
        folder: of the run.
        lab_file: whose bounds are taken; that of the run if None, and none if that is gone.

    Raises:
        ConfigError: it is no run, or the lab file cannot be used.
    """
    run = results.read_run(folder)
    path = lab_file or Path(run.lab_file)
    bounds: Mapping[str, BoundEntry] = {}
    if lab_file or path.is_file():
        lab = load_outline(path)
        check_bounds(lab, QUANTITIES)
        bounds = lab.settings.bounds
    known = {test.id: test for test in TESTS}
    devices = []
    for device in run.devices:
        tests = []
        judges: dict[str, Judge | None] = {}
        for stored in device.tests:
            test, judge = known.get(stored.id), None
            if stored.recording:
                if stored.recording not in judges:
                    judges[stored.recording] = _judge(folder, stored.recording, bounds)
                judge = judges[stored.recording]
            if test is not None and judge is not None:
                findings = judge.findings(test)
                stored = results.test_of(test, findings, stored.seconds, stored.recording)
            elif stored.recording:
                stored = stored.model_copy(update={"reason": _as_it_was(stored, test)})
            tests.append(stored)
        devices.append(device.model_copy(update={"tests": tuple(tests)}))
    return run.model_copy(update={"devices": tuple(devices)})


def _as_it_was(stored: results.Result, test: BenchTest | None) -> str:
    """Return the reason of a result that is not judged anew."""
    why = (
        "this version has no such test, or it is of the lab's own"
        if test is None
        else "what its analysis knew beside the recording is not there"
    )
    return f"as it was, {why}{stored.reason and ': '}{stored.reason}"


def _untested(test: BenchTest, verdict: Verdict, why: str) -> results.Result:
    return results.Result(
        id=test.id,
        name=test.name,
        group=test.group,
        acquisition=test.acquisition.name,
        verdict=verdict,
        reason=why,
    )


def _subject_of(recording: Path) -> Path:
    return recording.with_suffix(".subject")


def _judge(folder: Path, name: str, bounds: Mapping[str, BoundEntry]) -> Judge | None:
    """Return who judges a recording anew; None if what its analysis knew was not kept."""
    recording = folder / name
    if not recording.resolve().is_relative_to(folder.resolve()):
        return None
    try:
        trouble, _, text = _subject_of(recording).read_text("utf-8").partition("\n")
        return Judge(recording, Subject.from_json(text, bounds), trouble)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _code_of(conductor: subprocess.Popen[bytes]) -> int | None:
    """Return the exit code, None if it does not end."""
    try:
        return conductor.wait(END_TIMEOUT)
    except subprocess.TimeoutExpired:
        return None


def _why_ended(conducted: _Conducted) -> str:
    """Return why a conductor has ended too early, that has closed its connection; empty if it has not."""
    code = _code_of(conducted.process)
    if conducted.stood_still or code == 0:
        return conducted.stood_still
    if code == LEFT:
        return f"the process {os.getpid()} of the bench stood still: everything was held and left"
    return "the conductor's process died"


def _carrier_of(device: LabDevice, run: Collection[str]) -> str:
    """Return which device of the run carries another one, or its markers; empty if none does."""
    return next((name for name in device.entry.carriers if name in run), "")


def _order(device: LabDevice, devices: Mapping[str, LabDevice]) -> DeviceOrder:
    entry, on, coupled = device.entry, _carrier_of(device, devices), device.coupled
    if coupled is not None and on:  # no other one is brought up beside it
        beside = coupled.markers_on(devices[on].namespace)
        markers = {name: coupled.markers[name] for name in beside}
        coupled = coupled.model_copy(update={"markers": markers})
    return DeviceOrder(
        device.name,
        device.plugin.name,
        device.values,
        device.sim,
        device.sim_options,
        entry.space,
        on,
        coupled,
    )
