"""Health as diagnostic_msgs: one status for the device, one for its bus, one for its commands.

Counters grow for ever; what matters is what happened since the last report. So the levels come from the
difference to the last one, and a fault that is over does not colour the panel for ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from crtk_drivers.device import Severity
from crtk_drivers.ros.messages import set_stamp
from crtk_drivers.ros.senders import Flood
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health

RATE_TOLERANCE = 0.05
"""Relative difference between the achieved and the expected rate of the I/O loop that is worth a warning."""
LATE_SHARE = 0.01
"""Share of late cycles since the last report that is worth a warning."""

_LEVELS = {
    OperatingState.ENABLED: DiagnosticStatus.OK,
    OperatingState.DISABLED: DiagnosticStatus.OK,
    OperatingState.PAUSED: DiagnosticStatus.WARN,
    OperatingState.FAULT: DiagnosticStatus.ERROR,
}

_SEVERITIES = {
    Severity.INFO: DiagnosticStatus.OK,
    Severity.WARNING: DiagnosticStatus.WARN,
    Severity.ERROR: DiagnosticStatus.ERROR,
}


class Diagnostics:
    """Makes the reports of one device.

    Args:
        prefix: the node's name, which heads every status.
        hardware_id: device and address.
        sample_timeout: seconds without a sample that mean silence.
    """

    def __init__(self, prefix: str, hardware_id: str, sample_timeout: float) -> None:
        self._prefix = prefix
        self._hardware_id = hardware_id
        self._sample_timeout = sample_timeout
        self._last = Health()

    def report(
        self, status: Status, health: Health, nanoseconds: int, floods: Sequence[Flood] = ()
    ) -> DiagnosticArray:
        """Return the report of the time since the last one.

        Args:
            status: of the device.
            health: of the device.
            nanoseconds: of the time, since the epoch.
            floods: what clients send too often.
        """
        message = DiagnosticArray()
        set_stamp(message.header.stamp, nanoseconds)
        message.status = [
            self._device(status, health),
            self._bus(health, connecting=status.connecting),
            self._commands(health, floods),
        ]
        self._last = health
        return message

    def _status(
        self, thing: str, level: bytes, text: str, values: Mapping[str, object]
    ) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=level,
            name=f"{self._prefix}: {thing}",
            message=text,
            hardware_id=self._hardware_id,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )

    def _device(self, status: Status, health: Health) -> DiagnosticStatus:
        level, text = _LEVELS[status.state], status.detail or status.state.value
        if status.connecting:
            level = DiagnosticStatus.STALE
        worst = max(health.notes, key=lambda note: note.severity, default=None)
        if worst is not None and _SEVERITIES[worst.severity] > level:
            level, text = _SEVERITIES[worst.severity], worst.text
        return self._status(
            "device",
            level,
            text,
            {
                "operating_state": status.state.value,
                "connecting": status.connecting,
                "is_homed": status.is_homed,
                "is_busy": status.is_busy,
                **{key: f"{value:g}" for key, value in health.device.items()},
                **{note.key: note.text for note in health.notes},
            },
        )

    def _bus(self, health: Health, *, connecting: bool) -> DiagnosticStatus:
        level, text = _bus_level(health, self._last, self._sample_timeout)
        if connecting:
            level, text = DiagnosticStatus.STALE, "not connected yet"
        return self._status(
            "bus",
            level,
            text,
            {
                "connected": health.connected,
                "rate (Hz)": f"{health.rate:.2f}",
                "expected rate (Hz)": f"{health.rate_expected:g}",
                "cycles": health.cycles,
                "late cycles": health.late_cycles,
                "worst cycle (ms)": f"{health.worst_cycle * 1e3:.3f}",
                "samples": health.samples,
                "sample age (ms)": f"{health.sample_age * 1e3:.3f}",
                "reconnects": health.reconnects,
            },
        )

    def _commands(self, health: Health, floods: Sequence[Flood]) -> DiagnosticStatus:
        total, before = sum(health.refusals.values()), sum(self._last.refusals.values())
        texts = [str(flood) for flood in floods]
        if total > before:
            texts.append(f"{total - before} refused, last: {health.last_refusal}")
        return self._status(
            "commands",
            DiagnosticStatus.WARN if texts else DiagnosticStatus.OK,
            "; ".join(texts) or "OK",
            {
                "stream": health.stream or "none",
                "stream timeouts": health.stream_timeouts,
                "setpoints": health.setpoints,
                "clamped": health.clamped,
                "warnings left out": health.warnings_left_out,
                "refused": total,
                **{f"refused {kind}": count for kind, count in health.refusals.items()},
                **{f"flood {flood.topic} {flood.sender}": f"{flood.rate:.0f}" for flood in floods},
            },
        )


def _bus_level(now: Health, before: Health, sample_timeout: float) -> tuple[bytes, str]:
    """Return the first row that applies."""
    cycles = now.cycles - before.cycles
    late = now.late_cycles - before.late_cycles
    deviation = abs(now.rate - now.rate_expected)
    rows: tuple[tuple[Callable[[], bool], bytes, str], ...] = (
        (lambda: not now.connected, DiagnosticStatus.ERROR, "not connected"),
        (lambda: math.isinf(now.sample_age), DiagnosticStatus.STALE, "no sample yet"),
        (
            lambda: now.sample_age > sample_timeout,
            DiagnosticStatus.ERROR,
            f"no sample for {now.sample_age:.3f} s",
        ),
        (lambda: cycles == 0, DiagnosticStatus.ERROR, "the I/O loop stands still"),
        (
            lambda: late > LATE_SHARE * cycles,
            DiagnosticStatus.WARN,
            f"{late} of {cycles} cycles were late",
        ),
        (
            lambda: now.rate > 0.0 and deviation > RATE_TOLERANCE * now.rate_expected,
            DiagnosticStatus.WARN,
            f"{now.rate:.1f} Hz instead of {now.rate_expected:g} Hz",
        ),
    )
    for applies, level, text in rows:
        if applies():
            return level, text
    return DiagnosticStatus.OK, "OK"
