"""A command is carried out when it comes if the hardware's tick can still take it, and none twice in one."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from crtk_drivers.engine import EngineOptions
from crtk_drivers.errors import CommandRefused, ConnectionLost
from crtk_drivers.samples import Sample
from crtk_drivers.state import OperatingState
from rigs.scripted_engine import LONG_STEPS, PERIOD, Rig, ScriptedDevice, jp, jv

SOON = 0.2 * PERIOD
"""Seconds within a tick."""


class WakingDevice(ScriptedDevice):
    """Its `read` can be woken: that of a test in which no sample has come is."""

    asleep = True
    wakes = 0

    def wake(self) -> bool:
        self.wakes += 1
        return True

    def read(self, deadline: float) -> Sample | None:
        return super().read(deadline) if self.asleep else None


class WakingRig(Rig):
    """A rig on such a device, with a stream of servo_jp begun."""

    device: WakingDevice

    def __init__(self, options: EngineOptions = LONG_STEPS) -> None:
        super().__init__(options)
        self.device.__class__ = WakingDevice

    def streaming(self) -> WakingRig:
        self.enabled()
        self.servo(0.001, 0.0)
        self.cycle()
        self.cycle()
        return self

    def held(self) -> WakingRig:
        """Enabled, and its device known to be one that can be woken."""
        self.enabled()
        self.engine.submit("hold")
        self.woken()
        self.cycle(2)
        assert self.device.wakes == 1
        return self

    def woken(self, after: float = SOON) -> None:
        """Do what the I/O thread does when the reading was ended."""
        self.clock.advance(after)
        self.device.asleep = False
        self.engine.cycle(self.clock() + PERIOD)
        self.device.asleep = True

    @property
    def sent(self) -> list[list[float]]:
        return [setpoint.values.tolist() for setpoint in self.written]


def test_the_next_setpoint_of_a_stream_goes_out_between_two_samples() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    assert rig.device.wakes == 1
    rig.woken()
    assert rig.sent[-1] == [0.002, 0.0]
    count = len(rig.sent)
    rig.cycle()
    assert len(rig.sent) == count, "it was sent again with the sample"


def test_a_second_one_waits_for_the_next_tick() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.woken()
    rig.servo(0.003, 0.0)
    assert rig.device.wakes == 1
    rig.woken()
    assert rig.sent[-1] == [0.002, 0.0]
    rig.cycle()
    assert rig.sent[-1] == [0.003, 0.0]


def test_what_a_cycle_sent_for_its_tick_is_not_followed_by_another() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.cycle()
    rig.servo(0.003, 0.0)
    rig.woken()
    assert rig.sent[-1] == [0.002, 0.0]
    assert rig.device.wakes == 1


def test_the_first_setpoint_of_a_stream_waits_for_its_cycle() -> None:
    rig = WakingRig().held()
    rig.servo(0.001, 0.0)
    assert rig.device.wakes == 1
    rig.woken()
    assert rig.sent == []
    rig.cycle()
    assert rig.sent == [[0.001, 0.0]]


@pytest.mark.parametrize("begin", [lambda rig: rig.enabled(), lambda rig: rig.streaming()])
def test_a_stop_does_not_wait(begin: Any) -> None:
    rig = WakingRig()
    begin(rig)
    rig.engine.submit("hold")
    assert rig.device.wakes == 1
    stops = rig.device.calls.count("stop")
    rig.woken()
    assert rig.device.calls.count("stop") == stops + 1


def test_a_stop_goes_out_in_a_tick_that_has_had_its_setpoint_but_only_once() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.woken()
    stops = rig.device.calls.count("stop")
    for _ in range(5):
        rig.engine.submit("hold")
        rig.woken(0.01 * PERIOD)
    assert rig.device.calls.count("stop") == stops + 1
    rig.cycle()
    assert rig.device.calls.count("stop") == stops + 2


def test_a_flood_of_commands_does_not_hide_that_no_sample_comes() -> None:
    rig = WakingRig().streaming()

    def flood() -> None:
        for number in range(10_000):
            rig.servo(0.001 + 1e-6 * (number % 2), 0.0)
            rig.woken(0.05 * PERIOD)

    with pytest.raises(ConnectionLost, match="the newest sample is"):
        flood()
    most = 2 + rig.engine.options.sample_timeout / (2.0 * PERIOD)
    assert len(rig.sent) <= most + 1, "one in each whole cycle, of which two periods have one"


def test_between_two_samples_nothing_else_goes_on() -> None:
    rig = WakingRig().held()
    rig.engine.submit("move_jp", jp(0.3, 0.3))
    rig.cycle(3)
    before, cycles = len(rig.sent), rig.engine.health().cycles
    rig.woken()
    assert (len(rig.sent), rig.engine.health().cycles) == (before, cycles)


def test_a_device_that_is_not_enabled_is_sent_nothing_early() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.engine.alarm("the I/O thread is stuck")
    rig.woken()
    assert rig.sent[-1] == [0.001, 0.0]
    assert rig.state is OperatingState.FAULT


def test_nothing_is_sent_early_once_the_device_is_to_leave_its_state() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.engine.state_command("disable")
    rig.woken()
    assert rig.sent[-1] == [0.001, 0.0]


def test_a_sample_that_cannot_be_used_is_no_reason_to_hurry() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.002, 0.0)
    rig.woken()
    cycles = rig.engine.health().cycles
    rig.device.position = np.array([np.nan, 0.0])
    rig.cycle()
    assert rig.engine.health().cycles == cycles + 1


def test_where_a_reading_cannot_be_woken_a_cycle_without_a_sample_is_a_whole_one() -> None:
    rig = Rig().enabled()
    rig.device.silent = True
    cycles = rig.engine.health().cycles
    rig.servo(0.001, 0.0)
    rig.cycle()
    assert [setpoint.values.tolist() for setpoint in rig.written] == [[0.001, 0.0]]
    assert rig.engine.health().cycles == cycles + 1


def test_a_stream_ends_in_time_whatever_lets_its_readings_end_early() -> None:
    """A wrapper may keep samples back, so that a reading brings nothing before its deadline."""
    rig = WakingRig(EngineOptions(stream_timeout=0.1)).held()
    rig.engine.submit("servo_jv", jv(0.5, 0.0))
    rig.cycle(2)
    rig.device.silent = True
    stops, begin = rig.device.calls.count("stop"), rig.clock()
    while rig.device.calls.count("stop") == stops:
        rig.cycle()
    assert rig.clock() - begin < 0.1 + 3.0 * PERIOD


def test_what_is_refused_early_takes_the_place_of_its_tick() -> None:
    rig = WakingRig().streaming()
    rig.servo(0.09, 0.0)
    rig.woken()
    rig.cycle()
    wakes = rig.device.wakes
    for _ in range(50):  # each passes alone, and is too fast behind that
        rig.servo(0.0, 0.0)
        rig.woken(0.001 * PERIOD)
    assert rig.device.wakes == wakes + 1
    assert len(rig.told.refusals) == 1


@pytest.mark.parametrize("late", [0.3, 0.45, 0.5, 0.6, 0.9, 0.97])
def test_a_move_goes_on_with_the_speed_of_a_stream_whose_packets_came_late_and_early(
    late: float,
) -> None:
    speed, rig = 0.5, WakingRig().streaming()
    position = 0.001

    def command() -> None:
        nonlocal position
        position += speed * PERIOD
        rig.servo(position, 0.0)

    for _ in range(20):
        command()
        rig.woken(0.5 * PERIOD)
        rig.cycle(period=0.5 * PERIOD)
    rig.cycle()  # the packet of this tick comes in the next one
    rig.clock.advance(late * PERIOD)
    command()
    rig.woken(0.0)
    rig.clock.advance(0.01 * PERIOD)
    command()
    rig.cycle(period=(0.99 - late) * PERIOD)
    rig.engine.submit("move_jp", jp(0.9, 0.0))
    count = len(rig.sent)
    rig.cycle(3)
    first, second = rig.sent[count - 1][0], rig.sent[count][0]
    assert (second - first) / PERIOD == pytest.approx(speed, abs=0.2)


def test_velocities_are_early_too() -> None:
    rig = WakingRig().enabled()
    rig.engine.submit("servo_jv", jv(0.1, 0.0))
    rig.cycle(2)
    rig.engine.submit("servo_jv", jv(0.2, 0.0))
    rig.woken()
    assert rig.sent[-1] == [0.2, 0.0]


def test_early_setpoints_earn_no_speed() -> None:
    """However they are spread over the ticks, positions follow at the velocity limit and no faster."""
    rng = np.random.default_rng(5)
    rig = WakingRig().streaming()
    begin, start, target = rig.clock(), 0.001, 0.001
    furthest = 0.0
    for _ in range(400):
        target += 0.012
        with suppress(CommandRefused):
            rig.servo(min(target, 0.9), 0.0)
        rig.woken(float(rng.uniform(0.0, 0.9)) * PERIOD)
        rig.cycle(period=float(rng.uniform(0.1, 1.0)) * PERIOD)
        target = rig.sent[-1][0]
        gone, elapsed = rig.sent[-1][0] - start, rig.clock() - begin
        furthest = max(furthest, gone - 1.01 * elapsed)
    assert furthest <= 0.1 + 1e-9, "more than the limits' largest step ahead of full speed"
