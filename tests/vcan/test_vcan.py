"""What only a kernel with CAN can show; run them with ``python tests/vcan/uml.py`` where there is none."""

import errno
import shutil
import socket
import subprocess

import can
import pytest

from crtk_sim_backends.can import SIM
from crtk_sim_backends.canopen import SIM as DRIVES
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.skipif(
    "vcan0" not in {name for _, name in socket.if_nameindex()}, reason="there is no vcan0"
)


def frame(can_id=0x123, data=b"\x01\x02"):
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=can_id > 0x7FF)


def ip(*words):
    subprocess.run(["ip", "link", *words], check=True)


def test_the_interface_crtk_is_as_socketcan():
    """The same calls, the same frames and flags, at both."""
    seen = {}
    with SIM.spawn(socketcand_port=0, terminals=0) as sim:
        for interface, channel in (("socketcan", "vcan0"), ("crtk", sim.paths["crtk"])):
            with (
                can.Bus(interface=interface, channel=channel) as one,
                can.Bus(interface=interface, channel=channel) as other,
                can.Bus(interface=interface, channel=channel, receive_own_messages=True) as own,
            ):
                own.send(frame(0x12345678, b"own"))
                one.send(
                    can.Message(
                        arbitration_id=0x5, is_remote_frame=True, dlc=3, is_extended_id=False
                    )
                )
                seen[interface] = [
                    [describe(bus.recv(LONG)) for _ in range(count)] + [bus.recv(0.05)]
                    for bus, count in ((one, 1), (other, 2), (own, 2))
                ]
    assert seen["crtk"] == seen["socketcan"]


def describe(message):
    """All but `is_rx`, which on one machine's SocketCAN is false for everybody's frames."""
    flags = (message.is_extended_id, message.is_remote_frame, message.is_error_frame)
    return message.arbitration_id, bytes(message.data), message.dlc, flags


def test_an_interface_that_is_down_gives_the_same_error():
    codes = {}
    with can.Bus(interface="socketcan", channel="vcan0") as bus:
        ip("set", "vcan0", "down")
        try:
            codes["socketcan"] = codes_of(bus)
        finally:
            ip("set", "vcan0", "up")
    with (
        SIM.spawn(socketcand_port=0, terminals=0) as sim,
        can.Bus(interface="crtk", channel=sim.paths["crtk"]) as bus,
    ):
        sim.control.inject("down")
        codes["crtk"] = codes_of(bus)
    assert codes["crtk"] == codes["socketcan"] == (errno.ENETDOWN, errno.ENETDOWN, None)


def codes_of(bus):
    """Error codes of a wait, of sending, and what a second wait brings."""
    with pytest.raises(can.CanOperationError) as receiving:
        bus.recv(LONG)
    with pytest.raises(can.CanOperationError) as sending:
        bus.send(frame())
    return receiving.value.error_code, sending.value.error_code, bus.recv(0.05)


@pytest.fixture
def joined():
    """A hub that is joined to vcan0, and a bus at each side."""
    with (
        SIM.spawn(socketcand_port=0, terminals=0, interface="vcan0") as sim,
        can.Bus(interface="crtk", channel=sim.paths["crtk"]) as hub,
        can.Bus(interface="socketcan", channel="vcan0") as kernel,
    ):
        yield sim, hub, kernel


def test_an_interface_of_the_kernel_joins_the_bus(joined):
    sim, hub, kernel = joined
    for message in (frame(), frame(0x1234567, bytes(8)), frame(0x7FF, b"")):
        hub.send(message)
        assert kernel.recv(LONG).equals(message, None, check_channel=False, check_direction=False)
        kernel.send(message)
        assert hub.recv(LONG).equals(message, None, check_channel=False, check_direction=False)
    assert hub.recv(0.05) is None
    assert kernel.recv(0.05) is None
    assert sim.control.status()["nodes"]["vcan0"]["sent"] == 3


def test_frames_pass_again_when_the_interface_is_back(joined):
    sim, hub, kernel = joined
    ip("set", "vcan0", "down")
    try:
        hub.send(frame())
        eventually(lambda: sim.control.status()["nodes"]["vcan0"]["missed"] == 1)
    finally:
        ip("set", "vcan0", "up")
    with pytest.raises(can.CanOperationError):
        kernel.recv(LONG)
    hub.send(frame(0x77))
    assert kernel.recv(LONG).arbitration_id == 0x77
    kernel.send(frame(0x78))
    assert hub.recv(LONG).arbitration_id == 0x78


def test_simulated_drives_answer_on_an_interface_of_the_kernel():
    """Object 1000 of node 1: a drive of CiA 402."""
    with (
        DRIVES.spawn(terminals=0, nodes=1, interface="vcan0"),
        can.Bus(interface="socketcan", channel="vcan0") as kernel,
    ):
        kernel.send(frame(0x601, bytes.fromhex("4000100000000000")))
        while (answer := kernel.recv(LONG)).arbitration_id != 0x581:
            pass
        assert answer.data[:4] == bytes.fromhex("43001000")
        assert answer.data[4:6] == (402).to_bytes(2, "little")


@pytest.mark.skipif(shutil.which("slcand") is None, reason="there is no slcand")
def test_the_real_slcand_makes_an_interface_of_a_terminal():
    with (
        SIM.spawn(socketcand_port=0, bitrate=1_000_000) as sim,
        can.Bus(interface="crtk", channel=sim.paths["crtk"]) as hub,
    ):
        daemon = subprocess.Popen(["slcand", "-F", "-o", "-c", "-s8", sim.ttys["slcan"], "slc7"])
        try:
            eventually(lambda: "slc7" in {name for _, name in socket.if_nameindex()})
            ip("set", "slc7", "up")
            with can.Bus(interface="socketcan", channel="slc7") as kernel:
                for message in (frame(), frame(0x1234567, bytes(8)), frame(0x7FF, b"")):
                    hub.send(message)
                    assert kernel.recv(LONG).equals(message, None, check_channel=False)
                    kernel.send(message)
                    assert hub.recv(LONG).equals(message, None, check_channel=False)
            assert sim.control.status()["nodes"]["slcan"]["missed"] == 0
        finally:
            daemon.terminate()
            daemon.wait(LONG)
