"""How long a CANopen arm is out of action: after bus-off, and after a drive has been reset.

Simulated drives on the virtual bus at 1 Mbit/s; the driver is this process. Each time begins with the
cause: that the controller is off the bus, that it may be on it again, that a drive boots. ``enable`` is sent
as soon as the driver takes it; motion is possible when the arm is ENABLED. A simulated drive boots for 50 ms.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import crtk_drivers
from bench.report import options, show
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.process import RunningSim

JOINT = {
    "gear": 100.0,
    "lower": -3.0,
    "upper": 3.0,
    "velocity": 2.0,
    "effort": 20.0,
    "modes": ("csp", "csv", "cst"),
}

PATIENCE = 60.0
"""Seconds after which something is not waited for any longer."""


def until(done: Callable[[], bool], what: str) -> float:
    """Wait for it, and return when (monotonic s) it was so."""
    end = time.monotonic() + PATIENCE
    while not done():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {PATIENCE:g} s: {what}")
        time.sleep(0.0005)
    return time.monotonic()


def fault(arm: LocalDevice) -> bool:
    """Whether the arm is in FAULT."""
    return arm.operating_state().state == "FAULT"


def enabled(arm: LocalDevice) -> bool:
    """Enable the arm; return whether it worked."""
    try:
        arm.enable(PATIENCE)
    except (CommandRefused, TransitionFailed):
        return False
    return True


def bus_off(sim: RunningSim, arm: LocalDevice) -> list[float]:
    """Return the seconds to FAULT, from the bus's return to the connection, and to ENABLED."""
    begin = time.monotonic()
    sim.control.inject("bus_off", node="native*")
    told = until(lambda: fault(arm), "it is in FAULT")
    sim.control.clear()
    back = time.monotonic()
    connected = until(lambda: arm.engine.connected and not fault(arm), "it is connected")
    ready = until(lambda: enabled(arm), "it is enabled")
    return [told - begin, connected - back, ready - back]


def reset(sim: RunningSim, arm: LocalDevice) -> list[float]:
    """Return the seconds from a drive's reset to FAULT, and to ENABLED."""
    begin = time.monotonic()
    sim.control.inject("reset", node=3)
    told = until(lambda: fault(arm), "it is in FAULT")
    ready = until(lambda: enabled(arm), "it is enabled")
    return [told - begin, ready - begin]


def main() -> None:
    """Measure and print."""
    given = options(
        __doc__ or "",
        runs=(10, "of each"),
        drives=(6, "number of drives"),
        period=(0.008, "of the cycle, s"),
    )
    rows = []
    with SIM.spawn(nodes=given.drives, bitrate=1_000_000, realtime=True) as sim:
        bus = {"interface": "crtk", "channel": sim.paths["crtk"]}
        joints = {f"joint_{node}": {**JOINT, "node": node} for node in range(1, given.drives + 1)}
        values = {"bus": bus, "joints": joints, "period": given.period}
        with crtk_drivers.connect("canopen", config=values, timeout=PATIENCE) as arm:
            until(lambda: enabled(arm), "it is enabled")
            off = np.array([bus_off(sim, arm) for _ in range(given.runs)])
            anew = np.array([reset(sim, arm) for _ in range(given.runs)])
    for label, seconds in (
        ("bus-off: to FAULT", off[:, 0]),
        ("the bus is back: to the connection", off[:, 1]),
        ("the bus is back: to motion possible again", off[:, 2]),
        ("a drive is reset: to FAULT", anew[:, 0]),
        ("a drive is reset: to motion possible again", anew[:, 1]),
    ):
        rows.append((label, f"{np.median(seconds) * 1e3:.0f}", f"{seconds.max() * 1e3:.0f}"))
    show(
        f"{given.drives} drives, a cycle of {1e3 * given.period:g} ms",
        ("from what, to what", "median ms", "max ms"),
        rows,
        [f"{given.runs} times each."],
    )


if __name__ == "__main__":
    main()
