"""The driver keeps the contract of every device."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_openhaptics import PLUGIN  # noqa: E402
from crtk_driver_openhaptics.config import OpenHapticsConfig  # noqa: E402
from crtk_drivers.config import from_values, load  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.openhaptics import SIM, RunningSim  # noqa: E402
from rigs.haptic_bench import PATIENT, needs_compiler  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = [needs_compiler, pytest.mark.slow]


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    """One for all tests."""
    with SIM.spawn() as running:
        yield running


class TestOpenHaptics(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, sim: RunningSim) -> Iterator[Session]:
        """Its driver."""
        self.sim = sim
        config = load(OpenHapticsConfig, from_values({**PATIENT, "force_timeout": 0.3}))
        yield Session(PLUGIN, PLUGIN.sim_config(config, sim))
        sim.control.clear()

    def break_link(self, session: Session) -> None:
        """It is unplugged."""
        self.sim.control.inject("unplugged")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("unplugged")
