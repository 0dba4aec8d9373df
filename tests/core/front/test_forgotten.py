"""What is opened and forgotten warns when it is gone: `ResourceWarning`, as files and sockets do."""

import gc
import os

import pytest

from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig
from crtk_sim_backends.netft import SIM

FREE_PORTS = {"rdt_port": 0, "tcp_port": 0, "http_port": 0}


def test_a_device_that_is_forgotten_warns() -> None:
    held = [Session(PLUGIN, LoopbackConfig())]
    held[0].start()
    runtime = held[0]._runtime
    try:
        with pytest.warns(ResourceWarning, match="loopback.*was forgotten, not closed"):
            held.clear()
    finally:
        runtime.close()


def test_a_device_that_was_closed_or_never_started_does_not_warn() -> None:
    with Session(PLUGIN, LoopbackConfig()) as session:
        pass
    other = Session(PLUGIN, LoopbackConfig())
    del session, other
    gc.collect()


def test_a_simulator_that_is_forgotten_warns() -> None:
    held = [SIM.spawn(**FREE_PORTS)]
    process, life = held[0]._process, held[0]._life
    with pytest.warns(ResourceWarning, match=f"process id {process.pid} was forgotten"):
        held.clear()
    os.close(life)
    process.kill()
    process.wait(10.0)
