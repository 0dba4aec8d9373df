"""A tracker and its tools keep the contract of every device, over TCP and a serial line, in each dialect."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

pytest.register_assert_rewrite("crtk_drivers.testing.contract")

from crtk_driver_ndi import PLUGIN  # noqa: E402
from crtk_drivers.front import LocalDevice  # noqa: E402
from crtk_drivers.session import Session  # noqa: E402
from crtk_drivers.testing.contract import DeviceContract  # noqa: E402
from crtk_sim_backends.process import RunningSim  # noqa: E402
from rigs.ndi_bench import configuration, simulated  # noqa: E402
from rigs.waiting import LONG, eventually  # noqa: E402

pytestmark = pytest.mark.sweep(3)

DIALECTS = (
    ("vega", "tcp", "BX2"),
    ("vega", "serial", "BX"),
    ("spectra", "serial", "TX"),
    ("aurora", "serial", "BX2"),
)


@pytest.fixture(scope="module", params=DIALECTS, ids=lambda dialect: "-".join(dialect))
def dialect(request: pytest.FixtureRequest) -> Iterator[tuple[RunningSim, str, str]]:
    """A simulated tracker, the way to it, and how it is asked; one for all tests."""
    family, transport, replies = request.param
    with simulated(family=family) as sim:
        yield sim, transport, replies


class TestTracker(DeviceContract):
    """Everything that any device must do."""

    timeout = LONG

    @pytest.fixture
    def session(self, dialect: tuple[RunningSim, str, str]) -> Iterator[Session]:
        """Its driver."""
        self.sim, transport, replies = dialect
        yield Session(PLUGIN, configuration(self.sim, transport=transport, replies=replies))
        self.sim.control.clear()

    def break_link(self, session: Session) -> None:
        """The cable is pulled out."""
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        """It is plugged in again."""
        self.sim.control.clear("disconnect")


class TestTool(TestTracker):
    """The same of a tool, which is told about while its tracker is enabled."""

    child = "pointer"

    def prepare(self, session: Session) -> None:
        """Let the tracker track, and wait for a pose."""
        tracker = LocalDevice(session)
        eventually(lambda: all(engine.has_sample for engine in session.engines), "connected")
        tracker.enable()
        engine = session.children[self.child]

        def has_pose() -> bool:
            found = engine.feedback("measured_cp")
            return found is not None and bool(found[1].wall_ns)

        eventually(has_pose, "a pose")
