"""Control tables and models: what the SDK's files say, what is put right, and what is refused."""

from __future__ import annotations

import itertools
import math

import pytest

from crtk_driver_dynamixel import control_tables, models
from crtk_driver_dynamixel.control_tables import (
    PROTOCOL_1,
    Coding,
    IndirectBlock,
    control_table,
    model_files,
)
from crtk_driver_dynamixel.models import (
    MODELS,
    PROTOCOL_1_ERRORS,
    OperatingMode,
    hardware_error_text,
    model_named,
    model_numbered,
)
from crtk_drivers.errors import ConfigError, MissingExtra
from crtk_sim_backends.dynamixel.models import MODELS as SIMULATED
from crtk_sim_backends.dynamixel.registers import Access

NUMBERS = sorted({*model_files(), *PROTOCOL_1})

# e-manual, XM430-W350, Control Table.
XM430 = {
    "model_number": (0, 2),
    "id": (7, 1),
    "operating_mode": (11, 1),
    "secondary_id": (12, 1),
    "homing_offset": (20, 4),
    "current_limit": (38, 2),
    "startup_configuration": (60, 1),
    "torque_enable": (64, 1),
    "hardware_error_status": (70, 1),
    "bus_watchdog": (98, 1),
    "goal_pwm": (100, 2),
    "goal_current": (102, 2),
    "goal_velocity": (104, 4),
    "profile_acceleration": (108, 4),
    "goal_position": (116, 4),
    "present_current": (126, 2),
    "present_velocity": (128, 4),
    "present_position": (132, 4),
    "present_input_voltage": (144, 2),
    "present_temperature": (146, 1),
    "backup_ready": (147, 1),
}


def test_xm430_is_as_in_the_manual() -> None:
    table = control_table(1020, 45)
    assert table.model == "xm430-w350"
    assert {name: (table[name].address, table[name].size) for name in XM430} == XM430
    assert table.block(["present_current", "present_velocity", "present_position"]) == (126, 10)
    assert table.indirect == (IndirectBlock(168, 224, 28), IndirectBlock(578, 634, 28))


def test_xm430_access_and_signs() -> None:
    table = control_table(1020)
    assert table["homing_offset"].eeprom
    assert not table["torque_enable"].eeprom
    assert table["goal_position"].writable
    for name in ("present_position", "moving", "realtime_tick", "hardware_error_status"):
        assert not table[name].writable, name
    assert table["present_current"].range == (-32768, 32767)
    assert table["current_limit"].range == (0, 65535)


@pytest.mark.parametrize("firmware", [1, 45, 52, None])
def test_items_do_not_overlap(firmware: int | None) -> None:
    for table in [control_table(number, firmware) for number in NUMBERS]:
        items = sorted(table.values(), key=lambda item: item.address)
        for before, after in itertools.pairwise(items):
            assert before.end <= after.address, (table.model, before, after)
        needed = {"model_number", "id", "torque_enable", "goal_position", "present_position"}
        assert needed <= set(table), table.model
        assert all(item.size in (1, 2, 4) for item in items), table.model
        for block in table.indirect:
            assert block.address + 2 * block.count <= block.data, table.model


@pytest.mark.parametrize(
    ("number", "firmware", "data"),
    [(1200, 51, 224), (1200, 52, 208), (1200, None, 208), (1220, 46, 224), (1020, 52, 224)],
)
def test_indirect_data_by_firmware(number: int, firmware: int | None, data: int) -> None:
    table = control_table(number, firmware)
    assert table["indirect_data_1"].address == data
    assert table.indirect[0].data == data


@pytest.mark.parametrize("firmware", [44, 46, 52])
def test_tables_agree_with_those_of_the_simulator(firmware: int) -> None:
    """Both were written from the e-manual and the SDK, each for itself."""
    for model in SIMULATED.values():
        table = control_table(model.number, firmware)
        both = [register for register in model.table(firmware) if register.name in table]
        assert len(both) > 20, model.name
        for register in both:
            item, where = table[register.name], (model.name, register.name)
            assert (item.address, item.size) == (register.address, register.size), where
            assert item.writable == (register.access is not Access.READ), where
            if item.writable:
                locked = register.access in (Access.EEPROM, Access.LOCKED)
                kept = item.eeprom or item.name.startswith("indirect_address")
                assert kept == locked, where
        blocks = [(each.address, each.data, each.count) for each in model.table(firmware).blocks]
        found = [(each.address, each.data, each.count) for each in table.indirect]
        assert found == blocks, model.name


def test_registers_of_newer_firmware() -> None:
    assert "backup_ready" not in control_table(1020, 44)
    assert "backup_ready" in control_table(1020, 45)
    assert control_table(1200, 52).firmware == 52
    assert control_table(1020, 50).firmware == 45


@pytest.mark.parametrize("number", [1060, 1070, 1080, 1090, 1160, 30, 12, 350])
def test_load_instead_of_current(number: int) -> None:
    table = control_table(number)
    item = table.first(control_tables.EFFORT)
    assert item is not None
    assert item.name == "present_load"
    assert "current_limit" not in table


