"""The process that watches devices of other machines for `crtk-driver up`."""

import fcntl
import os
import sys
import termios
import time

import pytest

from crtk_drivers.labs.seen import Seen
from rigs.lab_observer import observer
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros


def test_it_tells_state_host_and_clock_of_a_device(rig):
    devices = {"arm": rig.client.namespace, "nobody": "/nobody"}
    with observer(devices) as watching:
        found = watching.until(
            "all of it", name="arm", measures=True, offset=lambda it: it is not None
        )
        assert (found.seen, found.state, found.host) == (True, "DISABLED", os.uname().nodename)
        assert abs(found.offset) < 0.005
        assert not found.has_other_time
        nobody = watching.until("nobody", name="nobody")
        assert (nobody.seen, nobody.ago, nobody.is_ready) == (False, None, False)
        began = time.monotonic()
        rig.client.reach("enable", "ENABLED")
        watching.until("the new state", name="arm", state="ENABLED")
        rig.device.reachable = False
        lost = watching.until("a reason", state="FAULT", cause=lambda it: bool(it), measures=False)
        assert "loopback" in lost.cause
        few = [each for each in watching.seen if each.name == "nobody"]
        assert len(few) <= time.monotonic() - began + 30.0
        assert watching.end() == 0


def test_it_tells_of_a_change_at_once_and_else_once_a_second(rig):
    with observer({"arm": rig.client.namespace}) as watching:
        watching.until("it is seen", seen=True, measures=True, state="DISABLED")
        watching.read()
        began = time.monotonic()
        eventually(lambda: time.monotonic() - began > 3.0)
        assert 2 <= len(watching.read()) <= 4
        rig.client.reach("enable", "ENABLED")
        watching.until("the new state", state="ENABLED")


def test_a_full_pipe_keeps_it_from_nothing(rig):
    many = {f"nobody{number}": f"/nobody{number}" for number in range(20)}
    with observer({"arm": rig.client.namespace, **many}) as watching:
        watching.until("it is seen", seen=True)
        fcntl.fcntl(watching._reading, fcntl.F_SETPIPE_SZ, 4096)
        eventually(lambda: _is_full(watching._reading), "the pipe is full")
        began = time.monotonic()
        eventually(lambda: time.monotonic() - began > 1.5, "more was due")
        assert watching.end() == 0, "it still looks at what it is told"


def _is_full(descriptor):
    size = bytearray(4)
    fcntl.ioctl(descriptor, termios.FIONREAD, size)
    return int.from_bytes(size, sys.byteorder) + len(Seen("nobody10", False).line) > 4096


def test_it_ends_with_whoever_started_it(rig):
    with observer({"arm": rig.client.namespace}) as watching:
        watching.until("it is seen", seen=True)
        watching.pulse.close()
        assert watching.process.wait(LONG) == 0
