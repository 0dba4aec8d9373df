"""The UR driver keeps the contract of every device, on an e-Series and on a CB3 arm."""

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from ur_bench import LONG, PATIENT, lenient  # noqa: E402 - after the line above

from crtk_driver_ur import PLUGIN  # noqa: E402
from crtk_drivers.config import from_values, load  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.ur import SIM, RunningSim  # noqa: E402


@pytest.fixture(scope="module", params=["ur5e", "ur5"])
def controller(request) -> Iterator[tuple[str, RunningSim]]:
    """A simulated controller and the model of its arm; one for all tests."""
    with SIM.spawn(model=request.param) as sim:
        yield request.param, sim


class TestUr(DeviceContract):
    timeout = LONG

    @pytest.fixture
    def session(self, controller) -> Iterator[Session]:
        model, self.sim = controller
        values = {**PATIENT, "model": model, "host": self.sim.host}
        with lenient():
            yield Session(PLUGIN, load(PLUGIN.config, from_values(values)))
        self.sim.control.clear()

    def break_link(self, session) -> None:
        self.sim.control.inject("disconnect", port="rtde", duration=600.0)

    def mend_link(self, session) -> None:
        self.sim.control.clear()
