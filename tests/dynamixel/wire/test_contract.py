"""The Dynamixel driver keeps the contract of every device: a whole arm, and the gripper on its chain."""

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_dynamixel import PLUGIN  # noqa: E402
from crtk_drivers.front import LocalDevice  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.dynamixel import RunningSim  # noqa: E402
from rigs.dynamixel_bench import (  # noqa: E402 - after the line above
    LONG,
    WEIGHTLESS,
    arm_values,
    configuration,
    lenient,
    place,
    set_upright,
    sim_for,
)

pytestmark = pytest.mark.sweep(2)

BENT = {2: -0.2, 3: 0.4, 5: 0.6}
"""Angles of servos at which the arm is far from its singularities."""


@pytest.fixture(scope="module")
def servos() -> Iterator[RunningSim]:
    """Simulated servos of an arm; the same for all tests."""
    with sim_for(arm_values(), servos=WEIGHTLESS) as sim:
        yield sim


class TestArm(DeviceContract):
    timeout = LONG

    @pytest.fixture
    def session(self, servos: RunningSim) -> Iterator[Session]:
        self.sim = servos
        set_upright(servos)
        for id, angle in BENT.items():
            place(servos, id, angle)
        with lenient():
            yield Session(PLUGIN, configuration(servos, arm_values()))

    def break_link(self, session: Session) -> None:
        self.sim.control.inject("unplug")

    def mend_link(self, session: Session) -> None:
        self.sim.control.clear()


class TestGripper(TestArm):
    """The child: the same suite over its own state and commands."""

    @pytest.fixture
    def arm(self, session: Session) -> Iterator[LocalDevice]:
        whole = LocalDevice(session)
        try:
            session.start()
            engine = session.children["gripper"]
            self.until(lambda: engine.connected and engine.has_sample, "connect")
            yield whole.gripper
        finally:
            whole.close()
