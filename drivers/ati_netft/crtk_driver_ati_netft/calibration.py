"""The sensor's configuration pages: ``netftapi2.xml`` and ``netftcalapi.xml``. Text in, values out, no I/O.

The pages are flat lists of tags. Without a scale that is there, unambiguous and in a known unit a page is
refused; everything else may be missing or nonsense, and then counts as unknown. Lists are separated by ``;``,
by ``,`` or by blanks.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, TypeVar
from xml.etree.ElementTree import ParseError

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import fromstring

from crtk_driver_ati_netft import units
from crtk_driver_ati_netft.profiles import AXIA, SCHUNK, detect
from crtk_driver_ati_netft.rdt import MOST_RECORDS
from crtk_driver_ati_netft.units import Scale
from crtk_drivers.errors import ProtocolError
from crtk_drivers.samples import Vector, vector

LONGEST_PAGE: Final = 262144
"""Bytes of a page at most; real ones have some 5000."""

_LONGEST_NAME: Final = 100
_LARGEST: Final = (1 << 32) - 1
_FEWEST_COUNTS: Final = 100.0
_MOST_COUNTS: Final = float((1 << 31) - 1)
"""Of the load that an axis is rated for."""

_REPORT = "Report it with the page and the firmware of the sensor, or give the scale in the configuration."

_Value = TypeVar("_Value")


@dataclass(frozen=True)
class SensorInfo:
    """What a sensor says of itself. Text is empty, and numbers are None, where it says nothing.

    Attributes:
        scale: of the active configuration.
        rated: the largest load that each axis (6,) is calibrated for, in N and N·m; empty if unknown.
        transform: the tool transform that is active in the sensor: translation in m and rotations in rad;
            empty if unknown.
        bias: the gage values (6,) that the sensor subtracts; empty if unknown.
        filter_code: of the low-pass in the sensor.
        internal_rate: samples per second that it measures; None if it does not say.
        rdt_rate: records per second.
        tags: everything that the page holds.
        problems: what else is wrong with the page, in words; what it concerns counts as unknown.
    """

    scale: Scale
    product: str = ""
    serial: str = ""
    firmware: str = ""
    configuration: str = ""
    calibration_serial: str = ""
    active_configuration: int | None = None
    rated: Vector = field(default_factory=lambda: vector([]))
    transform: Vector = field(default_factory=lambda: vector([]))
    bias: tuple[int, ...] = ()
    filter_code: int | None = None
    internal_rate: int | None = None
    rdt_rate: int | None = None
    rdt_enabled: bool | None = None
    buffer_size: int | None = None
    status: int | None = None
    tags: Mapping[str, str] = field(default_factory=dict, repr=False)
    problems: tuple[str, ...] = ()


def read_sensor(page: bytes, where: str) -> SensorInfo:
    """Return what ``netftapi2.xml`` says.

    Args:
        page: as the sensor sent it.
        where: the page's address, for messages.

    Raises:
        ProtocolError: no such XML, entities in it, too long; or the scale is missing, ambiguous, impossible,
            or in unknown units.
    """
    tags = _Page(page, "netft", where)
    scale = tags.scale("cfg")
    rate_tag = "comrdtrate" if "comrdtrate" in tags.texts else "commrdtrate"
    return SensorInfo(
        scale=scale,
        product=tags.name("prodname"),
        serial=tags.name("mfgdigsn"),
        firmware=tags.name("mfgdigver"),
        configuration=tags.name("cfgnam"),
        calibration_serial=tags.name("cfgcalsn"),
        active_configuration=tags.optional("setcfgsel", _within(0, 15)),
        rated=tags.rated("cfgmr", scale),
        transform=tags.transform(),
        bias=tags.optional("setbias", _wholes) or (),
        filter_code=tags.optional("setuserfilter", _within(0, 255)),
        internal_rate=tags.optional("runrate", _RATE) or tags.optional("setrate", _RATE),
        rdt_rate=tags.optional(rate_tag, _RATE),
        rdt_enabled=tags.optional("comrdte", _switch),
        buffer_size=tags.optional("comrdtbsiz", _within(1, MOST_RECORDS)),
        status=tags.optional("runstat", _within(0, _LARGEST)),
        tags=tags.texts,
        problems=tuple(tags.problems),
    )


@dataclass(frozen=True, slots=True)
class CalibrationInfo:
    """One calibration that a sensor holds; `rated` as in `SensorInfo`."""

    scale: Scale
    serial: str
    part: str
    family: str
    date: str
    rated: Vector


def read_calibration(page: bytes, where: str) -> CalibrationInfo:
    """Return what ``netftcalapi.xml`` says of one calibration.

    Raises:
        ProtocolError: as `read_sensor`.
    """
    tags = _Page(page, "netftCalibration", where)
    scale = tags.scale("cal")
    return CalibrationInfo(
        scale,
        tags.name("calsn"),
        tags.name("calpn"),
        tags.name("calfam"),
        tags.name("caldt"),
        tags.rated("calmr", scale),
    )


def numbers(text: str) -> tuple[float, ...]:
    """Return a list of numbers.

    Raises:
        ValueError: one is no number, or not finite.
    """
    values = tuple(float(part) for part in re.split(r"[;,\s]+", text.strip()) if part)
    if not all(map(math.isfinite, values)):
        raise ValueError("not finite")
    return values


class _Page:
    """The tags of a page with their texts."""

    def __init__(self, page: bytes, root: str, where: str) -> None:
        self.where = where
        self.texts: dict[str, str] = {}
        self.problems: list[str] = []
        self._ambiguous: dict[str, str] = {}
        if len(page) > LONGEST_PAGE:
            raise self._wrong(f"the page is longer than {LONGEST_PAGE} bytes")
        try:
            tree = fromstring(page, forbid_dtd=True)
        except (ParseError, DefusedXmlException, ValueError, LookupError) as error:
            raise self._wrong(f"no usable XML: {type(error).__name__}: {error}") from error
        if tree.tag != root:
            raise self._wrong(f"the page holds <{tree.tag[:40]}>, not <{root}>")
        for element in tree:
            text = (element.text or "").strip()
            if self.texts.setdefault(element.tag, text) != text:
                self._ambiguous[element.tag] = text

    def text(self, tag: str) -> str:
        """Return the first text of a tag, empty without one."""
        return self.texts.get(tag, "")

    def name(self, tag: str) -> str:
        """Return the text of a tag for people: one line, and no long one."""
        return " ".join(self.text(tag).split())[:_LONGEST_NAME]

    def scale(self, prefix: str) -> Scale:
        """Return the scale that the tags with this prefix give."""
        counts = [self._count(f"{prefix}cp{letter}") for letter in "ft"]
        force = self._unit(f"{prefix}fu", units.FORCE)
        torque = self._unit(f"{prefix}tu", units.TORQUE)
        may_begin_with_0 = prefix == "cal" or detect(self.text("prodname")) in (AXIA, SCHUNK)
        self._check_codes(
            {f"{prefix}fu": units.FORCE, f"{prefix}tu": units.TORQUE},
            (0, 1) if may_begin_with_0 else (1,),
        )
        try:
            return Scale(counts[0], counts[1], force, torque)
        except ValueError as error:
            raise self._wrong(f"{prefix}cpf, {prefix}cpt: {error}") from error

    def rated(self, tag: str, scale: Scale) -> Vector:
        """Return the rated load (6,) in N and N·m, empty if unknown."""
        rated = self.optional(tag, _six)
        if rated is None:
            return vector([])
        loads = vector(rated * np.repeat((scale.force, scale.torque), 3))
        least, most = scale.factors * _FEWEST_COUNTS, scale.factors * _MOST_COUNTS
        if not ((loads >= least) & (loads <= most)).all():
            self.problems.append(
                f"{tag} is {self.text(tag)[:60]!r}: less than {_FEWEST_COUNTS:g} counts, or more than "
                "32 bits hold"
            )
            return vector([])
        return loads

    def transform(self) -> Vector:
        """Return the tool transform (6,) in m and rad, empty if unknown."""
        transform = self.optional("cfgtfx", _six)
        if transform is None:
            return vector([])
        try:
            distance = self._unit("cfgtdu", units.LENGTH)
            angle = self._unit("cfgtau", units.ANGLE)
        except ProtocolError as error:
            self.problems.append(error.message)
            return vector([])
        return vector(transform * np.repeat((distance, angle), 3))

    def optional(self, tag: str, convert: Callable[[str], _Value]) -> _Value | None:
        """Return a value that may be missing, or be nonsense."""
        text = self.text(tag)
        if not text:
            return None
        try:
            return convert(text)
        except ValueError as error:
            self.problems.append(f"{tag} is {text[:60]!r}: {str(error)[:100]}")
            return None

    def _count(self, tag: str) -> float:
        text = self._unambiguous(tag)
        if not text:
            raise self._wrong(f"{tag} is missing")
        try:
            (value,) = numbers(text)
        except ValueError as error:
            raise self._wrong(f"{tag} is {text[:60]!r}, no number") from error
        return value

    def _unit(self, tag: str, known: Mapping[str, float]) -> float:
        """Return the factor of a unit, by its name (tag with an s before it) or else by its code."""
        name, code = self._unambiguous(f"s{tag}"), self._unambiguous(tag)
        found = units.factor(known, name) if name else _unit_of_code(known, code)
        if found is None:
            said = repr((name or code)[:60]) if name or code else "missing"
            raise self._wrong(f"the unit {tag} is {said}; known are {', '.join(known)}")
        return found

    def _check_codes(
        self, known: Mapping[str, Mapping[str, float]], firsts: tuple[int, ...]
    ) -> None:
        """Refuse units (tables by their tags) whose codes mean others than their names.

        The codes begin with 1. On the console of the Axia they begin with 0: its pages are taken either way,
        with all of their units in the same.
        """
        wrong: list[str] = []
        for first in firsts:
            wrong = [tag for tag, table in known.items() if self._contradicts(tag, table, first)]
            if not wrong:
                return
        said = " and ".join(
            f"{tag} {self.name(tag)!r}, s{tag} {self.name('s' + tag)!r}" for tag in wrong
        )
        raise self._wrong(f"code and name of a unit contradict each other: {said}")

    def _contradicts(self, tag: str, known: Mapping[str, float], first: int) -> bool:
        by_name = units.factor(known, self.text(f"s{tag}"))
        by_code = _unit_of_code(known, self.text(tag), first)
        return None not in (by_name, by_code) and by_name != by_code

    def _unambiguous(self, tag: str) -> str:
        text = self.text(tag)
        if tag in self._ambiguous:
            other = self._ambiguous[tag]
            raise self._wrong(f"{tag} is there twice: {text[:60]!r} and {other[:60]!r}")
        return text

    def _wrong(self, what: str) -> ProtocolError:
        return ProtocolError(
            f"the sensor's configuration cannot be used: {what}", where=self.where, remedy=_REPORT
        )


def _unit_of_code(known: Mapping[str, float], text: str, first: int = 1) -> float | None:
    if not (text.isdecimal() and len(text) <= 3):
        return None
    return units.factor_of_code(known, int(text) + 1 - first)


def _within(least: int, most: int) -> Callable[[str], int]:
    """Return what makes a whole number, decimal or hexadecimal, of a text."""

    def convert(text: str) -> int:
        if text.lower().startswith("0x"):
            value: float = int(text, 16)
        else:
            (value,) = numbers(text)
        if not least <= value <= most or value != int(value):
            raise ValueError(f"no whole number from {least} to {most}")
        return int(value)

    return convert


_RATE = _within(1, 100_000)


def _wholes(text: str) -> tuple[int, ...]:
    values = numbers(text)
    if not all(abs(value) <= _LARGEST and value == int(value) for value in values):
        raise ValueError("no whole numbers of 32 bits")
    return tuple(int(value) for value in values)


def _switch(text: str) -> bool:
    known = {"enabled": True, "1": True, "disabled": False, "0": False}
    if text.lower() not in known:
        raise ValueError("neither Enabled nor Disabled")
    return known[text.lower()]


def _six(text: str) -> Vector:
    values = vector(numbers(text))
    if values.size != 6:
        raise ValueError(f"{values.size} values, not 6")
    if (np.abs(values) > _LARGEST).any():
        raise ValueError("beyond any sensor")
    return values
