"""What a page for the browser shows of a running device, as dictionaries that JSON can hold.

Their keys are those that the pages of simulators have (docs/simulator_page.md), so that both look alike. Made
from what the engines tell anyone: no bus is touched, and no lock is held while text is made.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from crtk_drivers.device import JointLimits, Severity
from crtk_drivers.engine import Engine
from crtk_drivers.errors.wording import worded
from crtk_drivers.geometry.quaternions import rotvec_from_quaternion
from crtk_drivers.kinematics.chain import JointKind
from crtk_drivers.kinematics.drawn import numbers_of
from crtk_drivers.kinematics.joint_axes import chain_of, joint_kinds
from crtk_drivers.samples import JointState, Pose, Stamp, Wrench
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.counter_groups import grouped
from crtk_drivers.status.health import Health

Row = tuple[str, str, str]
"""Name, text, and how it is shown: good, fair, bad, or as it is ("")."""
Found = dict[str, Any]

HEALTH_PERIOD: Final = 0.5
"""Seconds after which counters are asked for again: nobody reads them faster."""

_AXES: Final = ("x", "y", "z")
_AT_FLANGE: Final = (0.0,) * 6  # position and rotation vector: the chain ends at the tool point
_SLOW: Final = 0.95  # of the expected rate
_STATES: Final = {
    OperatingState.ENABLED: "good",
    OperatingState.PAUSED: "fair",
    OperatingState.DISABLED: "",
    OperatingState.FAULT: "bad",
}
_SEVERITIES: Final = {Severity.INFO: "", Severity.WARNING: "fair", Severity.ERROR: "bad"}
_NOTES: Final = {
    "cycles": "Of the thread that talks to the hardware. Late: more than twice as long as they should be.",
}


@dataclass(frozen=True)
class _Unit:
    """How joints of one kind are shown: `scale` of SI units; `span` of gauges without limit."""

    title: str
    name: str
    rate: str
    effort: str
    scale: float
    span: float | None
    digits: int


_UNITS: Final = {
    JointKind.REVOLUTE: _Unit("Joints", "deg", "deg/s", "N·m", 180.0 / math.pi, None, 2),
    JointKind.PRISMATIC: _Unit("Sliding joints", "mm", "mm/s", "N", 1e3, 1e3, 2),
    None: _Unit("Joints", "rad (m)", "rad/s (m/s)", "N·m (N)", 1.0, 2.0 * math.pi, 4),
}


class DeviceScene:
    """A device and those behind it, as a page shows them. For one thread.

    Args:
        engine: of the device.
        children: of the devices behind it, by name.
        detail: what it is, in a few words.
    """

    def __init__(self, engine: Engine, children: Mapping[str, Engine], detail: str) -> None:
        self._views = [_EngineView(engine, "")]
        self._views += [_EngineView(behind, name) for name, behind in children.items()]
        self._engine = engine
        self._detail = detail
        self.place = ""
        """Its namespace on ROS, once it has one."""

    def scene(self) -> Found:
        """What does not change while it is looked at; the chain is that of the kinematics in force."""
        chain = chain_of(self._engine.device)
        return {
            "title": " · ".join(
                filter(None, (self._engine.capabilities.model or self._engine.name, self.place))
            ),
            "detail": self._detail,
            "host": self._engine.device.address,
            "buttons": (),
            "notes": {
                f"{view.prefix}{name}": _NOTES[name] for view in self._views for name in _NOTES
            },
            "chain": None
            if chain is None
            else {
                "joints": [numbers_of(each) for each in chain.joints],
                "tip": numbers_of(chain.tip),
            },
        }

    def live(self) -> Found:
        """What changes."""
        now = time.monotonic()
        sections: dict[str, list[Row]] = {}
        for view in self._views:
            sections |= view.sections(now)
        found: Found = {
            "gauges": [group for view in self._views for group in view.gauges()],
            "sections": sections,
            "faults": (),
        }
        measured = self._views[0].measured_joints()
        if measured is not None:
            found |= {"q": measured[0].position.tolist(), "tool": _AT_FLANGE}
        return found


class _EngineView:
    """One device on the page."""

    def __init__(self, engine: Engine, child: str) -> None:
        self.prefix = f"{child} " if child else ""
        self._engine = engine
        self._kinds: tuple[JointKind | None, ...] = joint_kinds(engine.device)
        self._spans: dict[str, float] = {}
        self._health_due = 0.0
        self._health: dict[str, list[Row]] = {}

    def measured_joints(self) -> tuple[JointState, Stamp] | None:
        """Return joint positions with their stamp; None if there are none."""
        found = self._told("measured_js")
        if found is None or not isinstance(found[0], JointState) or not found[0].position.size:
            return None
        return found[0], found[1]

    def gauges(self) -> Iterator[Found]:
        """The joints, those of each unit together; the wrench of a device without joints."""
        measured = self.measured_joints()
        if measured is not None:
            yield from self._joints(*measured)
        wrench = None if self._engine.capabilities.joints else self._told("measured_cf")
        if wrench is not None and isinstance(wrench[0], Wrench):
            state = _validity(wrench[1])
            yield self._wrench("Force", "N", 2, wrench[0].force.tolist(), 1.0, state)
            yield self._wrench("Torque", "N·m", 3, wrench[0].torque.tolist(), 0.1, state)

    def _joints(self, measured: JointState, stamp: Stamp) -> Iterator[Found]:
        names, limits = self._engine.capabilities.joints, self._engine.capabilities.limits
        setpoint = self._told("setpoint_js")
        goals: list[float] = []
        if setpoint is not None and setpoint[1].wall_ns and isinstance(setpoint[0], JointState):
            goals = setpoint[0].position.tolist()
        position, velocity = measured.position.tolist(), measured.velocity.tolist()
        effort, state = measured.effort.tolist(), _validity(stamp)
        for kind in dict.fromkeys(self._kinds):
            unit = _UNITS[kind]
            gauges = []
            for index, each in enumerate(self._kinds):
                if each is not kind:
                    continue
                gauge: Found = {
                    "name": names[index].removesuffix("_joint"),
                    **_ends(limits[index], unit),
                    "value": unit.scale * position[index],
                    "goal": unit.scale * goals[index] if goals else None,
                    "state": state,
                }
                if velocity:
                    gauge["rate"] = unit.scale * velocity[index]
                if effort and not state[0]:
                    gauge["state"] = (f"{effort[index]:.2f} {unit.effort}", "")
                gauges.append(gauge)
            yield {
                "title": f"{self.prefix}{unit.title}",
                "unit": unit.name,
                "rate": unit.rate if velocity else "",
                "digits": unit.digits,
                "gauges": gauges,
            }

    def _wrench(
        self,
        title: str,
        unit: str,
        digits: int,
        values: Sequence[float],
        least: float,
        state: tuple[str, str],
    ) -> Found:
        """Return gauges whose scale is 1, 2 or 5 times a power of ten, and holds all that was seen."""
        span = max(self._spans.get(title, least), _round_up(max(map(abs, values))))
        self._spans[title] = span
        return {
            "title": f"{self.prefix}{title}",
            "unit": unit,
            "rate": "",
            "digits": digits,
            "gauges": [
                {
                    "name": axis,
                    "low": None,
                    "high": None,
                    "span": span,
                    "value": value,
                    "state": state,
                }
                for axis, value in zip(_AXES, values, strict=True)
            ],
        }

    def sections(self, now: float) -> dict[str, list[Row]]:
        """Tables by title; counters are at most `HEALTH_PERIOD` old."""
        if now >= self._health_due:
            self._health = self._health_sections(self._engine.health())
            self._health_due = now + HEALTH_PERIOD
        sections = {"State": _state_rows(self._engine.status)}
        tool = [*self._pose_rows(), *self._wrench_rows()]
        if tool:
            sections["Tool"] = tool
        return self._named(sections | self._health)

    def _named(self, sections: Mapping[str, Sequence[Row]]) -> dict[str, list[Row]]:
        return {
            f"{self.prefix}{title}": [
                (f"{self.prefix}{name}", text, level) for name, text, level in rows
            ]
            for title, rows in sections.items()
        }

    def _pose_rows(self) -> list[Row]:
        found = self._told("measured_cp")
        if found is None or not isinstance(found[0], Pose):
            return []
        pose, level = found[0], "" if found[1].wall_ns else "bad"
        return [
            ("position, m", _text(pose.position.tolist(), 4), level),
            ("rotation, rad", _text(rotvec_from_quaternion(pose.orientation).tolist(), 3), level),
        ]

    def _wrench_rows(self) -> list[Row]:
        found = self._told("measured_cf") if self._engine.capabilities.joints else None
        if found is None or not isinstance(found[0], Wrench):
            return []
        level = "" if found[1].wall_ns else "bad"
        return [
            ("force, N", _text(found[0].force.tolist(), 1), level),
            ("torque, N·m", _text(found[0].torque.tolist(), 2), level),
        ]

    def _health_sections(self, health: Health) -> dict[str, list[Row]]:
        refused = sum(health.refusals.values())
        slow = health.rate < _SLOW * health.rate_expected
        rows: list[Row] = [
            (
                "rate",
                f"{health.rate:.0f} of {health.rate_expected:.0f} Hz",
                "fair" if slow else "",
            ),
            (
                "cycles",
                f"{health.late_cycles} late of {health.cycles}, longest {1e3 * health.worst_cycle:.1f} ms",
                "",
            ),
            (
                "sample age",
                f"{1e3 * health.sample_age:.0f} ms"
                if math.isfinite(health.sample_age)
                else "never read",
                "",
            ),
            ("samples", f"{health.samples}, dropped {health.broken_samples}", ""),
            ("setpoints", f"{health.setpoints}, clamped {health.clamped}", ""),
            ("stream", health.stream or "none", "good" if health.stream else ""),
            ("reconnects", f"{health.reconnects}", "fair" if health.reconnects else ""),
            ("timeouts", f"{health.stream_timeouts} of streams", ""),
            (
                "refused",
                f"{refused}, last: {worded(health.last_refusal)}" if refused else "none",
                "",
            ),
        ]
        return {"Health": rows, "Device": self._device_rows(health)}

    def _device_rows(self, health: Health) -> list[Row]:
        """What the device itself tells: a note on one of its counters stands in the counter's place."""
        words = {note.key: worded(note.text) for note in health.notes}
        others = [note for note in health.notes if note.key not in health.device]
        worst = max((note.severity for note in health.notes), default=Severity.INFO)
        counters = grouped(
            health.device,
            words,
            self._engine.capabilities.joints,
            self._engine.device.counter_units,
        )
        return [
            (
                "notes",
                "\n".join(worded(note.text) for note in others) or "none",
                _SEVERITIES[worst],
            ),
            ("counters", "\n".join(counters) or "none", ""),
        ]

    def _told(self, name: str) -> tuple[Any, Stamp] | None:
        return self._engine.feedback(name) if name in self._engine.commands else None


