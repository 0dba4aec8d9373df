"""What a test of the bench is: an acquisition that moves and records, and an analysis of the recording."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from enum import IntEnum, StrEnum
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from crtk_drivers.device import JointLimits
from crtk_drivers.labs.bench.bed import Bed
from crtk_drivers.labs.bench.bounds import bounded
from crtk_drivers.labs.bench.calls import About
from crtk_drivers.labs.bench.trace import Trace
from crtk_drivers.labs.bench.watch import late_told
from crtk_drivers.labs.carried import UNKNOWN, Carried
from crtk_drivers.labs.lab_file import BoundEntry
from crtk_drivers.labs.verdicts.estimates import Estimate, within
from crtk_drivers.labs.verdicts.judging import Bound, Findings, Measurement, Plot, Quantity, Verdict
from crtk_drivers.plugins import SimFault
from crtk_drivers.samples import Array, Vector

BUSY: Final = 5e-3
"""Seconds by which the bench's own timer, which paces what it sends, may be late."""

LONGEST_GAP: Final = 0.03
"""Seconds without a sample, where five periods are less, after which a time is worth nothing."""


class Safety(IntEnum):
    """What an acquisition may do; they are run in this order."""

    READ = 0
    ENABLE = 1
    SMALL = 2
    LARGE = 3
    FAULT = 4
    FAULT_IN_MOTION = 5


SAFETY_LETTERS: Final = {
    Safety.READ: "R",
    Safety.ENABLE: "E",
    Safety.SMALL: "S",
    Safety.LARGE: "L",
    Safety.FAULT: "X",
    Safety.FAULT_IN_MOTION: "XL",
}


class Suite(StrEnum):
    """Which tests, and how much is measured."""

    REST = "rest"
    QUICK = "quick"
    FULL = "full"
    NIGHTLY = "nightly"

    @property
    def thorough(self) -> float:
        """How much longer than the shortest time something is measured."""
        return {"rest": 1.0, "quick": 1.0, "full": 3.0, "nightly": 10.0}[self]

    def holds(self, other: Suite) -> bool:
        """Whether what belongs to `other` belongs to it: each holds those before it."""
        order = list(Suite)
        return order.index(other) <= order.index(self)


@dataclass(frozen=True)
class Acquisition:
    """Moves a device, or waits, while everything is recorded.

    Attributes:
        name: of the recording.
        summary: what is done, for people.
        safety: what it may do.
        run: does it.
        needs: CRTK names, and services, without which it cannot be done.
        suite: the smallest suite that it belongs to.
        carrier_needs: CRTK names that the device must offer that carries this one. That one is moved, watched
            and recorded as well, and this one only read; empty: it is about one device.
        is_marked: that one carries a marker of this one, which is a tracker.
        loads: the simulator is loaded by what `DevicePlugin.sim_load` does.
        relayed: its fault is of the link to the device, which hardware can be given as well.
        by_operator: its fault is one that an operator causes where the device is hardware.
        features: of the lab file that it cannot do without.
        without: features of the lab file that a real device must not have for it.
        sim_fault: what it lets happen to a simulated device.
        carrier_fault: what it lets happen to a simulated device that carries it.
        homes: it lets the device home, which goes wherever it must.
    """

    name: str
    summary: str
    safety: Safety
    run: Callable[[Bed], None]
    needs: tuple[str, ...] = ()
    suite: Suite = Suite.QUICK
    carrier_needs: tuple[str, ...] = ()
    is_marked: bool = False
    loads: bool = False
    relayed: bool = False
    by_operator: bool = False
    features: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    sim_fault: SimFault | None = None
    carrier_fault: SimFault | None = None
    homes: bool = False


