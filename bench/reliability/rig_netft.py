"""ATI NetFT: a simulated Net Box. Nothing of it moves; what counts is what is told of the load."""

from __future__ import annotations

from typing_extensions import override

from bench.reliability.common import UNMOVED, UnmovedRig, frozen
from bench.reliability.table import Absent, Follows, Way
from crtk_driver_ati_netft import PLUGIN
from crtk_sim_backends.netft import SIM

SAMPLES = 1.0
"""`sample_timeout` of tests, s."""
RDT = {"port": "rdt"}


def _through(fault: str, name: str, kind: str, **parameters: object) -> Way:
    return Way(fault, name, Follows.GOES_ON, kind, parameters)


WAYS = (
    Way("F1", "the RDT port is closed", kind="closed", parameters=RDT, within=SAMPLES),
    Way("F2", "the cable is out", kind="unplugged", within=SAMPLES),
    Way("F2", "the box hangs", kind="stall", within=SAMPLES),
    *frozen(within=SAMPLES),
    Way("F3", "the cable is out", Follows.STARTS_LATER, "unplugged", within=3.0),
    _through("F5", "every 10th datagram is cut", "short", every=10),
    _through("F5", "every 10th datagram is too long", "long", every=10),
    _through("F5", "a stranger sends records as well", "foreign", every=1),
    _through("F8", "every 10th datagram is lost", "loss", every=10),
    _through("F8", "every 10th datagram comes twice", "duplicate", every=10),
    _through("F8", "every 10th datagram is overtaken", "late", every=10),
    _through("F9", "the stream goes on with another sequence", "restart"),
    Way("F9", "the box boots", kind="reboot", parameters={"seconds": 1.5}, within=SAMPLES),
    Way("F12", "status: temperature out of range", kind="status", parameters={"bits": 0x80000004}),
    *UNMOVED,
    _through("F20", "another client takes the stream", "takeover"),
)

ABSENT = (
    Absent("F4", "a datagram arrives whole or not at all"),
    Absent("F6", "one record has all axes"),
    Absent("F7", "no adapter"),
    Absent("F10", "no CAN"),
    Absent("F11", "no heartbeat but the records, F2"),
    Absent("F13", "no safety system"),
    Absent("F14", "nobody else can take control: nothing is controlled"),
    Absent("F15", "takes no commands that move"),
    Absent("F16", "nothing moves, so nothing has to be stopped"),
)


_PATIENT = {"sample_timeout": SAMPLES, "open_timeout": 3.0}


class NetFtRig(UnmovedRig):
    """The sensor."""

    name = "ati-netft"
    plugin = PLUGIN
    simulator = SIM
    sim_options = {"rdt_port": 0, "tcp_port": 0, "http_port": 0}  # noqa: RUF012
    ways = WAYS
    absent = ABSENT
    values = _PATIENT

    @override
    def ready(self) -> None:
        super().ready()
        if not self._has_datagrams:
            # While RDT was closed the driver has changed to TCP, which has none of these faults.
            self.reopen()
            super().ready()

    @property
    def _has_datagrams(self) -> bool:
        return "receive_buffer" in self.disturbed.counters
