"""Settings of the sensor itself: written only where they differ, and read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.profiles import Profile, reachable_rate
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.errors import ProtocolError
from crtk_drivers.samples import Vector

NO_BIAS = (0,) * 6


@dataclass(frozen=True)
class SensorSettings:
    """What the sensor is to be set to; None leaves it as it is.

    Attributes:
        configuration: the active one, 0 to 15.
        internal_rate: measurements per second, of those that the family has.
        rdt_rate: records per second; the sensor takes the next fraction of its internal rate above it.
        filter_code: of its low-pass, see `crtk_driver_ati_netft.profiles.Profile.filters`.
        buffer_size: records in one datagram of the buffered mode.
        tool_transform: translation in m and rotations in rad (6,) of the active configuration.
    """

    configuration: int | None = None
    internal_rate: int | None = None
    rdt_rate: int | None = None
    filter_code: int | None = None
    buffer_size: int | None = None
    tool_transform: Vector | None = None


@dataclass(frozen=True)
class _Setting:
    """How one setting is written and what it must read afterwards."""

    name: str
    page: str
    variables: Callable[[Any, SensorInfo, Profile], list[tuple[str, object]]]
    present: Callable[[SensorInfo], Any]
    expected: Callable[[Any, SensorInfo], Any] = lambda wanted, info: wanted
    tolerance: float = 1e-5


def _transform_variables(
    wanted: Vector, info: SensorInfo, profile: Profile
) -> list[tuple[str, object]]:
    values = wanted * np.repeat((1000.0, 180.0 / np.pi), 3)
    rows = [(f"cfgtfx{i}", f"{value:.6g}") for i, value in enumerate(values.tolist())]
    return [("cfgid", info.active_configuration or 0), ("cfgtdu", 3), ("cfgtau", 1), *rows]


_SETTINGS = (
    _Setting(
        "configuration",
        "setting.cgi",
        lambda wanted, info, profile: [("setcfgsel", wanted)],
        lambda info: info.active_configuration,
    ),
    _Setting(
        "internal_rate",
        "setting.cgi",
        lambda wanted, info, profile: [("setadcrate", profile.adc_rates.get(wanted, wanted))],
        lambda info: info.internal_rate,
        tolerance=0.02,  # some say the nominal rate, some the real one
    ),
    _Setting(
        "rdt_rate",
        "comm.cgi",
        lambda wanted, info, profile: [("comrdtrate", wanted)],
        lambda info: info.rdt_rate,
        lambda wanted, info: reachable_rate(wanted, info.internal_rate or wanted),
    ),
    _Setting(
        "filter_code",
        "setting.cgi",
        lambda wanted, info, profile: [("setuserfilter", wanted)],
        lambda info: info.filter_code,
    ),
    _Setting(
        "buffer_size",
        "comm.cgi",
        lambda wanted, info, profile: [("comrdtbsiz", wanted)],
        lambda info: info.buffer_size,
    ),
    _Setting(
        "tool_transform",
        "config.cgi",
        _transform_variables,
        lambda info: info.transform,
    ),
)


def apply(
    web: WebPages,
    info: SensorInfo,
    profile: Profile,
    wanted: SensorSettings,
    deadline: float | None = None,
) -> SensorInfo:
    """Write what differs, in an order in which each setting keeps its meaning, and read it back.

    Nothing may be streaming meanwhile: a change of rate disturbs the stream.

    Args:
        web: the sensor's server.
        info: as read last.
        profile: the sensor's family.
        wanted: the settings.
        deadline: monotonic.

    Returns:
        what the sensor says afterwards.

    Raises:
        ProtocolError: the sensor has something else afterwards; it clamps and rounds without a word.
        ConnectionFailed: no answer.
    """
    for setting in _SETTINGS:
        value = getattr(wanted, setting.name)
        if value is None or _is_set(setting, value, info):
            continue
        web.write(setting.page, setting.variables(value, info, profile), deadline)
        info = web.read(deadline)
        if not _is_set(setting, value, info):
            raise ProtocolError(
                f"{setting.name} was set to {value}, and the sensor has {setting.present(info)}",
                where=web.where,
                remedy="Give a value that this sensor has, or none.",
            )
    return info


def remove_bias(web: WebPages, deadline: float | None = None) -> SensorInfo:
    """Set the bias of all six gages to zero, in one request, and return what the sensor says afterwards.

    Raises:
        ProtocolError: it is not zero afterwards.
        ConnectionFailed: no answer.
    """
    web.write("setting.cgi", [(f"setbias{i}", 0) for i in range(6)], deadline)
    info = web.read(deadline)
    if info.bias and info.bias != NO_BIAS:
        raise ProtocolError(
            f"the bias of the gages is {info.bias} after it was set to zero",
            where=web.where,
            remedy="Set it on the sensor's web page (Settings).",
        )
    return info


def _is_set(setting: _Setting, wanted: Any, info: SensorInfo) -> bool:
    present, expected = setting.present(info), setting.expected(wanted, info)
    if present is None:
        return False
    a, b = np.atleast_1d(present), np.atleast_1d(expected)
    return a.shape == b.shape and bool(np.allclose(a, b, rtol=setting.tolerance, atol=1e-6))
