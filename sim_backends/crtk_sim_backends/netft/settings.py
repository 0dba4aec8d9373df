"""What a sensor box is set to, and how its web pages set it: it clamps and rounds silently."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeAlias

import numpy as np

from crtk_sim_backends.kit.loads import Array, rotation
from crtk_sim_backends.netft import units
from crtk_sim_backends.netft.profiles import Preset, Profile

CONFIGURATIONS: Final = 16
CONDITIONS: Final = 16
MOST_RECORDS: Final = 40
GAGE_COUNTS: Final = 20_000
"""Gage counts at the rated load; one gage for each axis (assumed: real ones have a 6 by 6 matrix)."""

_LARGEST_COUNT: Final = 1_000_000_000  # of the rated load, so that it fits 32 bits in any unit


@dataclass
class Configuration:
    """One of the 16 configurations: units, tool transform and names."""

    name: str
    force_unit: int
    torque_unit: int
    calibration: int = 0
    distance_unit: int = 3
    angle_unit: int = 1
    transform: list[float] = field(default_factory=lambda: [0.0] * 6)
    text_a: str = ""
    text_b: str = ""

    @property
    def matrix(self) -> Array:
        """Takes a wrench (6,) of the transducer to one in the tool's frame and about its origin."""
        distance = units.DISTANCE[self.distance_unit].factor
        angle = units.ANGLE[self.angle_unit].factor
        x, y, z = (value * distance for value in self.transform[:3])
        turned = np.eye(3)
        for axis, value in zip(np.eye(3), self.transform[3:], strict=True):
            turned = turned @ rotation(axis * value * angle)
        lever = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        result = np.zeros((6, 6))
        result[:3, :3] = result[3:, 3:] = turned.T
        result[3:, :3] = -turned.T @ lever
        return result


@dataclass
class Condition:
    """A monitor condition: breached while counts of `axis` are above (compare 1) or below (-1) `value`."""

    enabled: int = 0
    axis: int = -1
    compare: int = 1
    value: int = 0
    output: int = 0