def _state_rows(status: Status) -> list[Row]:
    state = "connecting" if status.connecting else str(status.state)
    return [
        ("state", state, "fair" if status.connecting else _STATES[status.state]),
        ("homed", "yes" if status.is_homed else "no", "" if status.is_homed else "fair"),
        ("busy", "yes" if status.is_busy else "no", ""),
        ("reason", worded(status.detail) or "none", ""),
    ]


def _ends(limits: JointLimits, unit: _Unit) -> Found:
    low, high = (
        unit.scale * end if math.isfinite(end) else None for end in (limits.lower, limits.upper)
    )
    is_scaled = unit.span is not None and None in (low, high)
    return {"low": low, "high": high} | ({"span": unit.span} if is_scaled else {})


def _validity(stamp: Stamp) -> tuple[str, str]:
    return ("", "") if stamp.wall_ns else ("not valid now", "bad")


def _round_up(value: float) -> float:
    """Return the least of 1, 2 and 5 times a power of ten that is not below a value; 0 for 0."""
    if value <= 0.0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(
        step * power for step in (1.0, 2.0, 5.0, 10.0) if value <= step * power * (1 + 1e-9)
    )


def _text(values: Sequence[float], digits: int) -> str:
    return "  ".join(f"{value:.{digits}f}" for value in values)
