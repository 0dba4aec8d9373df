"""What a drive is given to guard by itself, what is refused, and what is never written from a file."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen import PLUGIN
from crtk_drivers.errors import CommandRefused, ConfigError
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import JOINT, arm_of, arm_on, device_of, drives
from rigs.waiting import LONG, eventually

COUNTS = 65536 * 100 / (2 * math.pi)
"""Position units of a simulated drive for one rad behind a gear of 100."""


def held(sim: RunningSim, index: int, sub: int = 0, node: int = 1) -> int:
    return int(sim.control.call("object", node=node, index=index, sub=sub))


def give(sim: RunningSim, value: int, index: int, sub: int = 0, node: int = 1) -> None:
    sim.control.call("object", node=node, index=index, sub=sub, value=value)


def refused(sim: RunningSim, words: str, joint: dict[str, Any] | None = None, **keys: Any) -> None:
    arm = LocalDevice(Session(PLUGIN, arm_on(sim, 1, joint, **keys)))
    try:
        arm._session.start()
        eventually(lambda: words in arm.operating_state().detail, words)
        assert not arm.engine.connected
    finally:
        arm.close()


def notes(arm: LocalDevice) -> str:
    return "; ".join(note.text for note in device_of(arm).notes)


# ------------------------------------------------------------------------------------ option codes

CODES = {
    "quick_stop_option": (0x605A, 6),
    "shutdown_option": (0x605B, 1),
    "disable_option": (0x605C, 0),
    "halt_option": (0x605D, 2),
    "fault_option": (0x605E, 1),
    "abort_option": (0x6007, 1),
}


def test_option_codes_that_are_configured_are_written() -> None:
    with drives(1) as sim:
        give(sim, 1, 0x1029, 1)
        joint = {name: code for name, (_, code) in CODES.items()}
        with arm_of(arm_on(sim, 1, joint)):
            for index, code in CODES.values():
                assert held(sim, index) == code, hex(index)
            assert held(sim, 0x1029, 1) == 0
        keys = {"heartbeat": {"ours_timeout": 0.5, "error_behaviour": 2}}
        with arm_of(arm_on(sim, 1, **keys)):
            assert held(sim, 0x1029, 1) == 2


@pytest.mark.parametrize("name", CODES)
def test_an_option_code_that_is_acknowledged_and_ignored_is_refused(name: str) -> None:
    index, code = CODES[name]
    with drives(1) as sim:
        sim.control.inject("ignored_writes", index=index)
        refused(sim, f"{index:04X}h", {name: code})


def test_a_drive_that_would_coast_at_a_quick_stop_is_refused_unless_that_is_wanted() -> None:
    with drives(1) as sim:
        give(sim, 0, 0x605A)
        refused(sim, "605Ah:00 quick stop option is 0 (disable drive function)")
        with arm_of(arm_on(sim, 1, {"quick_stop_option": 0})) as arm:
            assert "605Ah:00 quick stop option is 0" in notes(arm)
        give(sim, 0, 0x605E)
        with arm_of(arm_on(sim, 1, {"quick_stop_option": 2})) as arm:
            assert "605Eh:00 fault reaction option is 0" in notes(arm)
            assert held(sim, 0x605A) == 2


def test_an_error_behaviour_that_is_ignored_is_refused_or_noted() -> None:
    with drives(1) as sim:
        give(sim, 1, 0x1029, 1)
        sim.control.inject("ignored_writes", index=0x1029)
        refused(sim, "1029h:01")
        keys = {"heartbeat": {"ours_timeout": 0.5, "required": False}}
        with arm_of(arm_on(sim, 1, **keys)) as arm:
            assert "1029h:01" in notes(arm)


# ------------------------------------------------------------------------------- the drive's own limits


def test_range_and_speed_are_given_to_the_drive_as_its_own_limits() -> None:
    joint = {"lower": -1.0, "upper": 0.5, "velocity": 1.0}
    with drives(1) as sim:
        with arm_of(arm_on(sim, 1, joint)):
            assert held(sim, 0x607D, 1) == pytest.approx(-COUNTS, abs=3)
            assert held(sim, 0x607D, 2) == pytest.approx(0.5 * COUNTS, abs=3)
            assert held(sim, 0x607F) == pytest.approx(1.2 * COUNTS, abs=3)
            assert held(sim, 0x6080) == pytest.approx(1.2 * 100 * 60 / (2 * math.pi), abs=1)
        with arm_of(arm_on(sim, 1, {**joint, "sign": -1, "lower": -0.9})):
            assert held(sim, 0x607D, 1) == pytest.approx(-0.5 * COUNTS, abs=3)
            assert held(sim, 0x607D, 2) == pytest.approx(0.9 * COUNTS, abs=3)


def test_limits_of_speed_are_never_raised_and_others_are_left_where_that_is_wanted() -> None:
    with drives(1) as sim:
        give(sim, 500, 0x6080)
        give(sim, 200_000, 0x607F)
        with arm_of(arm_on(sim, 1)) as arm:
            assert (held(sim, 0x6080), held(sim, 0x607F)) == (500, 200_000)
            assert "607Fh:00 max profile velocity is 200000" in notes(arm)
    with drives(1) as sim:
        before = [held(sim, index, sub) for index, sub in ((0x607D, 1), (0x607F, 0), (0x6080, 0))]
        with arm_of(arm_on(sim, 1, {"drive_limits": "keep"})):
            after = [
                held(sim, index, sub) for index, sub in ((0x607D, 1), (0x607F, 0), (0x6080, 0))
            ]
            assert after == before
        with arm_of(arm_on(sim, 1, {"parameters": {"607D:2": 123456}})):
            assert held(sim, 0x607D, 2) == 123456


def test_a_limit_that_a_drive_ignores_is_noted() -> None:
    with drives(1) as sim:
        sim.control.inject("ignored_writes", index=0x607D)
        with arm_of(arm_on(sim, 1)) as arm:
            assert "607Dh:01 min position limit" in notes(arm)
            arm.enable(LONG)


def test_limits_are_not_given_to_a_drive_that_counts_with_a_home_offset() -> None:
    with drives(1) as sim:
        give(sim, 1000, 0x607C)
        before = held(sim, 0x607D, 1)
        with arm_of(arm_on(sim, 1)) as arm:
            assert held(sim, 0x607D, 1) == before
            assert "it has a home offset (607Ch)" in notes(arm)


@pytest.mark.parametrize("moved", [False, True], ids=["when it is found", "before it is enabled"])
def test_a_joint_outside_of_its_range_does_not_move_when_it_gets_power(moved: bool) -> None:
    start = 0.0 if moved else 1.0
    joint = {"lower": -0.5, "upper": 0.5}
    with drives(1) as sim:
        with arm_of(arm_on(sim, 1)) as arm:
            arm.enable(LONG)
            arm.move_jp([start]).wait(LONG)
            arm.disable(LONG)
        config = arm_on(sim, 1, joint)
        with arm_of(config) as arm:
            if moved:  # by hand, as it seems to the drive: its counts change
                give(sim, int(held(sim, 0x608F, 1)), 0x608F, 1)
                device = device_of(arm)
                device.axes[0].limits = device.axes[0].limits._replace(greatest=-1000)  # type: ignore[union-attr]
                give(sim, -1000, 0x607D, 2)
            before = sim.control.status()["drives"]["1"]["axes"][0]["revolutions"]
            arm.enable(LONG)
            after = sim.control.status()["drives"]["1"]["axes"][0]["revolutions"]
            np.testing.assert_allclose(after, before, atol=0.05)


def test_a_homed_joint_has_its_limits_from_then_on() -> None:
    joint = {"lower": -1.0, "upper": 1.0, "homing": {"method": 37, "required": True}}
    with drives(1) as sim, arm_of(arm_on(sim, 1, joint)) as arm:
        assert held(sim, 0x607D, 2) == 2**31 - 1
        arm.enable(LONG)
        arm.home(LONG)
        assert held(sim, 0x607D, 2) == pytest.approx(COUNTS, abs=3)


def test_a_drive_that_does_not_watch_its_following_error_is_noted() -> None:
    with drives(1) as sim:
        give(sim, 0xFFFFFFFF, 0x6065)
        with arm_of(arm_on(sim, 1)) as arm:
            assert "6065h" in notes(arm)


# --------------------------------------------------------------------------------- ranges of the wire

BEYOND = {
    "upper": {"scale": 1e-9, "lower": -1.0, "upper": 3.0},
    "lower": {"counts_per_turn": 1e9, "gear": 100.0, "lower": -3.0},
    "velocity": {"velocity_scale": 1e-10},
    "effort": {"rated_torque": 0.001, "gear": 1.0, "effort": 50.0},
}


@pytest.mark.parametrize("key", BEYOND)
def test_limits_that_do_not_fit_the_integers_of_the_wire_are_refused_when_read(key: str) -> None:
    joint = {"node": 1, **JOINT, **BEYOND[key]}
    with pytest.raises(ConfigError, match=rf"joints\.a\.{key}.*too many for the drive"):
        PLUGIN.load_config({"joints": {"a": joint}}, {})


def test_limits_beyond_the_wire_by_what_the_drive_tells_are_refused_at_connect() -> None:
    with drives(1) as sim:
        give(sim, 1, 0x6076)  # mN·m
        refused(sim, "joints.joint_1.effort", {"effort": 20.0, "gear": 1.0})


def test_a_command_beyond_the_wire_is_refused_and_changes_nothing() -> None:
    with drives(1) as sim, arm_of(arm_on(sim, 1)) as arm:
        units = device_of(arm).link.units
        for counts in (units.position_counts, units.velocity_counts, units.effort_counts):
            for value in (math.nan, math.inf, -math.inf, 1e308):
                with pytest.raises(CommandRefused):
                    counts(np.array([value]))


# ------------------------------------------------------------------------------------- files, DCF

NEVER = (
    (0x6040, "0x000F"), (0x6060, "8"), (0x607A, "100000"), (0x60FF, "5000"), (0x6071, "500"),
    (0x60B0, "1000"), (0x60B1, "1000"), (0x60B2, "100"), (0x60FE, "1"),
)  # fmt: skip


def dcf_of(sim: RunningSim, path: Path, values: dict[tuple[int, int], str]) -> Path:
    """Write the DCF of a drive: its own EDS with values."""
    lines = []
    for line in sim.control.call("eds", node=1).splitlines():
        lines.append(line)
        for (index, sub), value in values.items():
            section = f"[{index:04X}sub{sub:X}]" if sub else f"[{index:04X}]"
            if line.lower() == section.lower():
                lines.append(f"ParameterValue={value}")
    path.write_text("\n".join(lines))
    return path


def test_a_dcf_writes_nothing_that_moves_or_powers(tmp_path: Path) -> None:
    with drives(1) as sim:
        values = {(index, 1 if index == 0x60FE else 0): value for index, value in NEVER}
        values |= {(0x1010, 1): "0x65766173", (0x1011, 1): "0x64616F6C", (0x6067, 0): "321"}
        values |= {(0x60C1, 1): "777"}
        dcf = dcf_of(sim, tmp_path / "drive.dcf", values)
        joint = {"eds": str(dcf), "modes": ("csp", "csv", "cst")}
        before = [held(sim, index, sub) for index, sub in values if index != 0x6067]
        give(sim, 0, 0x2010, 1)
        with arm_of(arm_on(sim, 1, joint)) as arm:
            assert held(sim, 0x6067) == 321
            kept = {(0x6060, 0), (0x6040, 0), (0x607A, 0)}  # our own PDOs write these
            for (index, sub), old in zip(
                [k for k in values if k[0] != 0x6067], before, strict=True
            ):
                if (index, sub) not in kept:
                    assert held(sim, index, sub) == old, hex(index)
            told = notes(arm)
            for index, _ in NEVER:
                assert f"{index:04X}h" in told, hex(index)


@pytest.mark.parametrize("name", ["6040", "target_position", "60FF", "6071:0", "6860", "1010:1"])
def test_parameters_that_move_or_power_are_refused_when_the_configuration_is_read(
    name: str,
) -> None:
    joint = {"node": 1, **JOINT, "parameters": {name: 15}}
    with pytest.raises(ConfigError, match="moves or powers"):
        PLUGIN.load_config({"joints": {"a": joint}}, {})


# --------------------------------------------------------------------------------- nodes that are silent


@pytest.mark.sweep(2)
@pytest.mark.parametrize("timeout", [2.0, 10.0])
def test_a_silent_node_is_named_in_time_and_closing_does_not_wait_for_it(timeout: float) -> None:
    with drives(1) as sim:
        sim.control.inject("no_sdo")
        arm = LocalDevice(Session(PLUGIN, arm_on(sim, 1, sdo_timeout=timeout, open_timeout=3.0)))
        try:
            arm._session.start()

            def is_named() -> bool:
                detail = arm.operating_state().detail
                return "node 1" in detail and "no answer" in detail

            eventually(is_named, "it is named")
            eventually(
                lambda: sim.control.status()["drives"]["1"]["nmt"] == "pre_operational", "again"
            )
        finally:
            arm.close()


def test_a_drive_that_tells_of_no_mode_is_refused_in_words() -> None:
    with drives(1, modes="hm") as sim:
        give(sim, 0, 0x6502)
        refused(sim, "no mode at all (6502h is 0x0)")
