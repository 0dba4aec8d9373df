"""Forces on a hand at 1 kHz and more: fixtures, what bounds their energy, and the loop of both.

Numbers in, numbers out: no I/O, no thread, no clock. A driver of a haptic device calls `ForceLoop.step` where
it reads and writes its device anyway. Plain tuples, since a cycle may be 0.25 ms.
"""

from crtk_drivers.kit.haptics.fixtures import (
    Box,
    Fixture,
    Motion,
    Sphere,
    Spring,
    Wall,
    fixtures_from,
)
from crtk_drivers.kit.haptics.force_loop import ForceLimits, ForceLoop
from crtk_drivers.kit.haptics.passivity import EnergyTank, TankLimits
from crtk_drivers.kit.haptics.triples import ZERO, Triple, Wrench6

__all__ = [
    "ZERO",
    "Box",
    "EnergyTank",
    "Fixture",
    "ForceLimits",
    "ForceLoop",
    "Motion",
    "Sphere",
    "Spring",
    "TankLimits",
    "Triple",
    "Wall",
    "Wrench6",
    "fixtures_from",
]
