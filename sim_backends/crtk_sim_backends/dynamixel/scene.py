"""What the page of simulated servos shows: a gauge for each, its state, and what crossed the lines."""

from __future__ import annotations

import math
from collections.abc import Sequence

from crtk_sim_backends.dynamixel.config import SimConfig
from crtk_sim_backends.dynamixel.line import Line
from crtk_sim_backends.dynamixel.servo import Servo
from crtk_sim_backends.page import Gauge, Gauges, Live, Row, Scene, button, fault_row


def scene(config: SimConfig, host: str) -> Scene:
    """Return what does not change."""
    first, *others = [spec.number for spec in config.buses[0]]
    second = others[0] if others else first
    servos = sum(len(specs) for specs in config.buses)
    return {
        "title": "DYNAMIXEL servos",
        "detail": f"{servos} on {len(config.buses)} bus{'es' * (len(config.buses) > 1)}, {config.baud} bit/s",
        "host": host,
        "buttons": (
            button(f"servo {second} stuck", "stuck", id=second),
            button(f"push servo {second}, 1 N.m", "push", id=second, torque=1.0),
            button(f"servo {first} overloaded", "overload", id=first),
            button("overheated", "overheat"),
            button("no supply", "power_off"),
            button("every 20th answer lost", "drop", every=20),
            button("every 20th CRC wrong", "crc", every=20),
            button("adapter stalls", "stall"),
            button("adapter unplugged", "unplug"),
        ),
        "notes": {"worst": "By which an answer left later than its time on a real bus."},
        "chain": None,
    }


def live(lines: Sequence[Line], faults: Sequence[str], time: float) -> Live:
    """Return what changes; `time` is that of the mechanics, s."""
    return {
        "gauges": [_gauges(line, time) for line in lines],
        "sections": {
            "Simulator": [fault_row(faults), ("time", f"{time:.1f} s", "")],
            **{_title(line): _rows(line) for line in lines},
        },
        "faults": faults,
    }


def _title(line: Line) -> str:
    return line.name.replace("bus", "Bus ")


def _gauges(line: Line, time: float) -> Gauges:
    return {
        "title": _title(line),
        "unit": "deg from the middle",
        "rate": "deg/s",
        "digits": 1,
        "gauges": [_gauge(servo, time) for servo in line.bus.servos],
    }


def _gauge(servo: Servo, time: float) -> Gauge:
    drive, limits = servo.drive, servo.limits
    low, high = (None, None) if limits is None else map(math.degrees, limits)
    return {
        "name": f"{servo.number}: {servo.model.name}",
        "low": low,
        "high": high,
        "value": math.degrees(drive.angle),
        "goal": math.degrees(drive.trajectory(time)[0]) if drive.positions else None,
        "rate": math.degrees(drive.velocity),
        "state": _state(servo),
    }


def _state(servo: Servo) -> tuple[str, str]:
    if not servo.powered:
        return "no supply", "bad"
    mode = servo.drive.mode
    text = "torque off" if mode is None else mode.name.lower().replace("_", " ")
    text = f"{text}, {servo.drive.applied:.2f} N·m, {servo.temperature:.0f} °C"
    if servo.error_bits:
        return f"error, {text}", "bad"
    return text, "" if mode is None else "good"


def _rows(line: Line) -> list[Row]:
    statistics = line.statistics
    return [
        ("tty", str(line.port.tty.link) if line.port.plugged else "unplugged", ""),
        ("clients", str(line.port.clients), ""),
        ("instructions", f"{statistics.instructions}, damaged {statistics.damaged}", ""),
        ("bytes", f"{statistics.bytes_in} in, {statistics.bytes_out} out", ""),
        ("worst", f"{1e3 * statistics.worst:.2f} ms late", ""),
    ]