def test_protocol_1_tables() -> None:
    ax, mx = control_table(12), control_table(310)
    assert (ax.protocol, ax["present_position"].address, ax["goal_position"].address) == (1, 36, 30)
    assert ax["present_speed"].coding is Coding.SIGN_BIT_10
    assert ax["present_load"].coding is Coding.SIGN_BIT_10
    assert not ax["present_position"].signed
    assert mx["present_position"].signed  # of several turns
    assert mx["current"].coding is Coding.OFFSET_2048
    assert not mx["current"].writable
    assert ax["cw_angle_limit"].eeprom


def test_x_model_on_protocol_1_has_addresses_of_one_byte() -> None:
    table = control_table(1020, protocol=1)
    assert table.protocol == 1
    assert max(item.end for item in table.values()) <= 256
    assert table.indirect == (IndirectBlock(168, 224, 28),)
    with pytest.raises(ConfigError, match=r"xl330-m288 does not speak protocol 1.*set it to 2"):
        control_table(1200, protocol=1)
    with pytest.raises(ConfigError, match="ax-12a does not speak protocol 2"):
        control_table(12, protocol=2)


def test_unknown_model_says_what_to_do() -> None:
    with pytest.raises(
        ConfigError, match=r"1201 is not known.*1200.* -U dynamixel-sdk.*one at a time"
    ):
        control_table(1201)


def test_unknown_item_names_the_model() -> None:
    with pytest.raises(ConfigError, match=r"xl430-w250.*has no item 'goal_current'"):
        control_table(1060).item("goal_current")


def test_missing_sdk_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(control_tables, "find_spec", lambda name: None)
    control_tables.model_files.cache_clear()
    try:
        with pytest.raises(MissingExtra) as caught:
            control_tables.model_files()
        assert "crtk-drivers[dynamixel]" in caught.value.remedy
    finally:
        control_tables.model_files.cache_clear()


@pytest.mark.parametrize("model", MODELS.values(), ids=lambda model: model.name)
def test_models_agree_with_their_tables(model: models.Model) -> None:
    table = control_table(model.number)
    assert table.model == model.name
    assert table.protocol == model.family.protocol
    has_current = table.first(("present_current", "current")) is not None
    assert has_current == model.reports_current
    has_goal = "goal_current" in table
    if table.protocol == 2 and model.name != "xl-320":
        assert has_goal == (OperatingMode.CURRENT in model.modes)
        assert OperatingMode.POSITION in model.modes
    assert model.voltage[0] < model.voltage[1]
    if not model.reports_current:
        assert math.isnan(model.torque_constant)


@pytest.mark.parametrize(
    ("name", "constant"), [("xm430-w350", 1.783), ("xm540-w270", 2.409), ("xc330-t288", 0.967)]
)
def test_torque_constants(name: str, constant: float) -> None:
    assert MODELS[name].torque_constant == pytest.approx(constant, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "amperes"),
    [
        ("xl330-m288", 1.75),
        ("xc330-t288", 0.91),
        ("xm430-w350", 1193 * 0.00269),
        ("xm540-w270", 2047 * 0.00269),
        ("xh430-v350", 689 * 0.00134),
        ("mx-64", 1941 * 0.00336),
        ("ph54-200-s500", 22.74),
    ],
)
def test_greatest_currents(name: str, amperes: float) -> None:
    assert MODELS[name].current_limit * MODELS[name].current_unit == pytest.approx(amperes)


def test_units_of_the_x_series() -> None:
    family = MODELS["xm430-w350"].family
    assert family.position_unit == pytest.approx(1.533981e-3, rel=1e-6)
    assert family.velocity_unit == pytest.approx(0.0239808, rel=1e-5)
    assert family.acceleration_unit == pytest.approx(0.37451, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "firmware", "fast"),
    [
        ("xm430-w350", 44, False),
        ("xm430-w350", 45, True),
        ("xl330-m288", 45, False),
        ("xl330-m288", 46, True),
        ("2xl430-w250", 52, False),
        ("ph54-200-s500", 12, True),
        ("mx-64", 52, False),
        ("ax-12a", 24, False),
    ],
)
def test_fast_read_by_model_and_firmware(name: str, firmware: int, fast: bool) -> None:
    assert MODELS[name].has_fast_read(firmware) is fast


@pytest.mark.parametrize(
    "name", ["xm430-w350", "XM430-W350", "XM430-W350-T", "xm430_w350", " xm430-w350-r "]
)
def test_names_of_a_model(name: str) -> None:
    assert model_named(name).number == 1020


def test_unknown_names_and_numbers() -> None:
    with pytest.raises(ConfigError, match=r"'xm430-w351' is not a model.*Like it are xm430-w350"):
        model_named("xm430-w351")
    with pytest.raises(ConfigError, match=r"model number is 4711.*one at a time"):
        model_numbered(4711)
    assert model_numbered(1200).name == "xl330-m288"


def test_error_texts() -> None:
    assert hardware_error_text(0) == ""
    assert hardware_error_text(0b100100) == "overheating, overload"
    assert hardware_error_text(0x80) == "unknown error (bit 7)"
    assert hardware_error_text(0b100, PROTOCOL_1_ERRORS) == "overheating"
