"""The families of sensors that speak RDT, as data: commands, rates, status bits.

Sources: ATI 9620-05-NET FT (Net Box); ATI 9610-05-Ethernet Axia and 9620-05-C-Ethernet Axia (Axia80, 90, 130;
SCHUNK sells the same firmware as FTN); the status word of OptoForce's sensors, which OnRobot took over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from crtk_drivers.kit.sensing.status_words import Bit, Meaning, StatusTable

_ERROR, _NOTICE, _SATURATED = Meaning.ERROR, Meaning.NOTICE, Meaning.SATURATED


class Mode(StrEnum):
    """How the records come."""

    REALTIME = "realtime"
    """One in each datagram."""
    SINGLE = "single"
    """The same by another command, which the Axia has beside it."""
    BUFFERED = "buffered"
    """Several in each datagram: a fraction of the load, and late by as many samples."""


class Action(StrEnum):
    """What a sensor can be asked for besides its stream."""

    STOP = "stop"
    BIAS = "bias"
    UNBIAS = "unbias"
    CLEAR_LATCH = "clear latch"


Request = tuple[int, int]
"""Command and count."""


@dataclass(frozen=True)
class Profile:
    """One family.

    Attributes:
        name: as in the configuration.
        summary: the products.
        starts: command of each mode that it knows.
        actions: requests by what they do; what is missing cannot be asked for over RDT.
        internal_rates: samples per second that it measures, the fastest first.
        status: the meaning of its status word.
        has_web: configuration by HTTP.
        adc_rates: the rates that ``setadcrate`` takes, by the internal rate that follows; empty without.
        filters: -3 dB frequency in Hz of each filter code, where the family's manual lists them.
        counts: per N and per N·m, where every sensor of the family has the same; None otherwise.
        filter_by_rdt, period_by_rdt: command for the filter code and the period in ms, None without.
    """

    name: str
    summary: str
    starts: Mapping[Mode, int]
    actions: Mapping[Action, Request]
    internal_rates: tuple[int, ...]
    status: StatusTable
    has_web: bool = True
    adc_rates: Mapping[int, int] = field(default_factory=dict)
    filters: Mapping[int, float] = field(default_factory=dict)
    counts: tuple[float, float] | None = None
    filter_by_rdt: int | None = None
    period_by_rdt: int | None = None

    @property
    def rate(self) -> int:
        """The internal rate of a sensor that was not configured otherwise, in Hz."""
        return self.internal_rates[0]


def reachable_rate(wanted: float, internal: int) -> int:
    """Return the rate of records (Hz) that the sensor makes of a wanted one: the next one up.

    It is the internal rate over a whole number, itself cut to a whole number.
    """
    whole = max(1, min(int(wanted), internal))
    return internal // (internal // whole)


_NETBOX_STATUS = StatusTable(
    (
        Bit(1 << 30, _ERROR, "CPU or RAM error"),
        Bit(1 << 29, _ERROR, "digital board error"),
        Bit(1 << 28, _ERROR, "analog board error"),
        Bit(1 << 27, _ERROR, "serial link between the boards failed"),
        Bit(1 << 26, _ERROR, "program memory error"),
        Bit(1 << 25, _ERROR, "halted, configuration error"),
        Bit(1 << 24, _ERROR, "settings failed their validation"),
        Bit(1 << 23, _ERROR, "configuration does not suit the calibration"),
        Bit(1 << 22, _ERROR, "network error"),
        Bit(1 << 21, _ERROR, "CAN error"),
        Bit(1 << 20, _ERROR, "RDT error"),
        Bit(1 << 19, _ERROR, "EtherNet/IP error"),
        Bit(1 << 18, _ERROR, "DeviceNet error"),
        Bit(1 << 17, _SATURATED, "transducer saturated, or A/D error"),
        Bit(1 << 16, _NOTICE, "monitor condition latched"),
        Bit(1 << 14, _ERROR, "watchdog reset"),
        Bit(1 << 13, _ERROR, "stack error"),
        Bit(1 << 12, _ERROR, "EEPROM (I2C) error"),
        Bit(1 << 11, _ERROR, "flash (SPI) error"),
        Bit(1 << 10, _ERROR, "analog watchdog"),
        Bit(1 << 9, _ERROR, "gage excitation takes too much current"),
        Bit(1 << 8, _ERROR, "gage excitation takes too little current"),
        Bit(1 << 7, _ERROR, "artificial analog ground out of range"),
        Bit(1 << 6, _ERROR, "analog supply too high"),
        Bit(1 << 5, _ERROR, "analog supply too low"),
        Bit(1 << 4, _ERROR, "no data on the serial link"),
        Bit(1 << 3, _ERROR, "reference voltage out of range"),
        Bit(1 << 2, _ERROR, "temperature out of range"),
        Bit(1 << 1, _ERROR, "HTTP error"),
    ),
    has_summary=True,
    notices_set_summary=True,
)

_AXIA_STATUS = StatusTable(
    (
        Bit(1 << 30, _SATURATED, "force or torque out of range"),
        Bit(1 << 29, _ERROR, "calibration checksum wrong"),
        Bit(1 << 28, _NOTICE, "simulated error"),
        Bit(1 << 27, _SATURATED, "gage out of range"),
        Bit(1 << 16, _NOTICE, "monitor condition latched"),
        Bit(1 << 7, _ERROR, "calibration not accessible"),
        Bit(1 << 5, _ERROR, "other error"),
        Bit(1 << 3, _NOTICE, "busy"),
        Bit(1 << 2, _ERROR, "gage broken"),
        Bit(1 << 1, _ERROR, "supply not within 12 to 32 V"),
        Bit(1 << 0, _ERROR, "temperature out of range"),
    ),
    has_summary=True,
)

_ONROBOT_STATUS = StatusTable(
    (
        Bit(7 << 13, _ERROR, "error of the data acquisition"),
        Bit(7 << 10, _ERROR, "sensor not detected, failed or too hot"),
        Bit(1 << 9, _SATURATED, "Fx overloaded"),
        Bit(1 << 8, _SATURATED, "Fy overloaded"),
        Bit(1 << 7, _SATURATED, "Fz overloaded"),
        Bit(1 << 6, _SATURATED, "Tx overloaded"),
        Bit(1 << 5, _SATURATED, "Ty overloaded"),
        Bit(1 << 4, _SATURATED, "Tz overloaded"),
    ),
    has_summary=False,
)

_AXIA_STARTS = {Mode.REALTIME: 0x0002, Mode.SINGLE: 0x0001, Mode.BUFFERED: 0x0003}
_ATI_ACTIONS = {Action.STOP: (0x0000, 0), Action.BIAS: (0x0042, 0)}
_AXIA_RATES = {7912: 7812, 3956: 3906, 1978: 1953, 989: 976, 494: 488}

NETBOX = Profile(
    name="netbox",
    summary="ATI Net F/T with a Net Box (NETB, NETBA)",
    starts={Mode.REALTIME: 0x0002, Mode.BUFFERED: 0x0003},
    actions={**_ATI_ACTIONS, Action.CLEAR_LATCH: (0x0041, 0)},
    internal_rates=(7000,),
    status=_NETBOX_STATUS,
    filters=MappingProxyType(
        {0: 0.0, 1: 838.0, 2: 326.0, 3: 152.0, 4: 73.0, 5: 35.0, 6: 18.0, 7: 8.0, 8: 5.0}
        | {9: 1500.0, 10: 2000.0, 11: 2500.0, 12: 3000.0}
    ),
)

AXIA = Profile(
    name="axia",
    summary="ATI Ethernet Axia (Axia80, Axia90, Axia130)",
    starts=_AXIA_STARTS,
    actions=_ATI_ACTIONS,
    internal_rates=tuple(_AXIA_RATES),
    status=_AXIA_STATUS,
    adc_rates=MappingProxyType(_AXIA_RATES),
)

SCHUNK = Profile(
    name="schunk",
    summary="SCHUNK FTN-AXIA, FTN-Gamma",
    starts=AXIA.starts,
    actions=AXIA.actions,
    internal_rates=AXIA.internal_rates,
    status=AXIA.status,
    adc_rates=AXIA.adc_rates,
)

ONROBOT = Profile(
    name="onrobot",
    summary="OnRobot HEX-E, HEX-H (OptoForce) with a Compute Box",
    starts={Mode.REALTIME: 0x0002},
    actions={
        Action.STOP: (0x0000, 0),
        Action.BIAS: (0x0042, 255),
        Action.UNBIAS: (0x0042, 0),
    },
    internal_rates=(1000,),
    status=_ONROBOT_STATUS,
    has_web=False,
    filters=MappingProxyType({0: 0.0, 1: 500.0, 2: 150.0, 3: 50.0, 4: 15.0, 5: 5.0, 6: 1.5}),
    counts=(10000.0, 100000.0),
    filter_by_rdt=0x0081,
    period_by_rdt=0x0082,
)

PROFILES: Final[Mapping[str, Profile]] = MappingProxyType(
    {profile.name: profile for profile in (NETBOX, AXIA, SCHUNK, ONROBOT)}
)


def detect(product: str) -> Profile:
    """Return the profile of a product name as the sensor's web page gives it; the Net Box by default."""
    lower = product.lower()
    if "schunk" in lower or "ftn" in lower:
        return SCHUNK
    return AXIA if "axia" in lower else NETBOX
