"""A sensor box: its sensor, its settings, and the one stream that it sends. No sockets."""

from __future__ import annotations

import ipaddress
import logging
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from crtk_sim_backends.netft import rdt
from crtk_sim_backends.netft.config import SimConfig
from crtk_sim_backends.netft.rdt import Address, Request, Stream
from crtk_sim_backends.netft.sensor import Sensor
from crtk_sim_backends.netft.settings import Settings

log = logging.getLogger(__name__)

_TRACE_SIZE: Final = 1000


@dataclass
class Counters:
    """What came and went."""

    requests: int = 0  # RDT
    bad_requests: int = 0
    streams: int = 0
    takeovers: int = 0  # a start while another address had the stream
    records: int = 0
    pages: int = 0
    tcp_requests: int = 0
    boots: int = 0


class Box:
    """One sensor box.

    Args:
        config: options.
        now: monotonic time, s.
    """

    def __init__(self, config: SimConfig, now: float) -> None:
        self.config = config
        self.profile = config.family
        self.settings = Settings(
            self.profile,
            config.sensor,
            config.rdt_rate or self.profile.rates[0],
            config.buffer_size,
            config.internal_rate or self.profile.rates[0],
        )
        self.sensor = Sensor(self.settings, config.acting, now, config.ft_sequence, config.wrong)
        self.stream: Stream | None = None
        self.counters = Counters()
        self.ignores_settings = False
        self._changed = False
        self._number = 0
        self._trace: deque[dict[str, Any]] = deque(maxlen=_TRACE_SIZE)

    def note(self, port: str, sender: str, now: float, values: Mapping[str, Any]) -> None:
        """Keep a request for the trace of the control socket."""
        self._number += 1
        self._trace.append(
            {
                "number": self._number,
                "time_ns": int(now * 1e9),
                "connection": sender,
                "recipe": port,
                "values": dict(values),
            }
        )

    def trace(self, after: int) -> list[dict[str, Any]]:
        """Return the newest requests behind the one with a number."""
        return [entry for entry in self._trace if entry["number"] > after]

    def changed(self) -> None:
        """Note that measurements made from now on are other ones."""
        self._changed = True

    def settle(self, now: float) -> None:
        """Let noted changes take effect."""
        if not self._changed:
            return
        self._changed = False
        self.sensor.change(now)
        if self.stream is not None:
            self.stream.set_divisor(self.settings.divisor)

    # What it is asked for

    def set_bias(self, now: float) -> None:
        """Let the present load be the bias."""
        self.sensor.set_bias(now)
        self.changed()

    def enable_conditions(self, bits: int) -> None:
        """Enable exactly those monitor conditions whose bits are set."""
        for n, condition in enumerate(self.settings.conditions):
            condition.enabled = bits >> n & 1
        self.settings.conditions_enabled = 1
        self.changed()

    def write_page(self, page: str, pairs: Iterable[tuple[str, str]]) -> bool:
        """Set what a CGI page was called with; False when there is no such page."""
        if self.ignores_settings:
            return self.settings.write(page, ())
        self.changed()
        return self.settings.write(page, pairs)

    # The stream

    def request(self, data: bytes, sender: Address, now: float) -> None:
        """Do what a datagram to the RDT port asks for. Nothing is ever answered."""
        found = rdt.decode(data)
        self.counters.requests += 1
        name = f"{sender[0]}:{sender[1]}"
        if found is None or not self.settings.rdt_enabled:
            self.counters.bad_requests += 1
            self.note("rdt", name, now, {"data": data[:32].hex()})
            return
        self.note("rdt", name, now, {"command": found.command, "count": found.count})
        profile = self.profile
        if found.command in profile.single:
            self._start(found, sender, 1, now)
        elif found.command in profile.buffered:
            self._start(found, sender, self.settings.buffer_size, now)
        elif found.command == rdt.STOP:
            self.stream = None
        elif found.command == rdt.BIAS:
            self._bias(found.count, now)
        elif found.command == rdt.CLEAR_LATCH and profile.clears_latch:
            self.sensor.clear_latch(now)
        elif found.command == profile.filter_command:
            self.settings.set_filter(found.count)
            self.changed()
        elif found.command == profile.period_command and found.count:
            self.settings.wanted_rate = max(1, self.settings.internal_rate // found.count)
            self.changed()
        else:
            self.counters.bad_requests += 1

    def _start(self, request: Request, sender: Address, size: int, now: float) -> None:
        to = sender
        if request.to is not None:
            if not self.profile.extended or not _near(request.to):
                log.warning("a stream to %s is not sent: only loopback addresses", request.to)
                self.counters.bad_requests += 1
                return
            to = request.to
        if self.stream is not None and self.stream.to != to:
            self.counters.takeovers += 1
        self.counters.streams += 1
        first = self.sensor.clock.index_at(now) + 1
        self.stream = Stream(to, request.count, size, first, self.settings.divisor)

    def _bias(self, count: int, now: float) -> None:
        if self.profile.bias_by_count and count != rdt.BIAS_SET:
            self.settings.bias[:] = 0.0
            self.changed()
        else:
            self.set_bias(now)
        if self.config.bias == "stops":
            self.stream = None

    def datagrams(self, now: float) -> list[bytes]:
        """Measure up to now, and return what the stream has to send."""
        sensor = self.sensor
        end = sensor.clock.index_at(now) + 1
        found: list[bytes] = []
        while True:
            if self.stream is not None:
                found += self._take(self.stream, end)
            if end <= sensor.block.end:
                return found
            sensor.next_block()

    def _take(self, stream: Stream, end: int) -> list[bytes]:
        before = stream.sent
        found = stream.take(self.sensor.block, end)
        self.counters.records += stream.sent - before
        if stream.ended:
            self.stream = None
        return found

    # What happens to it

    def restart_stream(self, sequence: int) -> None:
        """Go on with another rdt_sequence."""
        if self.stream is not None:
            self.stream.jump(sequence)

    def power_up(self, now: float, scale: float) -> None:
        """Begin anew after a loss of power, at a time; counts per unit are multiplied with `scale`."""
        self.counters.boots += 1
        self.stream = None
        self.settings.scale_factor *= scale
        self.sensor.power_up(now)
        self._changed = False


def _near(address: Address) -> bool:
    return ipaddress.IPv4Address(address[0]).is_loopback and address[1] > 0
