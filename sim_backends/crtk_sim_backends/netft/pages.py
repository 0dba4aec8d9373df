"""The web pages of a box, ``netftapi2.xml`` and ``netftcalapi.xml``: values in, text out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final
from xml.sax.saxutils import escape

from crtk_sim_backends.netft import units
from crtk_sim_backends.netft.box import Box
from crtk_sim_backends.netft.settings import CONFIGURATIONS

_HEAD: Final = '<?xml version="1.0" encoding="UTF-8"?>\n'
_SWITCH: Final = ("Disabled", "Enabled")
_CALIBRATION_DATE: Final = "2026/01/15"

Tags = list[tuple[str, object]]


def sensor_page(box: Box, index: int | None, host: str, now: float) -> str:
    """Return ``netftapi2.xml``, of the active configuration or of the one with an index."""
    index = box.settings.active if index is None else min(max(index, 0), CONFIGURATIONS - 1)
    tags = [
        *_running(box, now),
        *_set(box),
        *_conditions(box),
        *_configuration(box, index),
        *_network(box, host),
    ]
    return _document("netft", tags)


def calibration_page(box: Box) -> str:
    """Return ``netftcalapi.xml``; a box has one calibration, which every index gives."""
    preset = box.settings.preset
    return _document(
        "netftCalibration",
        [
            ("calsn", preset.serial),
            ("calpn", preset.part),
            ("calfam", "Net"),
            ("caldt", _CALIBRATION_DATE),
            ("calfu", units.code_of(units.FORCE, preset.force_unit)),
            ("scalfu", preset.force_unit),
            ("caltu", units.code_of(units.TORQUE, preset.torque_unit)),
            ("scaltu", preset.torque_unit),
            ("calmr", _joined(preset.rated)),
            ("calcpf", preset.counts_per_force),
            ("calcpt", preset.counts_per_torque),
        ],
    )


def with_tags(page: str, tags: Mapping[str, str]) -> str:
    """Return a page in which these tags have these texts, whatever is wrong with them."""
    for tag, text in tags.items():
        line = f"<{tag}>{escape(text)}</{tag}>\n"
        before, there, rest = page.partition(f"<{tag}>")
        if there:
            page = before + line + rest.partition(f"</{tag}>\n")[2]
        else:
            head, end, tail = page.rpartition("</")
            page = head + line + end + tail
    return page


def form_page(title: str) -> str:
    """Return what a CGI page answers with: a page for people."""
    return f"<html><head><title>{escape(title)}</title></head><body><h1>{escape(title)}</h1></body></html>"


def _running(box: Box, now: float) -> Tags:
    newest = box.sensor.measurement(now)
    settings = box.settings
    gages = newest.smooth / settings.rated * 20_000
    output = 0
    for n, condition in enumerate(settings.conditions):
        output |= condition.output if newest.breached >> n & 1 else 0
    return [
        ("runstat", f"0x{newest.status:08x}"),
        ("runft", _joined(newest.counts)),
        ("runpkmx", _joined(box.sensor.peaks[0].tolist())),
        ("runpkmn", _joined(box.sensor.peaks[1].tolist())),
        ("runsg", _joined(gages.round().astype(int).tolist())),
        ("runmcb", f"0x{newest.breached:08x}"),
        ("runmco", f"0x{output:02x}"),
        ("runmcl", int(newest.latched != 0)),
        ("runrate", settings.internal_rate),
    ]


def _set(box: Box) -> Tags:
    settings = box.settings
    tags: Tags = [
        ("setcfgsel", settings.active),
        ("setuserfilter", settings.filter_code),
        ("setpke", _SWITCH[settings.peaks_enabled]),
        ("setbias", _joined(settings.gages)),
        ("setmce", _SWITCH[settings.conditions_enabled]),
    ]
    if box.profile.adc_codes:
        code = box.profile.adc_codes[settings.internal_rate]
        tags += [("setrate", code), ("setiirshift", settings.filter_code)]
    return tags


def _conditions(box: Box) -> Tags:
    conditions = box.settings.conditions
    return [
        ("mce", _joined(c.enabled for c in conditions)),
        ("mcx", _joined(c.axis for c in conditions)),
        ("mcc", _joined(c.compare for c in conditions)),
        ("mcv", _joined(c.value for c in conditions)),
        ("mco", _joined(f"0x{c.output:02x}" for c in conditions)),
    ]


def _configuration(box: Box, index: int) -> Tags:
    settings = box.settings
    shown = settings.configurations[index]
    rated = settings.rated / settings.unit_factors(shown)
    per_force, per_torque = settings.counts_per_unit(shown)
    return [
        ("cfgnam", shown.name),
        ("cfgcalsel", shown.calibration),
        ("cfgcalsn", settings.preset.serial),
        ("cfgfu", shown.force_unit),
        ("scfgfu", units.FORCE[shown.force_unit].name),
        ("cfgtu", shown.torque_unit),
        ("scfgtu", units.TORQUE[shown.torque_unit].name),
        ("cfgcpf", per_force),
        ("cfgcpt", per_torque),
        ("cfgmr", _joined(f"{value:.6g}" for value in rated)),
        ("cfgtdu", shown.distance_unit),
        ("scfgtdu", units.DISTANCE[shown.distance_unit].name),
        ("cfgtau", shown.angle_unit),
        ("scfgtau", units.ANGLE[shown.angle_unit].name),
        ("cfgtfx", _joined(f"{value:.6g}" for value in shown.transform)),
        ("cfgusra", shown.text_a),
        ("cfgusrb", shown.text_b),
    ]


def _network(box: Box, host: str) -> Tags:
    settings = box.settings
    network = settings.network
    return [
        ("comnetdhcp", _SWITCH[network["dhcp"] == "1"]),
        ("comnetip", network["ip"] or host),
        ("comnetmsk", network["msk"]),
        ("comnetgw", network["gw"]),
        ("comrdte", _SWITCH[settings.rdt_enabled]),
        ("comrdtrate", settings.rdt_rate),
        ("comrdtbsiz", settings.buffer_size),
        ("comrdtmsyn", settings.multi_unit),
        ("comeipe", _SWITCH[settings.ethernet_ip]),
        ("nethwaddr", "00:16:BD:00:00:01"),
        ("netip", host),
        ("mfgdigsn", box.config.serial),
        ("mfgdigver", box.profile.firmware),
        ("prodname", box.profile.product),
    ]


def _joined(values: Iterable[Any]) -> str:
    return ";".join(map(str, values))


def _document(root: str, tags: Sequence[tuple[str, object]]) -> str:
    lines = "".join(f"<{tag}>{escape(str(value))}</{tag}>\n" for tag, value in tags)
    return f"{_HEAD}<{root}>\n{lines}</{root}>\n"
