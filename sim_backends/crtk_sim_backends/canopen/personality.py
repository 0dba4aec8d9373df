"""Whose drive it is: identity and the habits in which drives of the market differ."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from crtk_sim_backends.canopen import epos4
from crtk_sim_backends.canopen.dictionary import Key, Object, OfNode
from crtk_sim_backends.canopen.makers import MAKERS
from crtk_sim_backends.canopen.units import CIA, Habits

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
        product: product code in 1018.
        revision: in 1018.
        lacks: objects that it has not, or entries of them.
        adds: objects of its own.
        constant: objects that cannot be written.
        tells_modes: what 6502 says, whatever modes it has; None: the truth.
        home_position: its own object for the position at home, in place of 607C.
        home_move: its own object for the way that it goes after homing, before that counts.
        pulses: its own object for a quarter of the increments of a turn, in place of 608F.
        torque_unit: N·m for one unit of 6076.
        habits: in what it counts rates where no object tells it.
        codes: error codes that it has in place of those of CiA 402-2.
        limit_codes: error codes of its limit switches, negative and positive.
        keeps_no_rtr: it refuses a COB-ID of a TPDO without bit 30.
        faults_at_stop: with STO active it faults when it is to get power; else it does not get ready.
    """

    name: str
    vendor: int
    device: str
    summary: str
    defaults: tuple[tuple[int, int, int | OfNode], ...] = ()
    ignores: tuple[int, ...] = ()
    no_block: bool = False
    boot: float = 0.05
    offset_to_zero: bool = False
    product: int = PRODUCT
    revision: int = REVISION
    lacks: frozenset[int | Key] = frozenset()
    adds: tuple[Object, ...] = ()
    constant: frozenset[int] = frozenset()
    tells_modes: int | None = None
    home_position: Key | None = None
    home_move: Key | None = None
    pulses: Key | None = None
    torque_unit: float = 1e-3
    habits: Habits = CIA
    codes: tuple[tuple[int, int], ...] = ()
    limit_codes: tuple[int, int] = (0x8612, 0x8612)
    keeps_no_rtr: bool = False
    faults_at_stop: bool = False


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
        Personality(
            "epos4",
            epos4.VENDOR,
            epos4.DEVICE,
            "a Maxon EPOS4: rpm, no 607C, and 6502 does not tell csp and csv",
            epos4.DEFAULTS,
            product=epos4.PRODUCT,
            revision=epos4.REVISION,
            lacks=epos4.LACKS,
            adds=epos4.ADDS,
            constant=epos4.CONSTANT,
            tells_modes=epos4.TELLS_MODES,
            home_position=epos4.HOME_POSITION,
            home_move=epos4.HOME_MOVE,
            pulses=epos4.PULSES,
            torque_unit=1e-6,
            codes=epos4.CODES,
            limit_codes=epos4.LIMIT_CODES,
            keeps_no_rtr=True,
            faults_at_stop=True,
        ),
        *(
            Personality(
                name,
                0x0000_1F10 + number,
                maker.device,
                maker.summary,
                maker.defaults,
                lacks=maker.lacks,
                habits=maker.habits,
            )
            for number, (name, maker) in enumerate(MAKERS.items())
        ),
    )
}

TORQUE_UNITS: Final = {epos4.VENDOR: 1e-6}
"""N·m for one unit of 6076 in the files of a maker, by vendor-ID, where it is not mN·m."""
