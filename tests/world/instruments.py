"""The devices that measure, as they are judged in a world: what acts on them, and what their pages promise.

The scenario is in `promises.py`. This file is imported by the host of a world, in patched Python, so it
imports no pytest.
"""

from __future__ import annotations

import random
import time
from functools import partial
from typing import Any, Final

import numpy as np

from crtk_drivers.testing.world.promises.instrument import (
    RAW,
    ForceSensor,
    Instrument,
    Missing,
    Numbers,
    Truth,
)
from crtk_sim_backends.faults import Fault
from crtk_sim_backends.ndi.motion import place
from crtk_sim_backends.optoforce.unit import COUNTS as OPTOFORCE_COUNTS

_MOST: Final = (20.0, 20.0, 20.0, 1.0, 1.0, 1.0)
"""N and N·m that act at most."""


def _load(draw: random.Random) -> list[float]:
    return [most * (2.0 * draw.random() - 1.0) for most in _MOST]


def _told(load: list[float]) -> str:
    return f"a load of {', '.join(f'{value:.3g}' for value in load)} acts"


def _netft(server: Any) -> Truth:
    box = server.box
    load = box.sensor.measurement(time.monotonic()).smooth - box.settings.bias
    return {RAW: tuple(load.tolist())}


def _load_netft(server: Any, draw: random.Random) -> str:
    load = _load(draw)
    server.box.sensor.carried = np.array(load)
    server.box.changed()
    return _told(load)


def _schunk(server: Any) -> Truth:
    return {RAW: tuple(server.device.measured.tolist())}


def _load_schunk(server: Any, draw: random.Random) -> str:
    load = _load(draw)
    server.device.carry(load)
    return _told(load)


def _optoforce(server: Any) -> Truth:
    unit = server.device._unit
    scales = OPTOFORCE_COUNTS[: len(unit.zero)]
    # Without its filter it measures in the next cycle what acts now, and may set its zero by that.
    counts = [load * scale for load, scale in zip(unit.carried, scales, strict=False)]
    measured = unit._filtered if unit.filter else counts
    forces = [(m - z) / s for m, z, s in zip(measured, unit.zero, scales, strict=True)]
    return {RAW: (*forces, *(6 - len(forces)) * [0.0])}


def _load_optoforce(server: Any, draw: random.Random) -> str:
    load = _load(draw)
    server.device._unit.carried = load
    return _told(load)


def _ft300(server: Any) -> Truth:
    return {RAW: tuple(server.device._device._carried)}


def _load_ft300(server: Any, draw: random.Random) -> str:
    load = _load(draw)
    server.device._device._carried = tuple(load)
    return _told(load)


_TOOLS: Final = ("pointer", "bone")


def _ndi(server: Any) -> Truth:
    tracker = server.device
    if tracker._mode != "tracking":
        return {f"{name}.measured_cp": Missing() for name in _TOOLS}
    hidden = tracker._faults.get("hide", {"tool": None})["tool"]
    truth: dict[str, Numbers | Missing] = {}
    for tool, name in enumerate(_TOOLS):
        frame = (time.monotonic() - tracker._origin) * tracker.family.rate
        at = place(tracker.family, tracker._motion, tool, frame)
        sign = -1.0 if at.q0 < 0.0 else 1.0
        turned = (sign * part for part in (at.qx, at.qy, at.qz, at.q0))
        numbers = (1e-3 * at.x, 1e-3 * at.y, 1e-3 * at.z, *turned)
        is_seen = hidden not in (tool, -1)
        truth[f"{name}.measured_cp"] = numbers if is_seen else Missing(numbers)
    return truth


def _hide_ndi(server: Any, draw: random.Random) -> str:
    tracker = server.device
    tool = draw.choice((None, 0, 1, -1))
    if tool is None:
        tracker._faults.pop("hide", None)
        return "all tools are seen"
    tracker.begin(Fault("hide", {"tool": tool, "how": "missing"}))
    return f"the tool {tool} is hidden (-1: all)"


_force = partial(ForceSensor, drift=(0.005 * 400.0,) * 3 + (0.005 * 20.0,) * 3)

_HELD_UP: Final = 0.035
"""s for which a world keeps a simulator from running, which then measures for the time before."""

_ALL: Final = (
    _force(
        device="ati-netft",
        config={"rate": 50.0},
        sim_options={"load": "none", "rdt_rate": 250},
        truth=_netft,
        change=_load_netft,
        error=(0.01,) * 3 + (0.001,) * 3,
        early=0.03,
        late=0.005,
        bias=lambda device: device.bias.tolist(),
        sends=lambda server: server.box.stream is not None,
    ),
    _force(
        device="schunk-fts",
        config={"rate": 100.0},
        sim_options={"load": "none"},
        truth=_schunk,
        change=_load_schunk,
        error=(0.01,) * 3 + (0.001,) * 3,
        early=0.02,
        late=_HELD_UP,
        bias=lambda device: device._bias.load.tolist(),
        sends=lambda server: server.device.streams,
    ),
    _force(
        device="optoforce",
        config={"low_pass": None},
        sim_options={"noise": 0.0},
        truth=_optoforce,
        change=_load_optoforce,
        error=(0.02,) * 3 + (0.01,) * 3,
        early=0.02,
        late=_HELD_UP,
        bias=lambda device: device._cells[0].bias.load.tolist(),
        sends=lambda server: False,  # it always does: nobody else can hear it
    ),
    _force(
        device="robotiq-ft300",
        sim_options={"noise": 0.01},  # without any it counts as frozen
        truth=_ft300,
        change=_load_ft300,
        error=(0.08,) * 3 + (0.008,) * 3,
        early=0.05,  # a thread is held up for 30 ms; the driver notices 100
        late=_HELD_UP,
        bias=lambda device: device._bias.load.tolist(),
        sends=lambda server: server.device._device.streams,
    ),
    Instrument(
        device="ndi",
        config={
            "tools": [
                {"name": "pointer", "part_number": "SIM-POINTER"},
                {"name": "bone", "part_number": "SIM-REFERENCE"},
            ]
        },
        sim_options={"noise": 0.0},
        truth=_ndi,
        change=_hide_ndi,
        error=(2e-4,) * 3 + (2e-3,) * 4,
        early=0.06,  # on a slow link a stamp may be a period too young
        late=0.05,  # a question is held up for 30 ms; what is hidden is so when a frame is told
        sends=lambda server: server.device._mode == "tracking",
    ),
)
INSTRUMENTS: Final = {instrument.device: instrument for instrument in _ALL}
"""All of them, by the name of the device."""
