"""Raven II: packets one way, to a simulated network layer.

Nothing comes back, so nothing that happens there can be told. What is watched is where both arms are: they
stand, whatever becomes of the driver.
"""

from __future__ import annotations

import numpy as np
from typing_extensions import override

from bench.reliability.common import UNMOVED, passing
from bench.reliability.rig import Rig
from bench.reliability.table import REST, Absent, Follows, Way
from crtk_driver_raven import PLUGIN
from crtk_sim_backends.raven import SIM

MICROMETRE = 1e-6

WAYS = (
    Way("F1", "its software ends", kind="closed"),
    Way("F3", "its software does not run", Follows.STARTS_LATER, "closed", within=3.0),
    passing("F8", "every 3rd packet is lost", "loss", every=3),
    passing("F8", "every 3rd packet comes twice", "duplicate", every=3),
    passing("F8", "every 4th packet is overtaken", "late", every=4, by=2),
    *UNMOVED,
    Way("F20", "a second driver on this machine", Follows.KEPT_OUT, detail="drives it already"),
)

ABSENT = (
    Absent("F2", "it is silent always"),
    Absent("F4", "a datagram arrives whole or not at all"),
    Absent("F5", "nothing comes that could be damaged"),
    Absent("F6", "one packet is for both arms"),
    Absent("F7", "no adapter; a cable that is out is not told by UDP: docs/raven.md"),
    Absent("F9", "no sensor"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat of its own"),
    Absent("F12", "it reports nothing"),
    Absent("F13", "an emergency stop is not told: docs/raven.md"),
    Absent("F14", "another console is not told: docs/raven.md"),
    Absent("F15", "streams are of its arms: tests/raven"),
    Absent("F16", "it lifts its pedal 5 s after the last packet: tests/raven"),
)


class RavenRig(Rig):
    """Both arms, at rest."""

    name = "raven"
    plugin = PLUGIN
    simulator = SIM
    ways = WAYS
    absent = ABSENT
    activities = (REST,)
    values = {"sample_timeout": 1.0, "rate": 250}  # noqa: RUF012

    @override
    def joints(self) -> np.ndarray:
        assert self.sim is not None
        status = self.sim.control.status()
        return MICROMETRE * np.array([*status["gold"], *status["green"]])

    @override
    def home(self) -> np.ndarray:
        return self.joints()
