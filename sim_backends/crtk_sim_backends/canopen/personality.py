"""Whose drive it is: identity and the habits in which drives of the market differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

PRODUCT: Final = 0x0402
REVISION: Final = 0x0001_0000


@dataclass(frozen=True)
class Personality:
    """What one make of drive does otherwise than another.

    Attributes:
        name: by which it is chosen.
        vendor: vendor-ID in 1018; not one that CiA has given to anybody.
        device: manufacturer device name, 1008.
        summary: its habits, for people.
        defaults: values of objects after a reset that differ from those of the others.
        ignores: objects to which it accepts writes that have no effect.
        no_block: it has no block transfer.
        boot: time from a reset to the boot-up message, s.
        offset_to_zero: the home offset 607C is the way from home to zero, as the text of CiA 402-2 has it;
            else it is the position at home, which is the negative of that.
    """

    name: str
    vendor: int
    device: str
    summary: str
    defaults: tuple[tuple[int, int, int], ...] = ()
    ignores: tuple[int, ...] = ()
    no_block: bool = False
    boot: float = 0.05
    offset_to_zero: bool = False


PERSONALITIES: Final[dict[str, Personality]] = {
    personality.name: personality
    for personality in (
        Personality("standard", 0x0000_1F01, "CRTK simulated drive", "does what CiA 402 says"),
        Personality(
            "careful",
            0x0000_1F02,
            "CRTK careful drive",
            "faults on lost heartbeats by itself, stays in quick stop, supervises SYNC closely",
            defaults=((0x6007, 0, 1), (0x605A, 0, 6), (0x2010, 1, 100)),
        ),
        Personality(
            "plain",
            0x0000_1F03,
            "CRTK plain drive",
            "no block transfer, heartbeat consumer without effect, slow to boot",
            ignores=(0x1016,),
            no_block=True,
            boot=0.5,
        ),
        Personality(
            "literal",
            0x0000_1F04,
            "CRTK literal drive",
            "takes the home offset as the way from home to zero",
            offset_to_zero=True,
        ),
    )
}
