"""The NetFT driver keeps the contract of every device, on a simulated sensor box of each family."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_ati_netft import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.netft import SIM, RunningSim  # noqa: E402
from rigs.netft_bench import FREE_PORTS, LONG, configuration  # noqa: E402 - after the line above

pytestmark = pytest.mark.sweep(4)


@pytest.fixture(scope="module", params=["netbox", "axia", "schunk", "onrobot"])
def box(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """A simulated box and its family; one for all tests."""
    with SIM.spawn(profile=request.param, load="noise:force=0.01", **FREE_PORTS) as sim:
        yield request.param, sim


class TestNetFtWithSim(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, box: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver; an OnRobot sensor cannot be asked what it is."""
        profile, self.sim = box
        named = {"profile": "onrobot"} if profile == "onrobot" else {}
        yield Session(PLUGIN, configuration(self.sim, sample_timeout=1.0, **named))
        self.sim.control.clear()

    def silence(self, session: Session) -> None:
        """Neither its stream nor its page comes any more."""
        self.inject(session, "unplugged")

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("unplugged")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear()
