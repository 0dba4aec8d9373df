"""The driver keeps the contract of every device, with each kind of grip and at an older service."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_haply import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.haply import RunningSim  # noqa: E402
from rigs.haply_bench import configuration, simulated  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(3)


@pytest.fixture(
    scope="module", params=[("3.5", "wireless"), ("3.0", "wired"), ("3.5", "none")], ids=str
)
def service(request: pytest.FixtureRequest) -> Iterator[tuple[RunningSim, bool]]:
    """A simulated service, and whether it has a grip; one for all tests."""
    version, grip = request.param
    with simulated(version=version, grip=grip) as sim:
        yield sim, grip != "none"


class TestHaply(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, service: tuple[RunningSim, bool]) -> Iterator[Session]:
        """Its driver."""
        self.sim, has_grip = service
        yield Session(PLUGIN, configuration(self.sim, grip=has_grip))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The service ends."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It runs again."""
        self.sim.control.clear("disconnect")
