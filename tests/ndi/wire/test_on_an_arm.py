"""A simulated tracker whose markers hang on an arm: the driver tells them where that has them."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from crtk_driver_ndi import PLUGIN
from crtk_drivers.errors import CrtkError
from crtk_drivers.geometry.frames import product, relative
from crtk_drivers.labs.calibration.stillness import distance
from crtk_drivers.labs.lab_file import CarriedEntry
from crtk_drivers.labs.sim_coupling import Coupling, Told, followed
from crtk_drivers.samples import Pose
from rigs.measured_poses import pose
from rigs.ndi_bench import ndi_bench, simulated, write_rom
from rigs.waiting import eventually

STANDS = pose((1.6, 0.2, 0.5), (0.0, np.pi / 2.0, 0.0))
"""Its z axis points away from the arm: the volume is at negative z."""
MOUNTING = pose((0.02, -0.05, 0.11), (0.5, 1.2, -0.7))


def as_entry(at: Pose) -> dict[str, list[float]]:
    return {"position": at.position.tolist(), "orientation": at.orientation.tolist()}


def test_markers_with_and_without_a_wire_are_where_the_arm_has_them(tmp_path: Path) -> None:
    tools = [
        {"name": "pointer", "part_number": "SIM-POINTER"},
        {"name": "marker", "rom": write_rom(tmp_path, "BALLS")},
    ]
    entry = CarriedEntry.model_validate(
        {
            "stands": as_entry(STANDS),
            "markers": {
                "pointer": {"on": "arm"},
                "marker": {"on": "arm", "mounting": as_entry(MOUNTING)},
            },
        }
    )
    at: dict[str, Pose | None] = {"arm": None}

    def look() -> Told | None:
        if "gone" in at:
            raise CrtkError("the arm is not there")
        arm = at["arm"]
        return None if arm is None else (arm, time.time_ns())

    with (
        simulated(motion="still", noise=0.0, wired="SIM-POINTER") as sim,
        ndi_bench(sim, tools=tools) as bench,
    ):
        follows = list(followed(PLUGIN, bench.session.config, sim, entry, "polaris"))
        assert [each.name for each in follows] == ["polaris pointer", "polaris marker"]

        def told(arm: Pose) -> None:
            for name, mounting in (
                ("pointer", pose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))),
                ("marker", MOUNTING),
            ):
                there = relative(STANDS, product(arm, mounting))

                def is_there(name: str = name, there: Pose = there) -> bool:
                    found = bench.session.children[name].feedback("measured_cp")
                    if found is None or not isinstance(found[0], Pose) or not found[1].wall_ns:
                        return False
                    return max(distance(found[0], there)) < 1e-5

                eventually(is_there, f"{name} is at {there}")

        with Coupling(sim, follows[0], look), Coupling(sim, follows[1], look):
            bench.tracking()
            for arm in (
                pose((0.1, 0.2, 0.4), (0.1, -0.2, 0.3)),
                pose((0.0, 0.1, 0.5), (0.0, 1.0, 0.0)),
            ):
                at["arm"] = arm
                told(arm)
            at["gone"] = None
            told(arm)
            bench.sim.control.inject("hide", tool=1, how="missing")
            bench.sees("marker", visible=False)
            bench.sim.control.clear("hide")
            told(arm)
