"""Makes that count rates otherwise than CiA 402 says, as data of the simulated ones, after their manuals.

Objects and defaults are the machine's, but for the units, in which these drives take and show what they do.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from crtk_sim_backends.canopen.dictionary import Key
from crtk_sim_backends.canopen.units import Counting, Habits

_NO_UNITS: Final[frozenset[int | Key]] = frozenset({0x60A8, 0x60A9, 0x60AA, 0x6091, 0x6092, 0x6096})
_RPM: Final = Counting(60.0, of_turns=True)
_TENTH_RPM: Final = Counting(600.0, of_turns=True)

_Defaults = tuple[tuple[int, int, int], ...]


class Maker(NamedTuple):
    """What one make does otherwise."""

    device: str
    summary: str
    habits: Habits
    lacks: frozenset[int | Key]
    defaults: _Defaults


def _speeds(speed: int, fastest: int, ramp: int, quick: int, window: int) -> _Defaults:
    """Defaults of velocities and accelerations in the units of a make."""
    return (
        *((0x607F, 0, fastest), (0x6081, 0, speed), (0x6099, 1, speed), (0x6099, 2, speed // 10)),
        *((0x6083, 0, ramp), (0x6084, 0, ramp), (0x609A, 0, ramp), (0x60F8, 0, fastest)),
        *((0x6085, 0, quick), (0x60C5, 0, quick), (0x60C6, 0, quick)),
        *((0x606D, 0, window), (0x606F, 0, window)),
    )


MAKERS: Final[dict[str, Maker]] = {
    # Velocities in counts a ms, accelerations in counts a ms squared, both as 16.16; 608F, 6076 not there.
    "technosoft": Maker(
        "Technosoft iPOS",
        "velocities and accelerations in counts a ms (squared), as 16.16, which no object tells",
        Habits(velocity=Counting(65.536), acceleration=Counting(0.065536)),
        _NO_UNITS | {0x608F, 0x6076},
        _speeds(10 * 65536 * 65, 50 * 65536 * 65, 100 * 4295, 400 * 4295, 60000),
    ),
    # rpm x 512 x resolution / 1875, and rps/s x 65536 x resolution / 4000000.
    "kinco": Maker(
        "Kinco FD5",
        "velocities and accelerations in internal units of the drive, which no object tells",
        Habits(
            velocity=Counting(60.0 * 512.0 / 1875.0), acceleration=Counting(65536.0 / 4_000_000.0)
        ),
        _NO_UNITS,
        _speeds(10 * 65536 * 16, 50 * 65536 * 16, 100 * 1074, 400 * 1074, 50000),
    ),
    "roboteq": Maker(
        "Roboteq",
        "velocities in rpm, accelerations in 0.1 rpm a second, which no object tells",
        Habits(velocity=_RPM, acceleration=_TENTH_RPM),
        _NO_UNITS,
        _speeds(1000, 3000, 20_000, 240_000, 3),
    ),
    "ax2000": Maker(
        "Beckhoff AX2000",
        "6083, 6084 and 609A are times of ramps in ms",
        Habits(ramp_time=1e-3),
        _NO_UNITS,
        ((0x6083, 0, 100), (0x6084, 0, 100), (0x609A, 0, 100)),
    ),
    "zlac8015d": Maker(
        "ZLAC8015D",
        "takes velocities in rpm, shows them in 0.1 rpm, and takes times of ramps in ms",
        Habits(velocity=_RPM, shown=_TENTH_RPM, ramp_time=1e-3),
        _NO_UNITS,
        (
            *_speeds(600, 3000, 500, 100 * 65536, 3),
            *((0x6083, 0, 500), (0x6084, 0, 500), (0x609A, 0, 500)),
        ),
    ),
}
"""By name."""
