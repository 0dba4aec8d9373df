"""An NDI tracker: a simulated Vega over TCP. Nothing moves; what counts is what is told of its tools."""

from __future__ import annotations

import time

from typing_extensions import override

from bench.reliability.common import UNMOVED, UnmovedRig, frozen, passing
from bench.reliability.disturbed import DisturbedDevice
from bench.reliability.rig import HELD_UP, SLACK
from bench.reliability.table import Absent, Follows, Way
from crtk_driver_ndi import PLUGIN
from crtk_driver_ndi.device import NdiDevice
from crtk_sim_backends.ndi import SIM

SAMPLES = 1.0
"""`sample_timeout` of tests, s."""
TCP = {"port": "tcp"}
_OUT = {"port": "tcp", "direction": "out"}
RATE = 60.0
"""Of the simulated Vega, Hz."""
YOUNGER = 1.0 / RATE + 0.02
"""Seconds by which a stamp may be too young: a period, and what a busy machine takes."""

WAYS = (
    Way("F1", "the connection is closed", kind="disconnect", parameters=TCP),
    Way("F2", "the connection is half open", kind="silence", parameters=TCP, within=SAMPLES),
    Way("F2", "it shows one frame again and again", kind="frozen", within=SAMPLES),
    *frozen(within=SAMPLES),
    Way("F3", "nobody accepts", Follows.STARTS_LATER, "disconnect", TCP, within=3.0),
    Way("F3", "nobody answers", Follows.STARTS_LATER, "no_answer", TCP, within=4.0),
    passing("F4", "byte by byte", "split", size=1, **TCP),
    passing("F4", "in lumps of 20 ms", "coalesce", seconds=0.02, **TCP),
    passing("F5", "every 4th reply is damaged", "damage", every=4),
    passing("F5", "a component of an unknown type", "strange"),
    Way("F5", "every reply is damaged", kind="damage", parameters={"every": 1}, within=SAMPLES),
    Way("F5", "a reply that says it has 4 GiB", kind="hostile_length", within=SAMPLES),
    passing("F8", "replies are held back by 50 ms, from mid-stream", "delay", seconds=0.05, **_OUT),
    passing("F8", "replies are held back by 0.3 s, from mid-stream", "delay", seconds=0.3, **_OUT),
    Way("F9", "it is reset", kind="reset", detail="reset"),
    Way("F12", "ERROR1A", kind="error", parameters={"command": "BX2"}, detail="ERROR1A"),
    Way(
        "F14",
        "another client stops tracking",
        kind="stop_tracking",
        states=("DISABLED",),
        detail="another client",
    ),
    *UNMOVED,
)

ABSENT = (
    Absent("F6", "one reply has all tools"),
    Absent("F7", "over TCP it is F1; over a serial line it is the kit's, as with DYNAMIXEL"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the replies, F2"),
    Absent("F13", "no safety system"),
    Absent("F15", "takes no commands that move"),
    Absent("F16", "nothing moves, so nothing has to be stopped"),
    Absent("F20", "over TCP it serves any client, and what another does is F14"),
)


_PATIENT = {"sample_timeout": SAMPLES + HELD_UP, "open_timeout": 5.0}


class NdiRig(UnmovedRig):
    """The tracker."""

    name = "ndi"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"family": "vega"}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    values = _PATIENT

    @override
    def check_stamps(self) -> None:
        """Promise 4, of what its tools tell, and by when the simulator took the frames."""
        if not self._frozen:
            self._check_frame()
        for name, engine in self.driver.children.items():
            found = engine.feedback("measured_cp")
            if found is not None and found[1].wall_ns:
                age = time.monotonic() - found[1].monotonic
                fresh = age < engine.options.sample_timeout + SLACK
                self.require(fresh, f"{name} is stamped as valid, but is {age:.3f} s old")

    def _check_frame(self) -> None:
        around = self.driver.engine.device
        assert isinstance(around, DisturbedDevice)
        device = around.inner
        assert isinstance(device, NdiDevice)
        stream, sim = device.stream, self.sim
        if stream is None or sim is None or stream.newest is None:
            return
        newest, stamp = stream.newest, stream.stamp
        told = sim.control.status()
        if told["mode"] == "tracking":
            younger = stamp.monotonic - (told["origin"] + newest.number / RATE)
            self.require(younger < YOUNGER, f"a frame is stamped {younger:.3f} s too young")
