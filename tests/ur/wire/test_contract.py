"""The UR driver keeps the contract of every device, on e-Series and CB3, by ur-rtde and by our program."""

from collections.abc import Iterator
from functools import partial

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_ur import PLUGIN  # noqa: E402
from crtk_drivers.config import from_values, load  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.ur import RunningSim  # noqa: E402
from rigs.ur_bench import LONG, PATIENT, brisk_sim, lenient  # noqa: E402 - after the line above
from rigs.ur_watchdog import rarely_fed  # noqa: E402
from rigs.waiting import eventually  # noqa: E402

pytestmark = pytest.mark.sweep(4)

STOPPED = 1
"""Value of `runtime_state`."""


@pytest.fixture(
    scope="module",
    params=[("ur5e", "ur_rtde"), ("ur5", "ur_rtde"), ("ur5e", "native"), ("ur5", "native")],
    ids="-".join,
)
def controller(request) -> Iterator[tuple[str, str, RunningSim]]:
    """A simulated controller, the model of its arm, and the way to it; one for all tests."""
    model, control = request.param
    with brisk_sim(model=model) as sim:
        yield model, control, sim


class TestUr(DeviceContract):
    timeout = LONG

    @pytest.fixture
    def session(self, controller) -> Iterator[Session]:
        model, control, self.sim = controller
        own_rate = {**PATIENT, "frequency": None}
        values = {**own_rate, "model": model, "control": control, "host": self.sim.host}
        with lenient(), rarely_fed():
            yield Session(PLUGIN, load(PLUGIN.config, from_values(values)))
        self.sim.control.clear()

    def prepare(self, session) -> None:
        """After a lost link the controller's watchdog ends the program that was left."""
        outputs = partial(self.sim.control.outputs, "runtime_state")
        eventually(lambda: outputs()["runtime_state"] == STOPPED, "no program runs")

    def break_link(self, session) -> None:
        self.sim.control.inject("disconnect", port="rtde", duration=600.0)

    def mend_link(self, session) -> None:
        self.sim.control.clear()
