"""One step of a Force Dimension device: our driver's own calls beside those of forcedimension-core.

A step reads pose, velocities, forces, gripper and buttons and sends force, torque and gripper force, as the
driver's process does a thousand times a second. Both call the simulated library in this process.

    python -m bench.force_dimension
"""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import c_double
from pathlib import Path

from bench.report import options, show_calls
from crtk_driver_force_dimension.config import ForceDimensionConfig
from crtk_driver_force_dimension.process import DhdHand
from crtk_driver_force_dimension.traits import traits_of
from crtk_sim_backends.force_dimension import SIM

MODEL = "omega.7"
FORCE = (0.1, 0.2, 0.3)
TORQUE = (0.0, 0.0, 0.0)
GRIP = 0.5


@contextmanager
def ours(library: str) -> Iterator[Callable[[], None]]:
    """Yield a step by the driver's own calls."""
    hand = DhdHand()
    hand.open(traits_of(ForceDimensionConfig(model=MODEL, library=library)).hand)

    def step() -> None:
        hand.read()
        hand.push(FORCE, TORQUE, GRIP)

    yield step
    hand.close()


@contextmanager
def theirs(library: str) -> Iterator[Callable[[], None]]:
    """Yield a step by forcedimension-core, with the buffers that its documentation shows."""
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root, "lib", "release", f"lin-{platform.machine()}-gcc")
        folder.mkdir(parents=True)
        (folder / "libdrd.so.3").symlink_to(library)
        os.environ["FDSDK"] = root
        from forcedimension_core import dhd

    place, velocity, turning, force, torque = ([0.0] * 3 for _ in range(5))
    frame = [[0.0] * 3 for _ in range(3)]
    grip, angle, speed = c_double(), c_double(), c_double()

    def step() -> None:
        dhd.getPositionAndOrientationFrame(place, frame)
        dhd.getLinearVelocity(velocity)
        dhd.getAngularVelocityRad(turning)
        dhd.getForceAndTorqueAndGripperForce(force, torque, grip)
        dhd.getGripperAngleRad(angle)
        dhd.getGripperAngularVelocityRad(speed)
        dhd.getButtonMask()
        dhd.setForceAndTorqueAndGripperForce(FORCE, TORQUE, GRIP)

    dhd.open()
    yield step
    dhd.close()


def main() -> None:
    """Time both."""
    chosen = options(__doc__ or "", calls=(2000, "steps in a round"))
    with SIM.spawn(model=MODEL) as sim:
        library = sim.paths["library"]
        with ours(library) as own, theirs(library) as other:
            steps = {"driver": own, "forcedimension-core": other}
            show_calls(f"A step of {MODEL}", steps, int(chosen.calls))


if __name__ == "__main__":
    main()
