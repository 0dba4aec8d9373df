"""The simulator's control tables, which are its own, against the files of the vendor's SDK."""

from __future__ import annotations

import re
from importlib.util import find_spec
from pathlib import Path

import pytest

from crtk_sim_backends.dynamixel.bus import make_servos
from crtk_sim_backends.dynamixel.config import parse_servos
from crtk_sim_backends.dynamixel.models import MODELS, Model
from crtk_sim_backends.dynamixel.registers import LEGACY, Access

_SPEC = find_spec("dynamixel_easy_sdk")
assert _SPEC is not None
assert _SPEC.submodule_search_locations
FOLDER = Path(next(iter(_SPEC.submodule_search_locations))) / "control_table"
NAMES = {"secondary_shadow_id": "secondary_id", "bus_watchdog": "bus_watchdog"}
MODERN = [model for model in MODELS.values() if model.series not in LEGACY]


def stem(model: Model) -> str:
    """Name of the vendor's file."""
    return model.name.replace("xl-320", "xl320").replace("-", "_")


def vendor_table(model: Model, suffix: str = "") -> dict[str, tuple[int, int]]:
    """Address and size by name, without the indirect registers."""
    path = FOLDER / f"{stem(model)}{suffix}.model"
    lines = path.read_text("utf-8-sig").partition("[control table]")[2].splitlines()
    found = {}
    for line in lines:
        fields = [field.strip() for field in line.split("\t")]
        if len(fields) < 3 or not fields[0].isdecimal() or fields[2].startswith("Indirect"):
            continue
        name = re.sub(r"[^a-z0-9]+", "_", fields[2].lower()).strip("_")
        found[NAMES.get(name, name)] = (int(fields[0]), int(fields[1]))
    return found


@pytest.mark.parametrize("model", MODERN, ids=lambda model: model.name)
def test_every_register_of_the_sdk_is_there(model: Model) -> None:
    table = model.table(model.newest_firmware)
    known = vendor_table(model)
    assert len(known) > 30
    wrong = {
        name: place
        for name, place in known.items()
        if name not in table or (table[name].address, table[name].size) != place
    }
    # The SDK's tables of the P series have a fourth external port, whose registers are not simulated.
    assert {name for name in wrong if not name.startswith("external_port")} == set()


@pytest.mark.parametrize("model", MODERN, ids=lambda model: model.name)
def test_there_are_no_others_but_those_of_newer_firmware(model: Model) -> None:
    table = model.table(model.newest_firmware)
    more = {r.name for r in table if not r.name.startswith("indirect_")} - set(vendor_table(model))
    newer = {"startup_configuration", "backup_ready", "model_information", "pwm_slope"}
    assert more - newer == set()


@pytest.mark.parametrize("model", MODERN, ids=lambda model: model.name)
def test_numbers_are_those_of_the_sdk(model: Model) -> None:
    text = (FOLDER / "dynamixel.model").read_text("utf-8-sig")
    numbers = dict(line.split("\t")[:2] for line in text.splitlines() if line[:1].isdecimal())
    assert numbers[str(model.number)].strip() == f"{stem(model)}.model"


@pytest.mark.parametrize("firmware", [1, 44, 45, 46, 52, 255])
def test_tables_hold_together(firmware: int) -> None:
    for model in MODELS.values():
        table = model.table(firmware)
        taken: set[int] = set()
        for register in table:
            where = (model.name, register)
            places = set(range(register.address, register.end))
            assert not places & taken, where
            taken |= places
            assert table.at[register.address] is register, where
            if register.access is not Access.READ:
                assert register.low <= register.default <= register.high, where
            assert register.decode(register.encode(register.low)) == register.low, where
            assert register.decode(register.encode(register.high)) == register.high, where
        for block in table.blocks:
            assert not set(range(block.data, block.data + block.count)) & taken, model.name


def test_firmware_changes_tables() -> None:
    xm, xl330 = MODELS["xm430-w350"], MODELS["xl330-m288"]
    assert "backup_ready" not in xm.table(44)
    assert "backup_ready" in xm.table(45)
    assert [block.data for block in xm.table(52).blocks] == [224, 634]
    assert [block.data for block in xl330.table(51).blocks] == [224]
    assert [block.data for block in xl330.table(52).blocks] == [208]
    assert "present_load" in MODELS["xl430-w250"].table(52)
    assert "goal_current" not in MODELS["xl430-w250"].table(52)


@pytest.mark.parametrize("name", MODELS)
def test_a_new_servo_is_at_rest_and_well(name: str) -> None:
    (servo,) = make_servos(parse_servos(f"1:{name}"), 1_000_000, 0)
    servo.refresh(1.0)
    assert (servo.error_bits, servo.drive.velocity, servo.baud) == (0, 0.0, 1_000_000)
    assert servo["present_position"] == servo.model.units.zero == servo["goal_position"]