@dataclass(frozen=True)
class Subject:
    """What an analysis knows beside the recording; kept beside that, as JSON.

    Attributes:
        joints: names.
        limits: one for each joint, as they held in the run.
        rate: cycles a second that the device declares.
        lag: seconds that it declares to need to carry out a setpoint.
        stop_time: seconds within which it declares to stand.
        silence: seconds without a command after which a servo stream has ended.
        lateness: by how many seconds the bench's own timer was late during the acquisition.
        kept: what the acquisition wrote down beside the recording.
        sample_timeout: seconds without a sample after which the link counts as lost.
        stale_after: seconds after which a sample is no longer valid.
        link_timeout: seconds that the hardware declares to go on by itself.
        carried: how it sits on the device that carries it, and its tool.
        markers: names of its tools that are fixed to the device that is moved.
        bounds: of the lab file, by the id of a quantity.
        waited: share of the time in which some program of this machine waited for a processor.
    """

    joints: tuple[str, ...]
    limits: tuple[JointLimits, ...]
    rate: float
    lag: float
    stop_time: float
    silence: float
    sample_timeout: float
    stale_after: float
    link_timeout: float
    lateness: tuple[float, ...] = ()
    kept: Mapping[str, Any] = field(default_factory=dict)
    carried: Carried = UNKNOWN
    markers: tuple[str, ...] = ()
    bounds: Mapping[str, BoundEntry] = field(default_factory=dict)
    waited: float = 0.0

    @classmethod
    def of(
        cls,
        about: About,
        lateness: tuple[float, ...],
        bounds: Mapping[str, BoundEntry],
        kept: Mapping[str, Any] = MappingProxyType({}),
        carried: Carried = UNKNOWN,
        markers: tuple[str, ...] = (),
    ) -> Subject:
        """Return what counts of a device."""
        own = about.capabilities
        return cls(
            joints=own.joints,
            limits=own.limits,
            rate=own.rate,
            lag=0.0 if own.following is None else own.following.lag,
            stop_time=own.stop.time,
            silence=about.silence,
            sample_timeout=about.sample_timeout,
            stale_after=about.stale_after,
            link_timeout=own.stop.link_timeout,
            lateness=lateness,
            kept=dict(kept),
            carried=carried,
            markers=markers,
            bounds=bounds,
        )

    def as_json(self) -> str:
        """Return it as text, without the bounds."""
        return json.dumps({key: value for key, value in asdict(self).items() if key != "bounds"})

    @classmethod
    def from_json(cls, text: str, bounds: Mapping[str, BoundEntry]) -> Subject:
        """Return what `as_json` wrote, with bounds.

        Raises:
            ValueError, TypeError, KeyError: it did not.
        """
        values = json.loads(text)
        values["joints"] = tuple(values["joints"])
        values["limits"] = tuple(JointLimits(**limit) for limit in values["limits"])
        values["lateness"] = tuple(values["lateness"])
        values["carried"] = Carried(**values.get("carried", {}))
        values["markers"] = tuple(values.get("markers", ()))
        return cls(**values, bounds=bounds)

    @property
    def period(self) -> float:
        """Seconds of one cycle of the device."""
        return 1.0 / self.rate

    def too_busy(self, allowed: float) -> tuple[str, ...]:
        """Return a doubt if one in a hundred times the bench was later than `allowed` s."""
        return late_told(self.lateness, allowed)

    def on_a_free_machine(self, found: Callable[[float], Findings]) -> Findings:
        """Return what was found of times, with a doubt if it fails, and that programs waited may be why.

        The bench's own timer tells of its own process; driver and simulator may have waited all the same.

        Args:
            found: what is found, had a share of the time not been: of 0.0, as it was measured.
        """
        findings = found(0.0)
        if findings.verdict is not Verdict.FAIL or found(self.waited).verdict is Verdict.FAIL:
            return findings
        doubt = (
            f"the machine is too busy: programs waited for a processor for {100.0 * self.waited:.0f} % "
            "of the time, which may be why"
        )
        return replace(findings, doubts=(*findings.doubts, doubt))

    def gaps(self, stamps: Vector) -> tuple[str, ...]:
        """Return a doubt if samples, of these times of acquisition (N,), stayed away for long."""
        made = stamps[np.isfinite(stamps)]
        longest = float(np.diff(made).max()) if made.size > 1 else math.inf
        if longest <= max(5.0 * self.period, LONGEST_GAP):
            return ()
        return (f"no sample came for {1e3 * longest:.0f} ms in the midst of it",)

    def uneven(self, stamps: Vector) -> tuple[str, ...]:
        """Return a doubt if samples, of these times of acquisition (N,), came too unevenly for speeds."""
        steps = np.diff(stamps[np.isfinite(stamps)])
        late = float(np.quantile(steps, 0.99)) if steps.size else math.inf
        if late <= 1.5 * self.period:
            return ()
        return (f"one sample in a hundred came {1e3 * late:.0f} ms after the one before",)

    def measured(
        self,
        quantity: Quantity,
        estimate: Estimate | None,
        bound: Bound | None = None,
        *,
        part: str = "",
        why: str = "",
    ) -> Measurement:
        """Return a measurement, against the bound of the lab file if it has one, also if it is only told."""
        own = self.bounds.get(quantity.id)
        if own is not None:
            quantity, bound = bounded(quantity, own, bound)
        return Measurement(quantity, estimate, bound, why, part)

    def furthest(
        self,
        quantity: Quantity,
        ways: Array,
        allowed: ArrayLike,
        source: str,
        *,
        doubts: ArrayLike = 0.0,
        n: int = 1,
        part: str = "",
    ) -> Measurement:
        """Return the way of the joint that used most of what it may, in mrad or mm.

        Args:
            quantity: whose value it is.
            ways: of the joints (n,), in rad or m.
            allowed: the same, or one for all of them.
            source: of what is allowed.
            doubts: by how much a way may be off; the same.
            n: observations.
            part: before the name of the joint.
        """
        room, doubt = (np.broadcast_to(each, ways.shape) for each in (allowed, doubts))
        worst = int(np.argmax(ways / room))
        return self.measured(
            quantity,
            within(1e3 * float(ways[worst]), 1e3 * float(doubt[worst]), n),
            Bound(1e3 * float(room[worst]), source),
            part=f"{part}{self.joints[worst]}",
        )

    def ways_told(self, title: str, at: Vector, ways: Array, x_label: str = "time, s") -> Plot:
        """Return the plot of what all joints did (N, n), in rad or m, over times (N,) in s."""
        lines = zip(self.joints, 1e3 * ways.T, strict=True)
        return Plot.of(title, x_label, "mrad or mm", *((name, at, way) for name, way in lines))


@dataclass(frozen=True)
class BenchTest:
    """A test: what is judged of an acquisition.

    Attributes:
        id: short, the same for ever: ``M2``.
        name: for people.
        group: first part of the ids of its quantities.
        acquisition: whose recording is judged.
        analyse: pure: judges it.
        quantities: that it measures.
        needs: CRTK names without which it cannot be judged.
        guards: a FAIL of it ends all motion of the device.
        of_kept: it judges what the acquisition kept, whatever became of that afterwards.
        features: of the lab file without which it cannot be judged.
    """

    id: str
    name: str
    group: str
    acquisition: Acquisition
    analyse: Callable[[Trace, Subject], Findings]
    quantities: tuple[Quantity, ...]
    needs: tuple[str, ...] = ()
    guards: bool = False
    of_kept: bool = False
    features: tuple[str, ...] = ()
