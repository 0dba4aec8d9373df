"""What the page of a simulated sensor box shows: the wrench as the stream has it, stream, counters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.page import Gauges, Live, Row, Scene, button, fault_row

_AXES: Final = ("x", "y", "z")
_BUTTONS: Final = (
    button("push 30 N", "push", wrench=[0.0, 0.0, 30.0, 0.0, 0.0, 0.0]),
    button("z saturated", "saturation"),
    button("frozen", "frozen"),
    button("every 10th datagram lost", "loss", every=10),
    button("every 10th one twice", "duplicate", every=10),
    button("cable out", "unplugged"),
    button("box hangs", "stall"),
    button("box boots", "reboot"),
    button("another client", "takeover"),
)


def scene(box: Box, host: str) -> Scene:
    """Return what does not change."""
    preset = box.settings.preset
    return {
        "title": box.profile.product.removesuffix(" (simulated)"),
        "detail": f"{preset.name}, firmware {box.profile.firmware}",
        "host": host,
        "buttons": _BUTTONS,
        "notes": {"worst": "By which a datagram left later than its time."},
        "chain": None,
    }


def live(box: Box, status: Mapping[str, Any]) -> Live:
    """Return what changes, from the status of the simulator."""
    outputs, counters = status["outputs"], status["counters"]
    wrench = [value - bias for value, bias in zip(outputs["wrench"], outputs["bias"], strict=True)]
    rated = box.settings.rated.tolist()
    stream = status["stream"]
    faults = [fault["kind"] for fault in status["faults"]]
    rows: list[Row] = [
        ("status", f"{outputs['status']:08x}h", "bad" if outputs["status"] else "good"),
        ("stream", f"to {stream['to']}" if stream else "none", "good" if stream else ""),
        ("rate", f"{status['rdt_rate']} of {status['internal_rate']} Hz", ""),
        ("filter", f"code {status['filter_code']}", ""),
        ("bias", "set" if any(outputs["bias"]) else "none", ""),
    ]
    return {
        "gauges": [
            _gauges("Force", "N", 2, wrench[:3], rated[:3]),
            _gauges("Torque", "N·m", 3, wrench[3:], rated[3:]),
        ],
        "sections": {
            "State": rows,
            "Simulator": [
                fault_row(faults),
                ("time", f"{status['time']:.1f} s", ""),
                ("records", f"{counters['records']}, datagrams {counters['datagrams']}", ""),
                ("requests", f"{counters['requests']}, bad {counters['bad_requests']}", ""),
                ("pages", f"{counters['pages']}, TCP requests {counters['tcp_requests']}", ""),
                ("worst", f"{1e3 * status['statistics']['worst_delay']:.1f} ms late", ""),
            ],
        },
        "faults": faults,
    }


def _gauges(title: str, unit: str, digits: int, values: list[float], rated: list[float]) -> Gauges:
    return {
        "title": title,
        "unit": unit,
        "rate": "",
        "digits": digits,
        "gauges": [
            {"name": axis, "low": -limit, "high": limit, "value": value}
            for axis, value, limit in zip(_AXES, values, rated, strict=True)
        ],
    }
