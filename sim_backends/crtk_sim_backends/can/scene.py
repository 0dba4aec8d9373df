"""What the page of a virtual CAN bus shows: its load, its frames, and its nodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from crtk_sim_backends.can.config import SimConfig
from crtk_sim_backends.page import Gauge, Gauges, Live, Row, Scene, button, fault_row

LOST: Final = button("every 20th frame lost", "drop", every=20)
BUS_OFF: Final = button("bus-off", "bus_off")
BUTTONS: Final = (
    LOST,
    button("every 20th frame twice", "duplicate", every=20),
    button("every 20th frame damaged", "corrupt", every=20),
    BUS_OFF,
    button("error frames", "error_frames"),
    button("a node babbles", "babbling"),
)


def scene(config: SimConfig, host: str) -> Scene:
    """Return what does not change."""
    rate = f"{config.bitrate} bit/s" if config.bitrate else "without a bit rate"
    return {
        "title": "CAN bus",
        "detail": f"{config.channel}, {rate}",
        "host": host,
        "buttons": BUTTONS,
        "notes": {},
        "chain": None,
    }


def live(status: Mapping[str, Any], faults: list[str], time: float) -> Live:
    """Return what changes, from the status of the hub."""
    return {
        "gauges": _load(status),
        "sections": {
            "Simulator": [fault_row(faults), ("time", f"{time:.1f} s", "")],
            "Nodes": nodes(status),
        },
        "faults": faults,
    }


def _load(status: Mapping[str, Any]) -> list[Gauges]:
    """Return the load of the last second; without a bit rate there is none."""
    load = status["load"]
    if load is None:
        return []
    gauge: Gauge = {"name": "bus", "low": 0.0, "high": 100.0, "value": 100.0 * load}
    return [{"title": "Load", "unit": "%", "rate": "", "digits": 1, "gauges": [gauge]}]


def nodes(status: Mapping[str, Any]) -> list[Row]:
    """Return a row for each node: its frames, and what is wrong with it."""
    rows: list[Row] = [("frames", f"{status['frames']}, error frames {status['error_frames']}", "")]
    for name, node in status["nodes"].items():
        text = f"{node['sent']} sent, {node['received']} received"
        if node["lost"]:
            text += f", {node['lost']} lost"
        trouble = ", ".join(node["state"]).lower().replace("_", " ")
        rows.append((name, f"{text}, {trouble}" if trouble else text, "bad" if trouble else ""))
    return rows
