"""How a sensor is reached: what it is, what a count is worth, its settings, and then its stream."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from crtk_driver_ati_netft import settings
from crtk_driver_ati_netft.calibration import SensorInfo
from crtk_driver_ati_netft.config import NetFtConfig
from crtk_driver_ati_netft.profiles import PROFILES, Mode, Profile, detect
from crtk_driver_ati_netft.settings import SensorSettings
from crtk_driver_ati_netft.source import Source
from crtk_driver_ati_netft.stream import RdtStream
from crtk_driver_ati_netft.tcp49151 import TcpChannel
from crtk_driver_ati_netft.tcp_stream import TcpStream
from crtk_driver_ati_netft.units import Scale
from crtk_driver_ati_netft.web import NoSuchPage, WebPages
from crtk_drivers.errors import ConfigError, ConnectionFailed, DeviceError
from crtk_drivers.samples import vector

logger = logging.getLogger(__name__)

_UDP_SHARE = 0.5
"""Of the time for the connection, before TCP is tried."""


@dataclass(frozen=True)
class Connection:
    """A sensor that is connected and streams.

    Attributes:
        info: what it says of itself, with the scale that counts.
        page: the same as its web page has it; None if that was not read.
        profile: its family.
        source: of its measurements.
    """

    info: SensorInfo
    page: SensorInfo | None
    profile: Profile
    source: Source


@dataclass(frozen=True)
class Connector:
    """Reaches a sensor.

    Attributes:
        config: of the device.
        web: its web server.
        tell: called with each source before it is opened, so that it can be aborted.
    """

    config: NetFtConfig
    web: WebPages
    tell: Callable[[Source], None]

    def connect(self, before: Source | None, known: Profile, deadline: float) -> Connection:
        """Return a sensor that streams.

        Args:
            before: source of the connection before, whose counters go on; None if there was none.
            known: the family as it was known before, for a sensor that does not say what it is.
            deadline: monotonic.

        Raises:
            ConnectionFailed: not in time.
            ProtocolError: what it says of itself cannot be used.
        """
        config, web = self.config, self.web
        info = identify(config, web, deadline)
        profile = PROFILES.get(config.profile) or (detect(info.product) if info.product else known)
        if config.profile == "auto" and not info.product:
            info = _with_problem(
                info,
                f"the sensor does not say what it is, and counts as {profile.name}: give `profile`",
            )
        page = None
        if config.http and profile.has_web and info.tags:
            page = info = settings.apply(web, info, profile, wanted_settings(config), deadline)
            if config.scale is not None:
                info = replace(info, scale=config.scale.scale)
        return Connection(info, page, profile, self._open(profile, info, before, deadline))

    def _open(
        self, profile: Profile, info: SensorInfo, before: Source | None, deadline: float
    ) -> Source:
        config = self.config
        if config.transport == "tcp":
            return self._open_tcp(before, deadline)
        left = deadline - time.monotonic()
        share = _UDP_SHARE if config.transport == "auto" else 1.0
        try:
            if info.rdt_enabled is False:
                raise ConnectionFailed(
                    "RDT is switched off in the sensor",
                    where=f"RDT {config.host}:{config.rdt_port}",
                    remedy="Switch it on at the sensor's web page (Communications).",
                )
            return self._open_udp(profile, info, before, time.monotonic() + left * share)
        except ConnectionFailed as error:
            if config.transport == "udp":
                raise
            try:
                source = self._open_tcp(before, deadline)
            except DeviceError as second:
                raise ConnectionFailed(
                    f"{error.message}; over TCP: {second.message}",
                    where=error.where,
                    remedy=error.remedy,
                ) from second
            logger.warning("%s; measuring over TCP instead, with 16 bits", error.statement)
            return source

    def _open_udp(
        self, profile: Profile, info: SensorInfo, before: Source | None, deadline: float
    ) -> RdtStream:
        config = self.config
        if isinstance(before, RdtStream) and before.profile is profile:
            stream = before
        else:
            stream = RdtStream(
                config.host,
                profile,
                info.scale.factors,
                port=config.rdt_port,
                mode=Mode(config.mode),
                receive_buffer=config.receive_buffer,
            )
        by_rdt = profile.period_by_rdt is not None and config.sensor.rdt_rate
        stream.expect_rate(float(by_rdt or info.rdt_rate or min(profile.rate, 1000)))
        stream.factors = info.scale.factors
        stream.tracker.rate = float(info.internal_rate or profile.rate)
        self.tell(stream)
        stream.open(deadline)
        sent = {profile.filter_by_rdt: config.sensor.filter_code}
        if config.sensor.rdt_rate is not None:
            sent[profile.period_by_rdt] = max(1, round(1000.0 / config.sensor.rdt_rate))
        for command, value in sent.items():
            if command is not None and value is not None:
                stream.send_value(command, value)
                stream.resume()
        return stream

    def _open_tcp(self, before: Source | None, deadline: float) -> TcpStream:
        config = self.config
        tcp = (
            before
            if isinstance(before, TcpStream)
            else TcpStream(config.host, config.tcp_port, config.page_period)
        )
        self.tell(tcp)
        tcp.open(deadline)
        return tcp


def _with_problem(info: SensorInfo, problem: str) -> SensorInfo:
    return replace(info, problems=(*info.problems, problem))


def identify(config: NetFtConfig, web: WebPages, deadline: float) -> SensorInfo:
    """Return what the sensor says of itself, or as much as the configuration says of it.

    Raises:
        ConnectionFailed: it says nothing, and the configuration not what a count is worth.
        ProtocolError: what it says cannot be used.
    """
    typed = config.scale.scale if config.scale is not None else None
    profile = PROFILES.get(config.profile)
    if typed is None and profile is not None and profile.counts is not None:
        typed = Scale(*profile.counts)
    if not config.http or (profile is not None and not profile.has_web):
        if typed is None:
            raise ConfigError("scale: is needed when http is false", where=web.host)
        return SensorInfo(typed)
    try:
        return web.read(deadline)
    except DeviceError as error:
        if typed is not None:
            logger.warning("%s; going on with the scale of the configuration", error.statement)
            return SensorInfo(typed, problems=(error.message,))
        if not isinstance(error, ConnectionFailed | NoSuchPage):
            raise
        return _ask_over_tcp(config, error, deadline)


def _ask_over_tcp(config: NetFtConfig, refusal: DeviceError, deadline: float) -> SensorInfo:
    """Return the scale that the TCP channel tells, for a sensor whose web page is off or not there."""
    channel = TcpChannel(config.host, config.tcp_port)
    until = min(deadline, time.monotonic() + config.http_timeout)
    try:
        channel.open(until)
        scale = channel.calibration(until).scale
    except DeviceError as error:
        raise ConnectionFailed(
            f"{refusal.message}; over TCP: {error.message}",
            where=refusal.where,
            remedy="Check the address and that the sensor is on; or give `scale` and set http to false.",
        ) from error
    finally:
        channel.close()
    logger.warning("%s; the scale was read over TCP", refusal.statement)
    return SensorInfo(scale, problems=(refusal.message,))


def wanted_settings(config: NetFtConfig) -> SensorSettings:
    """Return the settings of the sensor that a configuration asks for."""
    sensor = config.sensor
    transform = sensor.tool_transform
    return SensorSettings(
        configuration=sensor.configuration,
        internal_rate=sensor.internal_rate,
        rdt_rate=sensor.rdt_rate,
        filter_code=sensor.filter_code,
        buffer_size=sensor.buffer_size,
        tool_transform=None if transform is None else vector(transform),
    )
