"""A session of a lab's own tests: its devices, the test that is under way, and the run that is kept of it."""

from __future__ import annotations

import logging
import re
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from crtk_drivers.errors import CrtkError
from crtk_drivers.labs.bench import history, report, results
from crtk_drivers.labs.bench.acquisition import BUSY, Safety, Suite
from crtk_drivers.labs.bench.allowed import BenchOptions, not_allowed
from crtk_drivers.labs.bench.bounds import OWN_GROUP
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.folder import begun, described, finish, make_folder
from crtk_drivers.labs.bench.locks import alone
from crtk_drivers.labs.bench.run import take_power
from crtk_drivers.labs.bench.watch import late_told
from crtk_drivers.labs.lab_file import Lab, LabDevice
from crtk_drivers.labs.verdicts.judging import Findings, Verdict
from crtk_drivers.testing.lab_tests.devices import LabUnderTest, Station, TestedDevice
from crtk_drivers.testing.lab_tests.measured_figures import Figures

__all__ = ["LabSession", "TestUnderWay", "verdict_of"]

logger = logging.getLogger(__name__)


class TestUnderWay:
    """One test, from its setup to its end.

    Args:
        name: of pytest: its node id.
        title: for people.
        figures: what it measures.

    Attributes:
        devices: that it used, by name, in the order in which it did.
        skipped: why it was not carried out, or not to its end.
        left: what its fixtures ended in.
    """

    __test__ = False

    def __init__(self, name: str, title: str, figures: Figures) -> None:
        self.name = name
        self.title = title
        self.figures = figures
        self.devices: dict[str, TestedDevice] = {}
        self.skipped = ""
        self.began = time.monotonic()
        self.left: BaseException | None = None
        self._error: BaseException | None = None
        self._is_judged = False

    @property
    def broke(self) -> bool:
        """Whether it ended in the midst of what it did to devices."""
        of_the_test = AssertionError, pytest.fail.Exception, pytest.skip.Exception
        errors = (self._error, self.left)
        return any(error is not None and not isinstance(error, of_the_test) for error in errors)

    def judged(self, error: BaseException | None) -> Findings:
        """Judge what was found, and what ended the test, if something did."""
        self._error, self._is_judged = error, True
        return self.findings()

    def findings(self, *troubles: str) -> Findings:
        """Return what was found.

        Args:
            troubles: what went wrong when it had ended.
        """
        error = self._error
        violations, doubts = [], [trouble for trouble in troubles if trouble]
        if not self._is_judged:
            doubts.append("it was stopped")
        if self.left is not None:
            doubts.append(f"what it leaves: {type(self.left).__name__}: {_first_line(self.left)}")
        if isinstance(error, AssertionError | pytest.fail.Exception):
            violations.append(_first_line(error) or "an assertion does not hold")
        elif isinstance(error, CrtkError):
            doubts.append(_first_line(error))
        elif error is not None and not isinstance(error, pytest.skip.Exception):
            doubts.append(f"the test itself broke: {type(error).__name__}: {_first_line(error)}")
        tripped = {device.tripped for device in self.devices.values()} - {"", *doubts}
        doubts += sorted(tripped)
        found = self.figures.findings(violations, doubts)
        if found.verdict is Verdict.FAIL and not violations:
            late = [each for device in self.devices.values() for each in device.lateness]
            doubts += late_told(late, BUSY)
            found = self.figures.findings(violations, doubts)
        return found


def verdict_of(findings: Findings) -> Verdict:
    """Return the verdict of a test: one that only asserts, and measures nothing, passes by that."""
    if findings.measurements or findings.violations or findings.doubts:
        return findings.verdict
    return Verdict.PASS


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0]


