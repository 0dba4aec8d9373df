"""Two machines, each a network namespace with a cable to the other one: what each sees of the other."""

import os

import pytest

from rigs.lab_observer import observer
from rigs.two_machines import two_machines

pytest.importorskip("rclpy")
pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]


@pytest.fixture(scope="module")
def machines():
    with two_machines() as (control, tracking), tracking.device("/camera"):
        yield control, tracking


@pytest.fixture
def watching(machines):
    control, _ = machines
    with observer({"camera": "/camera"}, control.python(), control.environment()) as watching:
        watching.until("it measures", measures=True)
        yield watching


def test_the_other_machine_is_seen_with_its_clock(watching):
    found = watching.until("its clock", offset=lambda it: it is not None)
    assert (found.state, found.host) == ("DISABLED", "tracking")
    assert abs(found.offset) < 0.005
    assert os.uname().nodename != "tracking", "this machine keeps its name"


def test_a_cable_that_is_pulled_out_is_told(machines, watching):
    machines[0].set_link(up=False)
    gone = watching.until("it is not seen", seen=False)
    assert 3.0 <= gone.ago < 4.0
    machines[0].set_link(up=True)
    watching.until("it is back", seen=True, measures=True, state="DISABLED")
