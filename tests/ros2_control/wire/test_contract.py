"""The driver keeps the contract of every device: by forward controllers, and by trajectories alone."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_ros2_control import PLUGIN  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.process import RunningSim  # noqa: E402
from crtk_sim_backends.ros2_control import SIM  # noqa: E402
from crtk_sim_backends.ros2_control.description import urdf_of  # noqa: E402
from crtk_sim_backends.ros2_control.joints import JointLimits  # noqa: E402
from crtk_sim_backends.ros2_control.robot import START  # noqa: E402
from rigs.ros2_control_bench import TRAJECTORY, configuration  # noqa: E402
from rigs.waiting import LONG  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def robot() -> Iterator[RunningSim]:
    """A simulated robot; one for all tests."""
    with SIM.spawn() as sim:
        yield sim


@pytest.fixture
def sim(robot: RunningSim) -> RunningSim:
    """The robot at its start: where goals of tests lead to, its wrist is near a singularity."""
    robot.control.call("place", positions=START)
    return robot


@pytest.fixture(scope="module")
def urdf(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its description as a file."""
    path = tmp_path_factory.mktemp("description") / "robot.urdf"
    path.write_text(urdf_of(tuple(JointLimits(f"joint_{n}") for n in range(1, 7))))
    return path


class _Robot(DeviceContract):
    timeout = LONG
    tolerance = 0.01
    still = 0.01

    def values(self, urdf: Path) -> dict[str, Any]:
        """Return what is configured."""
        return {}

    @pytest.fixture
    def session(self, sim: RunningSim, urdf: Path) -> Iterator[Session]:
        """Its driver."""
        self.sim = sim
        yield Session(PLUGIN, configuration(sim, **self.values(urdf)))
        sim.control.clear()
        sim.control.inject("all_inactive")  # a driver leaves its controller as it is

    def break_link(self, session: Session) -> None:
        """The network is cut."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is whole again."""
        self.sim.control.clear()


class TestForwardControllers(_Robot):
    """A robot with a controller for each kind of command, and with kinematics."""

    def values(self, urdf: Path) -> dict[str, Any]:
        return {"urdf": str(urdf)}


@pytest.mark.slow  # the same contract as above, by another controller
class TestTrajectoriesAlone(_Robot):
    """A robot that has a trajectory controller and nothing else."""

    def values(self, urdf: Path) -> dict[str, Any]:
        return {"trajectory_controller": TRAJECTORY}