class LabSession:
    """All tests of a lab in one session.

    Args:
        lab: its file.
        folder: for the results.
        may_move: whoever started it stands beside it, and wants motion.

    Attributes:
        run: what was found so far; None before the first test that has to do with the lab.
        trouble: why the results are not kept, or not all of them.
    """

    def __init__(self, lab: Lab, folder: Path, may_move: bool) -> None:
        self.folder = folder
        self.run: results.Run | None = None
        self.trouble = ""
        self._lab = lab
        self._options = BenchOptions(Suite.QUICK, (), may_move, folder)
        self._began = time.monotonic()
        self._stack = ExitStack()
        self._locks: tuple[int, ...] = ()
        self._doors = Path()
        self._stations: dict[str, Station] = {}
        self._off: set[str] = set()
        self._devices: dict[str, results.DeviceResult] = {}
        self._test: TestUnderWay | None = None
        self._recordings = 0

    @property
    def may_move_hardware(self) -> bool:
        """Whether something that is real may move."""
        return self._options.may_move and not all(
            device.simulated for device in self._lab.devices.values()
        )

    def begin(self) -> None:
        """Take the lab for this session, and begin its run.

        Raises:
            ConfigError: another bench tests it, or the folder of results cannot be made.
        """
        self._locks = self._stack.enter_context(alone(self._lab))
        make_folder(self.folder)
        self._doors = Path(
            self._stack.enter_context(tempfile.TemporaryDirectory(prefix="crtk-lab-"))
        )
        self.run = begun(self._lab, "the lab's own tests")
        self._keep()

    def leave(self) -> None:
        """Hold and disable every device that was commanded, and end all processes."""
        for station in self._stations.values():
            station.leave()
        self._stations.clear()
        self._stack.close()

    def has(self, name: str) -> bool:
        """Whether the lab has a device or a feature of a name."""
        return name in self._lab.devices or bool(self._lab.settings.features.get(name, False))

    def lab_under_test(self) -> LabUnderTest:
        """Return the lab as the test has it that is under way."""
        return LabUnderTest(self._lab.name, self.folder, self._lab.settings.features, self._device)

    # ---------------------------------------------------------------------------------- one test

    def test(self, name: str, title: str) -> TestUnderWay:
        """Begin a test, and return it."""
        figures = Figures(self._lab.settings.bounds, self._lab.bound_places)
        self._test = TestUnderWay(name, title, figures)
        return self._test

    def ended(self, test: TestUnderWay) -> None:
        """Leave the devices of a test, and keep what it found."""
        self._test = None
        troubles = []
        for device in test.devices.values():
            troubles.append(device.end())
            if (test.broke and device.is_touched) or device.tripped:
                device.station.stopped = f"no more after {test.name}: {test.findings().reason}"
            elif device.station.host.is_lost:
                device.station.stopped = f"no more after {test.name}: it was not seen without power"
            if device.tripped and device.is_touched:
                self._take_power(device.station.device)
        if self.run is None:
            return
        findings = test.findings(*troubles)
        first = next(iter(test.devices.values()), None)
        stored = results.Result(
            id=test.name,
            name=test.title,
            group=OWN_GROUP,
            acquisition="",
            verdict=Verdict.SKIPPED if test.skipped else verdict_of(findings),
            reason=test.skipped or findings.reason,
            seconds=round(time.monotonic() - test.began, 3),
            recording="" if first is None else str(first.recording.relative_to(self.folder)),
            measurements=tuple(map(results.measured_of, findings.measurements)),
        )
        self._file(stored, first)
        self._keep()

    def _device(self, name: str) -> TestedDevice:
        """Return a device as the test has it that is under way; it is started if it does not run.

        Raises:
            KeyError: there is none of that name.
            CrtkError: it does not measure.
        """
        device, test = self._lab.devices[name], self._test
        assert test is not None
        if name in test.devices:
            return test.devices[name]
        station = self._stations.get(name)
        if station is None:
            station = Station(
                device, self._doors, self.folder, self._locks, self._take_power, self._allowed
            )
            self._stations[name] = station
        if station.stopped:
            pytest.skip(f"{name}: {station.stopped}")
        self._recordings += 1
        called = re.sub(r"[^A-Za-z0-9_]+", "_", test.name.rpartition("::")[2]).strip("_")
        path = self.folder / "data" / f"{name}-{self._recordings:03d}-{called}.mcap"
        test.devices[name] = TestedDevice(station, path)
        return test.devices[name]

    def _take_power(self, device: LabDevice) -> None:
        if device.name not in self._off and take_power(device, self._lab.path.parent):
            self._off.add(device.name)

    def _allowed(self, safety: Safety, about: About, device: LabDevice) -> str:
        return not_allowed(safety, about, device, self._options)

    # ---------------------------------------------------------------------------------- the run

    def finish(self, ended_by: str) -> None:
        """Write all that is made of the run, if there is one.

        Args:
            ended_by: why it did not come to its end; empty if it did.
        """
        if self.run is None:
            return
        self.run = self.run.model_copy(
            update={"complete": not ended_by, "ended_by": ended_by, "seconds": self._seconds}
        )
        earlier = history.earlier_of(self._lab, self.folder.parent, "all")
        self.run, self.trouble = finish(self.run, self.folder, earlier)

    def exit_code(self, *, inconclusive_ok: bool) -> int:
        """Return the exit code of the bench for this run; 0 if there is none."""
        if self.run is None:
            return 0
        return (
            report.ABORTED
            if self.trouble
            else report.exit_code(self.run, inconclusive_ok=inconclusive_ok)
        )

    @property
    def _seconds(self) -> float:
        return round(time.monotonic() - self._began, 1)

    def _file(self, stored: results.Result, device: TestedDevice | None) -> None:
        """Put a result to the first device that the test used; of none, to the lab itself."""
        if device is None:
            name, empty = self._lab.name, self._of_lab()
        else:
            name, empty = device.name, described(device.station.device)
            empty = empty.model_copy(
                update={"address": device.about.name, "firmware": dict(device.about.readings)}
            )
        found = self._devices.get(name, empty)
        self._devices[name] = found.model_copy(update={"tests": (*found.tests, stored)})

    def _of_lab(self) -> results.DeviceResult:
        simulated = all(device.simulated for device in self._lab.devices.values())
        return results.DeviceResult(
            name=self._lab.name, plugin="", address="the lab itself", simulated=simulated
        )

    def _keep(self) -> None:
        """Write what there is so far; a full disk is told, and ends nothing that holds an arm."""
        assert self.run is not None
        self.run = self.run.model_copy(
            update={"devices": tuple(self._devices.values()), "seconds": self._seconds}
        )
        try:
            results.write_run(self.run, self.folder)
        except OSError as error:
            logger.error("%s: cannot be written: %s", self.folder, error.strerror)
