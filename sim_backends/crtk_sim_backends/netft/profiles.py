"""The families of sensor boxes, and typical sensors, as data.

Sources: ATI 9620-05-NET FT (Net Box); ATI 9610-05-Ethernet Axia and 9620-05-C-Ethernet Axia (Axia80, 90,
130, which SCHUNK sells as FTN-AXIA); OnRobot's Compute Box, which kept OptoForce's protocol and status word.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

SENSOR_PAGE: Final = "netftapi2.xml"
CALIBRATION_PAGE: Final = "netftcalapi.xml"

Six = tuple[float, float, float, float, float, float]


@dataclass(frozen=True)
class Profile:
    """One family.

    Attributes:
        name: as in the options.
        product: what its web page says it is.
        firmware: version.
        rates: measurements per second that it can make, the first unless it is set otherwise.
        adc_codes: the value of ``setadcrate`` for each of these rates; empty when it has but one.
        single: RDT commands that start a stream with one record in a datagram.
        buffered: those with several.
        clears_latch: whether it knows the command 0x0041.
        extended: whether it knows requests that name another address.
        bias_by_count: the count of the bias command says whether to set (255) or clear (0) the bias.
        filter_command, period_command: RDT commands for filter code and period in ms, None without.
        saturated: status word of each axis beyond its range.
        monitor: status word while a monitor condition is latched; 0 when there are no conditions.
        hold: measurements for which saturation stays in the status word.
        filters: cut-off in Hz by filter code, 0 for none; empty where code n averages with weight 2^-n.
        filter_codes: highest filter code.
        pages: its XML pages; one that has no page of its settings has no pages to set them by either.
    """

    name: str
    product: str
    firmware: str
    rates: tuple[int, ...]
    single: frozenset[int]
    saturated: tuple[int, ...]
    adc_codes: Mapping[int, int] = field(default_factory=dict)
    buffered: frozenset[int] = frozenset()
    clears_latch: bool = False
    extended: bool = False
    bias_by_count: bool = False
    filter_command: int | None = None
    period_command: int | None = None
    monitor: int = 0
    hold: int = 0
    filters: Mapping[int, float] = field(default_factory=dict)
    filter_codes: int = 0
    pages: frozenset[str] = frozenset({SENSOR_PAGE, CALIBRATION_PAGE})

    def smoothing(self, code: int, rate: float) -> float:
        """Weight of a new measurement in the first-order low-pass with a filter code; 1.0 for no filter."""
        if not self.filters:
            return 2.0**-code
        cutoff = self.filters[code]
        return 1.0 - math.exp(-2.0 * math.pi * cutoff / rate) if cutoff else 1.0


_NETBOX_FILTERS = (
    0.0,
    838.0,
    326.0,
    152.0,
    73.0,
    35.0,
    18.0,
    8.0,
    5.0,
    1500.0,
    2000.0,
    2500.0,
    3000.0,
)
_ONROBOT_FILTERS = (0.0, 500.0, 150.0, 50.0, 15.0, 5.0, 1.5)
_AXIA_RATES = {7912: 7812, 3956: 3906, 1978: 1953, 989: 976, 494: 488}

_NETBOX = Profile(
    name="netbox",
    product="ATI Net F/T (simulated)",
    firmware="2.2.59",
    rates=(7000,),
    single=frozenset({0x0002, 0x0004}),
    buffered=frozenset({0x0003}),
    clears_latch=True,
    extended=True,
    saturated=(0x80020000,) * 6,
    monitor=0x80010000,
    filters=dict(enumerate(_NETBOX_FILTERS)),
    filter_codes=12,
)


def _axia(name: str, product: str) -> Profile:
    return Profile(
        name=name,
        product=product,
        firmware="1.1.4",
        rates=tuple(_AXIA_RATES),
        adc_codes=_AXIA_RATES,
        single=frozenset({0x0001, 0x0002}),
        buffered=frozenset({0x0003}),
        saturated=(0xC0000000,) * 6,
        monitor=0x00010000,
        hold=32,
        filter_codes=8,
    )


_ONROBOT = Profile(
    name="onrobot",
    product="OnRobot HEX (simulated)",
    firmware="5.10.0",
    rates=(1000,),
    single=frozenset({0x0002}),
    bias_by_count=True,
    filter_command=0x0081,
    period_command=0x0082,
    saturated=(0x200, 0x100, 0x80, 0x40, 0x20, 0x10),
    filters=dict(enumerate(_ONROBOT_FILTERS)),
    filter_codes=6,
    pages=frozenset({CALIBRATION_PAGE}),
)

PROFILES: Final[Mapping[str, Profile]] = {
    profile.name: profile
    for profile in (
        _NETBOX,
        _axia("axia", "ATI Ethernet Axia80 (simulated)"),
        _axia("schunk", "SCHUNK FTN-AXIA80 (simulated)"),
        _ONROBOT,
    )
}


@dataclass(frozen=True)
class Preset:
    """One kind of sensor: what its calibration says.

    Attributes:
        name: as in the options.
        part: of the calibration.
        profile: the family of box that it usually has.
        serial: of the transducer.
        force_unit, torque_unit: names as in `units`.
        counts_per_force, counts_per_torque: per unit.
        rated: the largest load of each axis, in these units.
    """

    name: str
    part: str
    profile: str
    serial: str
    force_unit: str
    torque_unit: str
    counts_per_force: int
    counts_per_torque: int
    rated: Six


PRESETS: Final[Mapping[str, Preset]] = {
    preset.name: preset
    for preset in (
        Preset(
            "nano17", "SI-25-0.25", "netbox", "FT12017", "N", "Nmm",
            1_000_000, 1_000_000, (25.0, 25.0, 35.0, 250.0, 250.0, 250.0),
        ),
        Preset(
            "mini45", "SI-290-10", "netbox", "FT14045", "N", "Nm",
            1_000_000, 1_000_000, (290.0, 290.0, 580.0, 10.0, 10.0, 10.0),
        ),
        Preset(
            "gamma", "SI-330-30", "netbox", "FT27462", "N", "Nm",
            1_000_000, 1_000_000, (330.0, 330.0, 990.0, 30.0, 30.0, 30.0),
        ),
        Preset(
            "axia80", "SI-150-8", "axia", "FT30080", "N", "Nm",
            1_000_000, 1_000_000, (150.0, 150.0, 470.0, 8.0, 8.0, 8.0),
        ),
        Preset(
            "hex_e", "HEX-E", "onrobot", "HEXEB001", "N", "Nm",
            10_000, 100_000, (200.0, 200.0, 200.0, 10.0, 10.0, 6.5),
        ),
    )
}  # fmt: skip

USUAL_PRESET: Final[Mapping[str, str]] = {
    "netbox": "gamma",
    "axia": "axia80",
    "schunk": "axia80",
    "onrobot": "hex_e",
}
"""The preset of a family when none is chosen."""
