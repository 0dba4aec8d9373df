"""The driver keeps the contract of every device, as pedals and as a mouse."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_inputs import PLUGIN  # noqa: E402
from crtk_driver_inputs.config import InputsConfig  # noqa: E402
from crtk_drivers.config import from_values, load  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.inputs import SIM, RunningSim  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.sweep(2)


@pytest.fixture(scope="module", params=["evdev", "spacenavd"])
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[str, RunningSim]]:
    """What is simulated, and how it is reached; one for all tests."""
    with SIM.spawn() as sim:
        yield request.param, sim


class TestInputs(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, simulated: tuple[str, RunningSim]) -> Iterator[Session]:
        """Its driver."""
        link, self.sim = simulated
        values = {"link": link, "pedals": {"clutch": 30}, "sample_timeout": 1.0}
        yield Session(PLUGIN, PLUGIN.sim_config(load(InputsConfig, from_values(values)), self.sim))
        self.sim.control.clear()

    def silence(self, session: Session) -> None:
        """Nothing comes where nothing is pressed."""
        pytest.skip("a silent input device is not lost")

    def break_link(self, session: Session) -> None:
        """It is unplugged."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("disconnect")