class Settings:
    """All settings of one box.

    Args:
        profile: its family.
        preset: its sensor.
        rdt_rate: records per second, wanted.
        buffer_size: records in a datagram of the buffered mode.

    Attributes:
        bias: what is subtracted of each axis (6,) of the transducer, N and N·m; lost without power.
        scale_factor: of the calibration's counts per unit; another calibration when it is not 1.
    """

    def __init__(
        self, profile: Profile, preset: Preset, rdt_rate: int, buffer_size: int, internal_rate: int
    ) -> None:
        self.profile = profile
        self.preset = preset
        self.bias: Array = np.zeros(6)
        self.scale_factor = 1.0
        self.active = 0
        force = units.code_of(units.FORCE, preset.force_unit)
        torque = units.code_of(units.TORQUE, preset.torque_unit)
        self.configurations = [
            Configuration("Simulated" if not n else f"Config {n}", force, torque)
            for n in range(CONFIGURATIONS)
        ]
        self.conditions = [Condition() for _ in range(CONDITIONS)]
        self.conditions_enabled = 0
        self.peaks_enabled = 0
        self.filter_code = 0
        self.internal_rate = internal_rate
        self.wanted_rate = rdt_rate
        self.buffer_size = buffer_size
        self.multi_unit = 0
        self.rdt_enabled = 1
        self.ethernet_ip = 0
        self.network = {"dhcp": "0", "ip": "", "msk": "255.255.255.0", "gw": "0.0.0.0"}

    @property
    def configuration(self) -> Configuration:
        """The active one."""
        return self.configurations[self.active]

    @property
    def divisor(self) -> int:
        """Measurements from one record to the next."""
        return self.internal_rate // max(1, min(self.wanted_rate, self.internal_rate))

    @property
    def rdt_rate(self) -> int:
        """Records per second, as it reads back."""
        return self.internal_rate // self.divisor

    @property
    def rated(self) -> Array:
        """Rated load (6,), N and N·m."""
        preset = self.preset
        force = units.FORCE[units.code_of(units.FORCE, preset.force_unit)].factor
        torque = units.TORQUE[units.code_of(units.TORQUE, preset.torque_unit)].factor
        rated: Array = np.array(preset.rated) * np.repeat((force, torque), 3)
        return rated

    def unit_factors(self, configuration: Configuration) -> Array:
        """SI value of one unit of each axis (6,)."""
        force = units.FORCE[configuration.force_unit].factor
        torque = units.TORQUE[configuration.torque_unit].factor
        factors: Array = np.repeat((force, torque), 3)
        return factors

    def counts_per_unit(self, configuration: Configuration) -> tuple[int, int]:
        """Counts in one unit of force and of torque; fewer by tens where they would not fit."""
        rated = self.rated / self.unit_factors(configuration)
        counts = []
        for axes, count in (
            (rated[:3], self.preset.counts_per_force),
            (rated[3:], self.preset.counts_per_torque),
        ):
            while axes.max() * count > _LARGEST_COUNT and count > 1:
                count //= 10
            counts.append(max(1, round(count * self.scale_factor)))
        return counts[0], counts[1]

    @property
    def counts_per_si(self) -> Array:
        """Counts in 1 N and 1 N·m of each axis (6,), in the active configuration."""
        active = self.configuration
        counts: Array = np.repeat(self.counts_per_unit(active), 3) / self.unit_factors(active)
        return counts

    @property
    def steps(self) -> tuple[int, ...]:
        """Counts in one step of the 16-bit values of the TCP channel, of each axis."""
        top = self.rated * self.counts_per_si
        force, torque = (math.ceil(axes.max() / 32767) for axes in (top[:3], top[3:]))
        return (max(1, force),) * 3 + (max(1, torque),) * 3

    @property
    def gages(self) -> list[int]:
        """The bias as gage values."""
        counts: list[int] = np.rint(self.bias / self.rated * GAGE_COUNTS).astype(int).tolist()
        return counts

    def set_filter(self, code: int) -> None:
        """Choose the low-pass; the nearest code that exists."""
        self.filter_code = _clamp(code, 0, self.profile.filter_codes)

    # The web pages that set something

    def write(self, page: str, pairs: Iterable[tuple[str, str]]) -> bool:
        """Set what a CGI page was called with; False when there is no such page.

        Unknown variables and values that are no numbers change nothing; the rest is clamped.
        """
        if page not in PAGES:
            return False
        named = dict(pairs)
        target = self.configuration
        if page == "config.cgi":
            index = _number(named.get("cfgid", ""))
            if index is None:
                return True
            target = self.configurations[_clamp(index, 0, CONFIGURATIONS - 1)]
        for name, text in named.items():
            match = re.fullmatch(r"([a-z]+)(\d*)", name)
            setter = PAGES[page].get(match[1]) if match else None
            if setter is not None and match is not None:
                setter(self, target, int(match[2] or -1), text)
        return True


_Setter: TypeAlias = Callable[[Settings, Configuration, int, str], None]


def _clamp(value: float, low: int, high: int) -> int:
    return int(max(low, min(value, high)))


def _number(text: str) -> float | None:
    try:
        value = float(int(text, 16)) if text.lower().startswith("0x") else float(text)
    except (ValueError, OverflowError):
        return None
    return value if math.isfinite(value) else None


def _whole(attribute: str, low: int, high: int) -> _Setter:
    def setter(settings: Settings, target: Configuration, index: int, text: str) -> None:
        value = _number(text)
        if value is not None:
            setattr(settings, attribute, _clamp(value, low, high))

    return setter


def _of_configuration(attribute: str, low: int, high: int) -> _Setter:
    def setter(settings: Settings, target: Configuration, index: int, text: str) -> None:
        value = _number(text)
        if value is not None:
            setattr(target, attribute, _clamp(value, low, high))

    return setter


