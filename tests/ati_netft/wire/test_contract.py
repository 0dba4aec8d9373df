"""What every device must do, of a sensor: the public contract, over real datagrams."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_ati_netft import PLUGIN  # noqa: E402
from crtk_driver_ati_netft.config import NetFtConfig  # noqa: E402
from crtk_drivers.config import from_values, load  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from rigs.netft_peer import Peer  # noqa: E402 - after the line above


class TestNetFt(DeviceContract):
    """Everything that any device must do."""

    timeout = 20.0

    @pytest.fixture
    def peer(self) -> Iterator[Peer]:
        """A sensor that measures nothing."""
        with Peer() as peer:
            peer.rate = 1000.0
            self._peer = peer
            yield peer

    @pytest.fixture
    def session(self, peer) -> Session:
        """Its driver."""
        values = {
            "host": peer.host,
            "rdt_port": peer.port,
            "http": False,
            "profile": "netbox",
            "transport": "udp",
            "scale": {"counts_per_force": 1e6, "counts_per_torque": 1e6},
            "sample_timeout": 1.0,
        }
        return Session(PLUGIN, load(NetFtConfig, from_values(values)))

    def break_link(self, session: Session) -> None:
        """The sensor is unplugged."""
        self._peer.rate = 0.0

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self._peer.rate = 1000.0
