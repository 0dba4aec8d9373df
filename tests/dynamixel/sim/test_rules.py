"""What simulated servos allow and refuse, asked with the vendor's SDK over the tty."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext

import dynamixel_easy_sdk
import dynamixel_sdk as sdk
import pytest

from crtk_sim_backends.dynamixel import RunningSim
from rigs.dynamixel_clients import (
    CURRENT,
    DRIVE_MODE,
    GOAL_CURRENT,
    GOAL_POSITION,
    GOAL_PWM,
    GOAL_VELOCITY,
    HARDWARE_ERROR,
    HOMING,
    MODE,
    POSITION,
    PROFILE_ACCELERATION,
    PROFILE_VELOCITY,
    STATUS_LEVEL,
    TORQUE,
    Status,
    Vendor,
    Wire,
    hand,
    running,
    vendor_at,
    write,
)
from rigs.waiting import eventually

RESULT_FAIL, INSTRUCTION, CRC, RANGE, LENGTH, LIMIT, ACCESS = range(1, 8)
ALERT = 0x80

XM, OLD_XM, XL330, OLD_XL330, XL430, PH, MX, XM540 = 1, 2, 3, 4, 5, 6, 7, 8
SERVOS = (
    "1:xm430-w350@52,2:xm430-w350@41,3:xl330-m288@52,4:xl330-m288@50,5:xl430-w250,"
    "6:ph54-100-s500,7:mx-64,8:xm540-w270"
)


@pytest.fixture
def sim() -> Iterator[RunningSim]:
    with running(servos=SERVOS) as sim:
        yield sim


@pytest.fixture
def vendor(sim: RunningSim) -> Iterator[Vendor]:
    with vendor_at(sim) as vendor:
        yield vendor


def test_pings_tell_model_and_firmware(vendor: Vendor) -> None:
    assert [vendor.ping(n)[0] for n in range(1, 9)] == [
        1020,
        1020,
        1200,
        1200,
        1060,
        2010,
        311,
        1120,
    ]
    assert vendor.ping_in_vain(9) == sdk.COMM_RX_TIMEOUT
    found, result = vendor.packets.broadcastPing(vendor.port)
    assert result == sdk.COMM_SUCCESS
    assert [found[number][1] for number in range(1, 9)] == [52, 41, 52, 50, 52, 14, 45, 52]


def test_what_is_read_only_stays(vendor: Vendor) -> None:
    for address, size in ((0, 2), (6, 1), (69, 1), (HARDWARE_ERROR, 1), (122, 1), (POSITION, 4)):
        assert vendor.write(XM, address, size, 1) == ACCESS
    assert vendor.ping(XM)[0] == 1020


def test_eeprom_is_locked_while_torque_is_on(vendor: Vendor) -> None:
    assert vendor.write(XM, HOMING, 4, 100) == 0
    assert vendor.write(XM, TORQUE, 1, 1) == 0
    assert vendor.write(XM, HOMING, 4, 200) == ACCESS
    assert vendor.write(XM, 168, 2, 132) == ACCESS  # indirect addresses too
    assert vendor.read(XM, HOMING, 4) == 100
    assert vendor.write(XM, TORQUE, 1, 0) == 0
    assert vendor.write(XM, HOMING, 4, 200) == 0


def test_addresses_that_are_not_there(vendor: Vendor) -> None:
    assert vendor.write(XM, 14, 1, 0) == ACCESS  # a hole
    assert vendor.write(XM, 700, 1, 0) == ACCESS
    assert vendor.error_of_read(XM, 700, 4) == ACCESS
    assert vendor.write(XL430, GOAL_CURRENT, 2, 1) == ACCESS  # has no current
    assert vendor.write(XM, 40, 4, 1) == ACCESS  # Acceleration Limit: of the MX
    assert vendor.write(MX, 40, 4, 1) == 0
    assert vendor.write(OLD_XM, 60, 1, 0) == ACCESS  # Startup Configuration: firmware 45
    assert vendor.write(XM, 60, 1, 0) == 0
    assert vendor.write(XM, 56, 1, 0) == ACCESS  # external ports: of the XM540
    assert vendor.write(XM540, 56, 1, 0) == 0


def test_parts_of_registers_are_refused(vendor: Vendor) -> None:
    assert vendor.write(XM, GOAL_POSITION, 2, 100) == LENGTH
    assert vendor.write(XM, GOAL_POSITION + 2, 2, 0) == LENGTH
    assert vendor.read(XM, GOAL_POSITION, 4) == 2048
    assert vendor.error_of_read(XM, GOAL_POSITION, 2) == 0  # reading them is no problem


@pytest.mark.parametrize(
    ("address", "size", "value"),
    [
        *((7, 1, 253), (8, 1, 8), (9, 1, 255), (MODE, 1, 2), (13, 1, 3), (TORQUE, 1, 2)),
        *((STATUS_LEVEL, 1, 3), (PROFILE_VELOCITY, 4, 32768), (48, 4, 4096), (98, 1, 200)),
        *((168, 2, 63), (168, 2, 662)),
    ],
)
def test_values_out_of_range(vendor: Vendor, address: int, size: int, value: int) -> None:
    before = vendor.read(XM, address, size)
    assert vendor.write(XM, address, size, value) == RANGE
    assert vendor.read(XM, address, size) == before


def test_goals_beyond_the_limits(vendor: Vendor) -> None:
    assert vendor.write(XM, 52, 4, 1000) == 0
    assert vendor.write(XM, 48, 4, 3000) == 0
    assert [vendor.write(XM, GOAL_POSITION, 4, goal) for goal in (999, 1000, 3000, 3001)] == [
        *(LIMIT, 0, 0, LIMIT)
    ]
    assert vendor.read(XM, GOAL_POSITION, 4) == 3000
    assert [vendor.write(XM, GOAL_VELOCITY, 4, goal) for goal in (200, -200, 201, -201)] == [
        *(0, 0, LIMIT, LIMIT)
    ]
    assert [vendor.write(XM, GOAL_CURRENT, 2, goal) for goal in (1193, -1193, 1194)] == [
        *(0, 0, RANGE)
    ]
    assert vendor.write(XM, 38, 2, 500) == 0
    assert vendor.write(XM, GOAL_CURRENT, 2, 501) == LIMIT
    assert vendor.write(XM, 36, 2, 400) == 0
    assert [vendor.write(XM, GOAL_PWM, 2, goal) for goal in (-400, 401)] == [0, LIMIT]


def test_extended_position_ignores_the_limits_of_position_mode(vendor: Vendor) -> None:
    assert vendor.write(XM, GOAL_POSITION, 4, 5000) == LIMIT
    assert vendor.write(XM, MODE, 1, 4) == 0
    assert vendor.write(XM, GOAL_POSITION, 4, 5000) == 0
    assert vendor.write(XM, GOAL_POSITION, 4, 1_048_575) == 0
    assert vendor.write(XM, GOAL_POSITION, 4, 1_048_576) == LIMIT


def test_modes_by_model(vendor: Vendor) -> None:
    def allowed(number: int) -> list[int]:
        return [mode for mode in range(17) if vendor.write(number, MODE, 1, mode) == 0]

    assert allowed(XM) == [0, 1, 3, 4, 5, 16]
    assert allowed(XL430) == [1, 3, 4, 16]
    assert allowed(PH) == [0, 1, 3, 4, 16]


def test_a_change_of_mode_resets_gains_profile_and_goals(vendor: Vendor) -> None:
    vendor.write(XM, 84, 2, 400)
    vendor.write(XM, PROFILE_VELOCITY, 4, 50)
    vendor.write(XM, PROFILE_ACCELERATION, 4, 5)
    vendor.write(XM, GOAL_PWM, 2, 100)
    vendor.write(XM, GOAL_CURRENT, 2, 100)
    assert vendor.write(XM, MODE, 1, 5) == 0
    assert vendor.read(XM, 84, 2) == 800
    assert vendor.read(XM, PROFILE_VELOCITY, 4) == vendor.read(XM, PROFILE_ACCELERATION, 4) == 0
    assert vendor.read(XM, GOAL_PWM, 2) == 885
    assert vendor.read(XM, GOAL_CURRENT, 2) == 1193


def test_status_return_level(vendor: Vendor) -> None:
    def answered(result: int) -> bool:
        return result == sdk.COMM_SUCCESS

    assert vendor.write(XM, STATUS_LEVEL, 1, 1) == 0
    asking = (
        lambda: vendor.ping(XM)[1],
        lambda: vendor.packets.read1ByteTxRx(vendor.port, XM, STATUS_LEVEL)[1],
        lambda: vendor.packets.write1ByteTxRx(vendor.port, XM, 65, 1)[0],
    )
    for level, expected in ((1, (True, True, False)), (0, (True, False, False))):
        vendor.packets.write1ByteTxOnly(vendor.port, XM, STATUS_LEVEL, level)
        for ask, is_answered in zip(asking, expected, strict=True):
            with nullcontext() if is_answered else vendor.in_vain():
                assert answered(ask()) == is_answered
    vendor.packets.write1ByteTxOnly(vendor.port, XM, STATUS_LEVEL, 2)
    assert vendor.read(XM, 65, 1) == 1  # it was written all the same


def test_id_and_baud_rate_change_after_the_answer(vendor: Vendor) -> None:
    assert vendor.write(XM, 7, 1, 20) == 0
    assert vendor.ping_in_vain(XM) == sdk.COMM_RX_TIMEOUT
    assert vendor.ping(20)[0] == 1020
    assert vendor.write(20, 8, 1, 1) == 0
    assert vendor.ping_in_vain(20) == sdk.COMM_RX_TIMEOUT
    vendor.port.setBaudRate(57600)
    assert vendor.ping(20)[0] == 1020
    assert vendor.ping_in_vain(XL330) == sdk.COMM_RX_TIMEOUT


def test_indirect_data_lies_elsewhere_in_some_firmwares(vendor: Vendor) -> None:
    for number, data in ((XM, 224), (XL330, 208), (OLD_XL330, 224), (PH, 634)):
        assert vendor.read(number, 168, 2) == data  # the factory's mapping is onto itself
    for n in range(4):
        assert vendor.write(XL330, 168 + 2 * n, 2, GOAL_POSITION + n) == 0
    assert vendor.write(XL330, 208, 4, 1234) == 0
    assert vendor.read(XL330, GOAL_POSITION, 4) == 1234
    assert vendor.write(OLD_XL330, 208, 4, 1234) == ACCESS
    assert vendor.write(XL330, 228, 1, 0) == ACCESS


def test_indirect_data_keeps_the_rules_of_what_it_points_to(vendor: Vendor) -> None:
    for n in range(4):
        vendor.write(XM, 168 + 2 * n, 2, GOAL_POSITION + n)
        vendor.write(XM, 578 + 2 * n, 2, POSITION + n)
    vendor.write(XM, 176, 2, 64)
    assert vendor.write(XM, 224, 4, 5000) == LIMIT
    assert vendor.write(XM, 224, 2, 500) == LENGTH
    assert vendor.write(XM, 634, 4, 1) == ACCESS
    assert vendor.write(XM, 228, 1, 1) == 0
    assert vendor.read(XM, TORQUE, 1) == 1
    assert vendor.read(XM, 634, 4) == vendor.read(XM, POSITION, 4)


def test_registered_instruction_waits_for_action(vendor: Vendor) -> None:
    packets, port = vendor.packets, vendor.port
    result, error = packets.regWriteTxRx(port, XM, GOAL_POSITION, 4, [0, 4, 0, 0])
    assert (result, error) == (sdk.COMM_SUCCESS, 0)
    assert vendor.read(XM, 69, 1) == 1
    assert vendor.read(XM, GOAL_POSITION, 4) == 2048
    assert packets.action(port, sdk.BROADCAST_ID) == sdk.COMM_SUCCESS  # the SDK reads no answer
    assert vendor.read(XM, GOAL_POSITION, 4) == 1024
    assert vendor.read(XM, 69, 1) == 0
    _, error = packets.regWriteTxRx(port, XM, GOAL_POSITION, 4, [0, 0, 1, 0])
    assert error == LIMIT


def test_reboot_forgets_ram_and_turns_torque_off(vendor: Vendor) -> None:
    vendor.write(XM, HOMING, 4, 7)
    vendor.write(XM, PROFILE_VELOCITY, 4, 50)
    vendor.write(XM, TORQUE, 1, 1)
    assert vendor.packets.reboot(vendor.port, XM) == (sdk.COMM_SUCCESS, 0)
    assert vendor.ping_in_vain(XM) == sdk.COMM_RX_TIMEOUT  # for a moment
    eventually(lambda: vendor.ping_in_vain(XM) == sdk.COMM_SUCCESS)
    assert vendor.read(XM, TORQUE, 1) == 0
    assert vendor.read(XM, PROFILE_VELOCITY, 4) == 0
    assert vendor.read(XM, HOMING, 4) == 7


@pytest.mark.parametrize(("kept", "number", "baud"), [(1, XM, 57600), (2, XM, 1_000_000)])
def test_factory_reset_keeps_what_it_is_told(
    vendor: Vendor, kept: int, number: int, baud: int
) -> None:
    vendor.write(XM, HOMING, 4, 7)
    assert vendor.packets.factoryReset(vendor.port, XM, kept) == (sdk.COMM_SUCCESS, 0)
    vendor.port.setBaudRate(baud)
    eventually(lambda: vendor.ping_in_vain(number) == sdk.COMM_SUCCESS)
    assert vendor.read(number, HOMING, 4) == 0
    assert vendor.read(number, 9, 1) == 250


def test_shutdown_takes_torque_until_a_reboot_and_every_status_is_an_alert(
    sim: RunningSim, vendor: Vendor
) -> None:
    vendor.write(XM, TORQUE, 1, 1)
    sim.control.inject("overload", id=XM)
    assert vendor.write(XM, 65, 1, 1) == ALERT
    assert vendor.read(XM, HARDWARE_ERROR, 1) == 0x20
    assert vendor.read(XM, TORQUE, 1) == 0
    vendor.write(XM, TORQUE, 1, 1)
    assert vendor.read(XM, TORQUE, 1) == 0
    assert vendor.write(XM, GOAL_POSITION, 4, 5000) == ALERT | LIMIT
    vendor.packets.reboot(vendor.port, XM)
    eventually(lambda: vendor.ping_in_vain(XM) == sdk.COMM_SUCCESS)
    assert vendor.write(XM, TORQUE, 1, 1) == 0
    assert vendor.read(XM, HARDWARE_ERROR, 1) == 0


def test_a_hardware_error_that_shutdown_does_not_name_leaves_torque_on(
    sim: RunningSim, vendor: Vendor
) -> None:
    vendor.write(XM, TORQUE, 1, 1)
    sim.control.inject("voltage", id=XM, volts=8.0)
    eventually(lambda: vendor.read(XM, HARDWARE_ERROR, 1) == 0x01)
    assert vendor.read(XM, TORQUE, 1) == 1
    assert vendor.read(XM, 144, 2) == 80


def test_the_sdk_moves_a_chain(vendor: Vendor) -> None:
    group = vendor.sync_reader(CURRENT, 10, XM, XL330, XM540)
    group_write = sdk.GroupSyncWrite(vendor.port, vendor.packets, GOAL_POSITION, 4)
    for number in (XM, XL330, XM540):
        assert vendor.write(number, TORQUE, 1, 1) == 0
        assert vendor.write(number, PROFILE_VELOCITY, 4, 100) == 0
        assert group_write.addParam(number, [0, 7 + number, 0, 0])
    assert group_write.txPacket() == sdk.COMM_SUCCESS

    def positions(read: str) -> list[int]:
        assert getattr(group, read)() == sdk.COMM_SUCCESS
        return [group.getData(number, POSITION, 4) for number in (XM, XL330, XM540)]

    for read in ("txRxPacket", "fastSyncRead"):
        eventually(lambda read=read: positions(read) == [0x800, 0xA00, 0xF00])


def test_what_the_sdk_does_not_stuff_is_lost_as_at_a_real_servo(
    sim: RunningSim, vendor: Vendor
) -> None:
    vendor.write(XM, MODE, 1, 4)
    goal = -131_073  # FF FF FD FF: dynamixel-sdk 4.1 sends it without stuffing
    with vendor.in_vain():
        result, _ = vendor.packets.write4ByteTxRx(vendor.port, XM, GOAL_POSITION, goal % (1 << 32))
    assert result == sdk.COMM_RX_TIMEOUT
    assert vendor.read(XM, GOAL_POSITION, 4) == 2048
    vendor.close()
    with Wire(sim.ttys["bus1"]) as wire:
        packet = write(XM, GOAL_POSITION, goal.to_bytes(4, "little", signed=True))
        assert packet[10:15] == hand("FF FF FD FD FF")
        assert wire.ask(packet, 11) == [Status(XM, 0, b"")]


def test_mixed_tables_are_read_in_bulk(vendor: Vendor) -> None:
    vendor.write(XM540, MODE, 1, 4)
    group = sdk.GroupBulkRead(vendor.port, vendor.packets)
    group.addParam(XM, POSITION, 4)
    group.addParam(PH, 580, 4)
    group.addParam(XL430, 144, 2)
    assert group.txRxPacket() == sdk.COMM_SUCCESS
    values = [group.getData(*item) for item in ((XM, POSITION, 4), (PH, 580, 4), (XL430, 144, 2))]
    assert values == [2048, 0, 111]
    goals = sdk.GroupBulkWrite(vendor.port, vendor.packets)
    goals.addParam(XM, GOAL_POSITION, 4, [1, 4, 0, 0])
    goals.addParam(PH, 552, 4, [5, 0, 0, 0])
    assert goals.txPacket() == sdk.COMM_SUCCESS
    assert vendor.read(XM, GOAL_POSITION, 4) == 1025
    assert vendor.read(PH, 552, 4) == 5


def test_reverse_mode_and_homing_offset(sim: RunningSim, vendor: Vendor) -> None:
    sim.control.call("place", id=XM, angle=0.5)
    forward = vendor.read(XM, POSITION, 4) - 2048
    assert forward == 326
    vendor.write(XM, DRIVE_MODE, 1, 1)
    assert vendor.read(XM, POSITION, 4) - 2048 == -forward
    vendor.write(XM, HOMING, 4, 100)
    assert vendor.read(XM, POSITION, 4) - 2048 == 100 - forward  # the offset keeps its sign
    vendor.write(XM, HOMING, 4, 1025)
    assert vendor.read(XM, POSITION, 4) - 2048 == -forward  # too large for position mode
    vendor.write(XM, MODE, 1, 4)
    assert vendor.read(XM, POSITION, 4) - 2048 == 1025 - forward


def test_the_easy_sdk(sim: RunningSim) -> None:
    connector = dynamixel_easy_sdk.Connector(sim.ttys["bus1"], 1_000_000)
    try:
        motor = connector.createMotor(XM)
        motor.enableTorque()
        motor.setGoalPosition(2500)
        eventually(lambda: motor.getPresentPosition() == 2500)
        assert motor.getPresentVelocity() == 0
    finally:
        connector._port_handler.closePort()  # it has no method for it
