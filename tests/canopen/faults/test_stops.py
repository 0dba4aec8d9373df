"""Whatever moves can be stopped: close, homing, drives that do not hear us; and what was found is told."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest

from crtk_drivers.engine import threads
from crtk_drivers.errors import CommandRefused, StopUnconfirmed
from crtk_drivers.front import LocalDevice
from crtk_sim_backends.process import RunningSim
from rigs.beside import beside
from rigs.canopen_arm import (
    PERIOD,
    TIMEOUT,
    arm_of,
    arm_on,
    device_of,
    drives,
    patient_arm_on,
    wait_for_sync,
)
from rigs.waiting import LONG, eventually

COUNT = 2
MOVING = 1e4
"""Counts a second above which a simulated motor moves."""

SETPOINTS = {"servo_jv": 0.5, "servo_jf": 3.0}


def told(sim: RunningSim) -> list[dict[str, Any]]:
    """What the drives say past the bus."""
    found = sim.control.status()["drives"]
    return [found[str(node)]["axes"][0] for node in sorted(map(int, found))]


def moves(sim: RunningSim, command: str, arm: LocalDevice) -> Callable[[], bool]:
    """Send a stream for as long as it is asked; return whether all joints move."""

    def sent() -> bool:
        with suppress(CommandRefused):
            if command != "move_jp":
                getattr(arm, command)([SETPOINTS[command]] * COUNT)
        return min(abs(drive["velocity"]) for drive in told(sim)) > MOVING

    return sent


@contextmanager
def going_on(sim: RunningSim, command: str, arm: LocalDevice) -> Iterator[None]:
    """Have all joints move, and the stream go on until the end."""
    sending = moves(sim, command, arm)
    eventually(sending, "it moves")

    def send(over: threading.Event) -> None:
        while not over.wait(PERIOD):
            sending()

    with beside(send):
        yield


def stand(sim: RunningSim) -> bool:
    return all(abs(drive["velocity"]) < 1.0 for drive in told(sim))


def powered(sim: RunningSim) -> list[bool]:
    return [drive["powered"] for drive in told(sim)]


def in_its_thread(arm: LocalDevice, action: Callable[[], None]) -> None:
    """Have something done once by the I/O thread."""
    done = threading.Event()

    def once() -> None:
        if not done.is_set():
            action()
            done.set()

    arm.engine.on_sample = once
    assert done.wait(LONG)


# ------------------------------------------------------------------------------ before it has begun


def test_no_move_begins_after_a_pause_that_came_while_it_was_being_enabled() -> None:
    with drives(COUNT) as sim, arm_of(patient_arm_on(sim, COUNT)) as arm:
        engine = arm.engine
        engine.state_command("enable")
        move = arm.move_jp([0.5] * COUNT)
        with pytest.raises(CommandRefused, match="enable is running"):
            engine.state_command("pause")
        eventually(arm.is_enabled, "it is enabled")
        cycles = device_of(arm).link.counters.cycles
        eventually(
            lambda: device_of(arm).link.counters.cycles > cycles + 10, "a move would have begun"
        )
        assert not move.is_busy()
        assert stand(sim)


# -------------------------------------------------------------------------------------------- close


@pytest.mark.sweep(3)
@pytest.mark.parametrize("command", ["move_jp", "servo_jv", "servo_jf"])
@pytest.mark.parametrize("on_close", ["hold", "power_off"])
def test_close_in_motion_stops_before_the_drives_are_left(command: str, on_close: str) -> None:
    with drives(COUNT) as sim:
        with arm_of(arm_on(sim, COUNT, on_close=on_close)) as arm:
            arm.enable(LONG)
            if command == "move_jp":
                arm.move_jp([2.0] * COUNT)
            eventually(moves(sim, command, arm), "it moves")
            closing = threading.Thread(target=arm.close)
            closing.start()
            while closing.is_alive():
                for drive in told(sim):
                    assert drive["powered"] or abs(drive["velocity"]) < MOVING, "it coasts"
        holds = on_close == "hold"
        assert powered(sim) == [holds] * COUNT
        eventually(lambda: stand(sim), "all stand")
        before = [drive["revolutions"] for drive in told(sim)]
        time.sleep(TIMEOUT + 0.2)  # longer than the drives wait for a heartbeat, an RPDO and a SYNC
        assert powered(sim) == [holds] * COUNT
        np.testing.assert_allclose([drive["revolutions"] for drive in told(sim)], before, atol=0.05)


def test_drives_that_were_left_holding_go_on_holding_when_they_are_found_again() -> None:
    with drives(COUNT) as sim:
        config = arm_on(sim, COUNT, on_close="hold")
        with arm_of(config) as arm:
            arm.enable(LONG)
            arm.move_jp([0.3] * COUNT).wait(LONG)
        before = [drive["revolutions"] for drive in told(sim)]
        with arm_of(config) as arm:
            assert arm.operating_state().state == "DISABLED"
            assert "joint_1 (node 1) has power" in arm.operating_state().detail
            assert powered(sim) == [True] * COUNT
            after = [drive["revolutions"] for drive in told(sim)]
            np.testing.assert_allclose(after, before, atol=0.05)
            arm.enable(LONG)
            after = [drive["revolutions"] for drive in told(sim)]
            np.testing.assert_allclose(after, before, atol=0.05)
            arm.move_jp([0.35] * COUNT).wait(LONG)
            arm.disable(LONG)
            assert powered(sim) == [False] * COUNT


def test_drives_that_are_found_in_motion_are_stopped_before_their_power_is_taken() -> None:
    with drives(COUNT) as sim:
        call = sim.control.call
        with arm_of(arm_on(sim, COUNT)) as arm:
            arm.enable(LONG)
            for node in range(1, COUNT + 1):  # nothing stops them when we are gone
                call("object", node=node, index=0x6007, value=0)
                call("object", node=node, index=0x1029, sub=1, value=1)
                call("object", node=node, index=0x2010, sub=1, value=0)
            with going_on(sim, "servo_jv", arm):
                fast = 20 * MOVING  # so that they move, whatever counts as that
                eventually(
                    lambda: min(drive["velocity"] for drive in told(sim)) > fast, "it is fast"
                )
                in_its_thread(arm, lambda: device_of(arm).link.link.close())
            eventually(lambda: "had power" in arm.operating_state().detail, "it says so")
            assert "joint_1 (node 1) had power and moved" in arm.operating_state().detail
        assert powered(sim) == [False] * COUNT


# ------------------------------------------------------------------------------------------- homing

HOMED = {"homing": {"method": 24, "speed_switch": 0.3, "speed_zero": 0.1, "required": True}}


def test_a_stop_in_homing_halts_it_and_is_confirmed_when_the_joints_stand() -> None:
    with drives(1) as sim, arm_of(arm_on(sim, 1, {**HOMED, "gear": 10.0})) as arm:
        arm.enable(LONG)
        arm.state_command("home", 0.0)
        eventually(lambda: abs(told(sim)[0]["velocity"]) > MOVING, "it homes")
        device = device_of(arm)
        in_its_thread(arm, device.stop)
        eventually(lambda: device.has_stopped, "it is confirmed")
        assert abs(told(sim)[0]["velocity"]) < MOVING
        eventually(lambda: stand(sim), "it stands")
        assert not arm.is_homed()
        eventually(lambda: arm.operating_state().state == "FAULT", "homing has failed")
        assert "stopped" in arm.operating_state().detail


# ---------------------------------------------------------------------------- drives that hear nothing


@pytest.mark.sweep(3)
@pytest.mark.parametrize("command", ["move_jp", "servo_jv", "servo_jf"])
@pytest.mark.parametrize("watches", [True, False], ids=["watches its RPDOs", "does not"])
def test_a_drive_that_gets_no_pdos_any_more_is_stopped_by_another_way(
    command: str, watches: bool
) -> None:
    with drives(COUNT) as sim:
        if not watches:
            for sub in range(4):
                sim.control.inject("sdo_abort", node=2, index=0x1400 + sub, sub=5, code=0x06090011)
        with arm_of(arm_on(sim, COUNT, {"following_error": 0.2})) as arm:
            arm.enable(LONG)
            if command == "move_jp":
                arm.move_jp([2.0] * COUNT)
            eventually(moves(sim, command, arm), "it moves")
            sim.control.inject("drop", id=0x202)
            sim.control.inject("drop", id=0x302)
            if not watches and command != "move_jp":
                with suppress(CommandRefused):
                    arm.hold()
            eventually(lambda: arm.operating_state().state == "FAULT", "it is in FAULT")
            reasons = [
                "joint_2 does not follow",
                "joint_2 (node 2) moves although it was told to stop",
            ]
            reasons += (
                ["node 2 does not get our PDOs"]
                if watches
                else ["joint_2 (node 2): it still shows"]
            )
            assert any(reason in arm.operating_state().detail for reason in reasons)
            eventually(lambda: device_of(arm).has_stopped and stand(sim), "all stand")
            sim.control.clear("drop")
            before = [drive["revolutions"] for drive in told(sim)]
            time.sleep(20 * PERIOD)
            after = [drive["revolutions"] for drive in told(sim)]
            np.testing.assert_allclose(after, before, atol=0.1)


# ------------------------------------------------------------------------ drives that are not heard


@pytest.mark.parametrize("command", SETPOINTS)
def test_a_drive_that_is_not_heard_does_not_jump_back_to_where_it_was_heard_last(
    command: str,
) -> None:
    """Its own mode for positions would take it there; the fault comes later than the stop here."""
    with drives(COUNT) as sim, arm_of(arm_on(sim, COUNT, missed_cycles=40)) as arm:
        arm.enable(LONG)
        sending = moves(sim, command, arm)
        eventually(sending, "it moves")
        sim.control.inject("no_tpdo", node=1)
        farthest = -np.inf

        def stands() -> bool:
            nonlocal farthest
            if arm.is_enabled() and device_of(arm).link.cycle.ages[0] < 20:
                sending()
            elif arm.is_enabled():
                arm.hold()
            here = told(sim)[0]["revolutions"]
            farthest = max(farthest, here)
            assert here > farthest - 0.1, "it goes back"
            return not arm.is_enabled() and stand(sim)

        eventually(stands, "it is in FAULT, and all stand")
        sim.control.clear()
        eventually(lambda: device_of(arm).has_stopped, "it is read back")


def test_torques_end_with_the_first_sync_after_a_stop() -> None:
    with drives(COUNT) as sim, arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        eventually(moves(sim, "servo_jf", arm), "it moves")
        device = device_of(arm)
        sent: list[list[int]] = []

        def stop() -> None:
            device.stop()
            sent.append(list(device.link.outputs.torque))

        in_its_thread(arm, stop)
        assert sent == [[0] * COUNT]


# --------------------------------------------------------------------------------- a stuck I/O thread


@pytest.mark.parametrize("command", ["move_jp", "servo_jv", "servo_jf"])
def test_a_stuck_io_thread_does_not_keep_the_drives_from_being_stopped(
    command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the watchdog's own write can stop them here: no heartbeat, no SYNC, no RPDO is watched."""
    monkeypatch.setattr(threads, "STALL_LIMIT", 1.5)
    keys = {"heartbeat": {"ours": 0.0, "ours_timeout": 0.0, "drives_timeout": 0.5}}
    with drives(COUNT) as sim:
        for node in range(1, COUNT + 1):
            wait_for_sync(sim, node, 0.0)
        go_on = threading.Event()
        with arm_of(arm_on(sim, COUNT, **keys)) as arm:
            arm.enable(LONG)
            if command == "move_jp":
                arm.move_jp([2.0] * COUNT)
            eventually(moves(sim, command, arm), "it moves")
            arm.engine.on_sample = lambda: go_on.wait(LONG)
            eventually(lambda: arm.operating_state().state == "FAULT", "the watchdog has seen it")
            eventually(lambda: stand(sim), "all stand")
            assert not go_on.is_set()
            before = [drive["revolutions"] for drive in told(sim)]
            arm.engine.on_sample = None
            go_on.set()
            samples = arm.engine.health().samples
            eventually(lambda: arm.engine.health().samples > samples + 20, "it goes on")
            after = [drive["revolutions"] for drive in told(sim)]
            np.testing.assert_allclose(after, before, atol=0.05)
            assert powered(sim) == [False] * COUNT
            arm.enable(LONG)


@pytest.mark.parametrize("on_close", ["hold", "power_off"])
def test_close_with_a_silent_drive_says_so_in_time_and_leaves_the_watch_armed(
    on_close: str,
) -> None:
    with drives(COUNT) as sim, arm_of(arm_on(sim, COUNT, on_close=on_close)) as arm:
        arm.enable(LONG)
        eventually(moves(sim, "servo_jv", arm), "it moves")
        sim.control.inject("silent", node=2)
        with pytest.raises(StopUnconfirmed):
            arm.close()
        eventually(
            lambda: stand(sim) and powered(sim) == [False] * COUNT, "they stop by themselves"
        )


def test_close_says_why_a_stop_cannot_be_seen() -> None:
    with drives(COUNT) as sim, arm_of(arm_on(sim, COUNT)) as arm:
        arm.enable(LONG)
        sim.control.inject("reset", node=2)
        eventually(lambda: arm.operating_state().state == "FAULT", "it is told")
        with pytest.raises(StopUnconfirmed, match="node 2 has started anew"):
            arm.close()
        eventually(lambda: stand(sim) and powered(sim) == [False] * COUNT, "they have no power")