def _text(attribute: str) -> _Setter:
    def setter(settings: Settings, target: Configuration, index: int, text: str) -> None:
        setattr(target, attribute, "".join(filter(str.isprintable, text))[:32])

    return setter


def _of_condition(attribute: str, low: int, high: int) -> _Setter:
    def setter(settings: Settings, target: Configuration, index: int, text: str) -> None:
        value = _number(text)
        if value is not None and 0 <= index < CONDITIONS:
            setattr(settings.conditions[index], attribute, _clamp(value, low, high))

    return setter


def _compare(settings: Settings, target: Configuration, index: int, text: str) -> None:
    value = _number(text)
    if value is not None and 0 <= index < CONDITIONS:
        settings.conditions[index].compare = 1 if value >= 0 else -1


def _filter(settings: Settings, target: Configuration, index: int, text: str) -> None:
    value = _number(text)
    if value is not None:
        settings.set_filter(int(value))


def _adc_rate(settings: Settings, target: Configuration, index: int, text: str) -> None:
    value, codes = _number(text), settings.profile.adc_codes
    if value is not None and codes:
        settings.internal_rate = min(codes, key=lambda rate: abs(codes[rate] - value))


def _bias(settings: Settings, target: Configuration, index: int, text: str) -> None:
    value = _number(text)
    if value is not None and 0 <= index < 6:
        gage = _clamp(value, -32768, 32767)
        settings.bias[index] = gage * settings.rated[index] / GAGE_COUNTS


def _transform(settings: Settings, target: Configuration, index: int, text: str) -> None:
    value = _number(text)
    if value is not None and 0 <= index < 6:
        target.transform[index] = max(-1e6, min(value, 1e6))


def _network(key: str) -> _Setter:
    def setter(settings: Settings, target: Configuration, index: int, text: str) -> None:
        settings.network[key] = "".join(filter(str.isprintable, text))[:15]

    return setter


PAGES: Final[Mapping[str, Mapping[str, _Setter]]] = {
    "setting.cgi": {
        "setcfgsel": _whole("active", 0, CONFIGURATIONS - 1),
        "setuserfilter": _filter,
        "setpke": _whole("peaks_enabled", 0, 1),
        "setmce": _whole("conditions_enabled", 0, 1),
        "setbias": _bias,
        "setadcrate": _adc_rate,
    },
    "moncon.cgi": {
        "setmce": _whole("conditions_enabled", 0, 1),
        "mce": _of_condition("enabled", 0, 1),
        "mcx": _of_condition("axis", -1, 5),
        "mcc": _compare,
        "mcv": _of_condition("value", -(2**31), 2**31 - 1),
        "mco": _of_condition("output", 0, 255),
    },
    "config.cgi": {
        "cfgnam": _text("name"),
        "cfgcalsel": _of_configuration("calibration", 0, 0),
        "cfgfu": _of_configuration("force_unit", 1, len(units.FORCE)),
        "cfgtu": _of_configuration("torque_unit", 1, len(units.TORQUE)),
        "cfgtdu": _of_configuration("distance_unit", 1, len(units.DISTANCE)),
        "cfgtau": _of_configuration("angle_unit", 1, len(units.ANGLE)),
        "cfgtfx": _transform,
        "cfgusra": _text("text_a"),
        "cfgusrb": _text("text_b"),
    },
    "comm.cgi": {
        "comnetdhcp": _network("dhcp"),
        "comnetip": _network("ip"),
        "comnetmsk": _network("msk"),
        "comnetgw": _network("gw"),
        "comrdte": _whole("rdt_enabled", 0, 1),
        "comrdtrate": _whole("wanted_rate", 1, 8000),
        "comrdtbsiz": _whole("buffer_size", 1, MOST_RECORDS),
        "comrdtmsyn": _whole("multi_unit", 0, 65535),
        "comeipe": _whole("ethernet_ip", 0, 1),
    },
}
"""Pages that set something, their variables (without index) and what each does."""
