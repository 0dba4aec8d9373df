"""The SYNC of the kernel (CAN_BCM) under a CANopen arm, which only a kernel with CAN can show."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import pytest

from crtk_driver_canopen import PLUGIN
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.cycle import SYNC
from crtk_drivers.errors import CommandRefused, TransitionFailed
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.beside import beside
from rigs.canopen_arm import arm_of, arm_on, device_of, drives
from rigs.waiting import LONG, eventually

COUNT = 2
PERIOD = 0.02
SYNCS = 50

pytestmark = pytest.mark.skipif(
    "vcan0" not in {name for _, name in socket.if_nameindex()}, reason="there is no vcan0"
)


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with drives(COUNT, interface="vcan0", terminals=0) as running:
        yield running


@pytest.fixture
def config(sim: RunningSim) -> CanopenConfig:
    return arm_on(
        sim, COUNT, bus={"interface": "socketcan", "channel": "vcan0"}, period=PERIOD,
        heartbeat={"ours_timeout": 1.0, "drives_timeout": 1.0},
    )  # fmt: skip


@pytest.fixture
def listener() -> Iterator[can.BusABC]:
    """Whatever is on the bus at SYNC; its time stamps are the kernel's."""
    only = [{"can_id": SYNC, "can_mask": 0x7FF, "extended": False}]
    with can.Bus(interface="socketcan", channel="vcan0", can_filters=only) as bus:
        yield bus


def stamps(bus: can.BusABC, count: int) -> list[float]:
    """When the next SYNCs passed."""
    while bus.recv(0.0) is not None:
        pass
    found = [bus.recv(LONG) for _ in range(count)]
    return [message.timestamp for message in found if message is not None]


@contextmanager
def foreign_sync() -> Iterator[None]:
    """Another program on this computer sends SYNC, as often as the arm does."""

    def run(over: threading.Event) -> None:
        with can.Bus(interface="socketcan", channel="vcan0") as bus:
            while not over.wait(PERIOD):
                bus.send(can.Message(arbitration_id=SYNC, is_extended_id=False))

    with beside(run):
        yield


def enables(arm: LocalDevice) -> bool:
    try:
        arm.enable(LONG)
    except (TransitionFailed, CommandRefused):
        return False
    return True


def test_the_arm_moves_with_the_sync_of_the_kernel(
    config: CanopenConfig, listener: can.BusABC
) -> None:
    assert config.kernel_sync
    with arm_of(config) as arm:
        arm.enable(LONG)
        goal = arm.setpoint_jp() + 0.05
        arm.move_jp(goal).wait(LONG)
        eventually(lambda: abs(arm.measured_js().position - goal).max() < 1e-3, "it is there")
        passed = stamps(listener, SYNCS)
        assert len(passed) == SYNCS
        assert passed[-1] - passed[0] > 0.9 * (SYNCS - 1) * PERIOD
        assert device_of(arm).counters["foreign_syncs"] == 0


def test_it_ends_with_the_connection_and_begins_again_with_the_next(
    config: CanopenConfig, listener: can.BusABC
) -> None:
    for _ in range(2):
        with arm_of(config) as arm:
            arm.enable(LONG)
            assert len(stamps(listener, 3)) == 3
        while listener.recv(0.0) is not None:
            pass
        assert listener.recv(10 * PERIOD) is None


def test_the_sync_of_another_program_on_this_computer_is_told_apart(config: CanopenConfig) -> None:
    with arm_of(config) as arm:
        arm.enable(LONG)
        with foreign_sync():
            eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
            assert "SYNC that is not ours" in arm.operating_state().detail
            eventually(
                lambda: device_of(arm).counters["foreign_syncs"] > 5, "it goes on being told"
            )
        eventually(lambda: enables(arm), "it can be enabled again")


def test_nothing_is_sent_to_a_bus_on_which_another_program_sends_sync(
    config: CanopenConfig, listener: can.BusABC
) -> None:
    with foreign_sync():
        stamps(listener, 1)
        arm = LocalDevice(Session(PLUGIN, config))
        try:
            arm._session.start()
            eventually(
                lambda: "SYNC that is not ours" in arm.operating_state().detail, "it is refused"
            )
            assert not arm.engine.connected
        finally:
            arm.close()
