"""The register map of the ePick, its faults, and what is made of its status over time."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_robotiq.epick.faults import fault_of
from crtk_driver_robotiq.epick.registers import (
    RELEASE,
    Command,
    Detected,
    EpickRegisters,
    Status,
    Valve,
    level,
)
from crtk_driver_robotiq.epick.suction import Suction
from crtk_drivers.errors import ConfigError
from crtk_drivers.kit import modbus_frames
from crtk_drivers.kit.gripping import HELD, Doing, Weight

GRIP = Command(advanced=True, go=True, pressure=40, timeout=30, minimum=50)
LET_GO = Command(advanced=True, go=True, pressure=RELEASE, timeout=10, minimum=100)


def status(
    detected: Detected = Detected.UNKNOWN,
    *,
    pressure: int = 100,
    requested: int = 40,
    valve: Valve = Valve.GRIPS,
    ready: bool = True,
    goes: bool = True,
    fault: int = 0,
) -> Status:
    return Status(True, True, goes, ready, detected, valve, fault, requested, pressure)


@pytest.mark.parametrize(
    ("command", "frame"),
    [
        # That with which the driver of PickNik activates it, and as that grips and lets go.
        (
            Command(go=True, pressure=100, timeout=20, minimum=100),
            "0910 03E8 0003 06 0900 0064 1464 3C9D",
        ),
        (Command(activate=False), "0910 03E8 0003 06 0000 0000 0000 7330"),
        (Command(), "0910 03E8 0003 06 0100 0000 0000 72E1"),
    ],
)
def test_frames_that_others_send(command: Command, frame: str) -> None:
    asked = modbus_frames.Rtu(9).ask(EpickRegisters().write(command))
    assert asked == bytes.fromhex(frame.replace(" ", ""))


def test_the_blocks_of_a_grip_and_of_a_release() -> None:
    assert GRIP.block == bytes((0x0B, 0, 0, 40, 30, 50))
    assert LET_GO.block == bytes((0x0B, 0, 0, 255, 10, 100))


def test_what_a_status_says() -> None:
    told = Status.parse(bytes((0b10111011, 0x01, 0x03, 40, 42, 0)))
    assert told == status(Detected.AT_MAXIMUM, pressure=42, fault=3)
    assert told.vacuum == pytest.approx(58_000.0)
    assert Status.parse(bytes((0, 0, 0, 0, 120, 0))).vacuum == 0.0


@given(st.binary(max_size=12))
def test_a_status_is_six_bytes(block: bytes) -> None:
    if len(block) == 6:
        assert 0.0 <= Status.parse(block).vacuum <= 100_000.0
    else:
        with pytest.raises(ValueError, match="values to unpack"):
            Status.parse(block)


@pytest.mark.parametrize(
    ("vacuum", "pressure"), [(0.0, 100), (60_000.0, 40), (100_000.0, 0), (2e5, 0), (-5.0, 100)]
)
def test_a_vacuum_is_sent_as_absolute_pressure(vacuum: float, pressure: int) -> None:
    assert level(vacuum) == pressure


def test_the_answer_to_a_probe_is_like_none_of_the_others() -> None:
    registers = EpickRegisters()
    probes = [registers.probe(turn) for turn in range(4)]
    asked = [registers.read(), registers.variant(registers.read()), registers.write(GRIP), *probes]
    assert len({(question.head, question.size) for question in asked}) == len(asked)
    for question in asked[2:]:
        reply = question.head + bytes(question.size - len(question.head))
        assert registers.status(question, reply) is None


def test_faults_have_a_weight() -> None:
    assert fault_of(status()) is None
    weights = {code: fault_of(status(fault=code)) for code in (3, 6, 7, 8, 0xA, 0xD)}
    assert [fault.weight for fault in weights.values() if fault] == [
        Weight.PASSES,
        Weight.PASSES,
        Weight.INACTIVE,
        Weight.STOPS,
        Weight.RESET,
        Weight.STOPS,
    ]


def test_a_grip_and_its_loss() -> None:
    suction = Suction()
    suction.delivered(GRIP, 0.0)
    for at, told, doing in (
        (0.01, status(Detected.NONE, requested=255), Doing.EVACUATING),  # not yet of ours
        (0.02, status(Detected.NONE), Doing.EVACUATING),  # gOBJ of the request before
        (0.03, status(), Doing.EVACUATING),
        (0.20, status(Detected.AT_MINIMUM), Doing.HOLDS_WEAKLY),
        (0.30, status(Detected.AT_MAXIMUM), Doing.HOLDS),
        (9.00, status(Detected.NONE), Doing.LOST),
        (9.10, status(Detected.NONE), Doing.LOST),
    ):
        suction.see(told, at)
        assert suction.doing is doing
        assert (suction.doing in HELD) is doing.startswith("holds")


def test_nothing_found_is_no_loss() -> None:
    suction = Suction()
    suction.delivered(GRIP, 0.0)
    suction.see(status(), 0.01)
    suction.see(status(Detected.NONE, fault=6), 3.0)
    assert suction.doing is Doing.NOTHING


def test_letting_go_ends_when_the_valve_is_shut() -> None:
    suction = Suction()
    suction.delivered(LET_GO, 0.0)
    suction.see(status(requested=255, valve=Valve.ACTIVE_RELEASE), 0.1)
    assert suction.doing is Doing.RELEASING
    suction.see(status(Detected.NONE, requested=255, valve=Valve.STANDBY), 0.6)
    assert suction.doing is Doing.FREE


def test_one_that_is_reset_behind_our_back_holds_nothing_for_sure() -> None:
    suction = Suction()
    suction.delivered(GRIP, 0.0)
    suction.see(status(), 0.1)
    suction.see(status(Detected.AT_MAXIMUM), 0.2)
    suction.see(status(ready=False, goes=False, requested=0), 0.3)
    assert suction.doing is Doing.INACTIVE
    assert suction.doing not in HELD


def test_another_master_is_noticed() -> None:
    suction = Suction()
    suction.delivered(GRIP, 0.0)
    suction.see(status(), 0.1)
    suction.see(status(requested=255), 0.2)
    assert not suction.echo.taken_over
    suction.see(status(requested=255), 0.5)
    assert suction.echo.taken_over
    suction.echo.adopt()
    suction.see(status(requested=255, valve=Valve.STANDBY), 0.6)
    assert not suction.echo.taken_over
    assert suction.doing is Doing.FREE


def test_a_hysteresis_beyond_the_vacuum_is_refused() -> None:
    from crtk_driver_robotiq.epick.config import EpickConfig
    from crtk_drivers.config import from_values, load

    with pytest.raises(ConfigError, match="must be below most"):
        load(EpickConfig, from_values({"most": 20_000.0, "hysteresis": 30_000.0}))
