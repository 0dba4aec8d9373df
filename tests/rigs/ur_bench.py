"""A UR driver in this process against a simulated controller in its own, and what tests ask of both."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from crtk_driver_ur import PLUGIN, abilities, device, robot
from crtk_driver_ur.config import UrConfig
from crtk_driver_ur.library import supervisor
from crtk_driver_ur.native import link, registers
from crtk_drivers.config import from_values, load
from crtk_drivers.engine import Observer, threads
from crtk_drivers.errors import CommandRefused
from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.state import OperatingState, Status
from crtk_sim_backends.ur import SIM, RunningSim
from rigs import ur_watchdog
from rigs.waiting import LONG, eventually

LATE_STATE = 0.5
"""Seconds for which a controller may be silent, as its driver closes, before that counts as dead."""

LENIENT = 2.0
"""Seconds for which a thread or a process may get no time on a busy machine before it counts as stuck."""

FAR_BEHIND = 4.0
"""rad by which a joint may be late beyond its lag, on a machine that takes the simulated time away."""

LOCKED = 0.5
"""Seconds for which a protective stop is locked. A real controller has 5, which few tests wait for."""

BRISK = {"power_seconds": 0.1, "lock_seconds": LOCKED}
"""Options of a simulated controller that keeps nobody waiting."""

UNLOCK_AFTER = LOCKED + 0.1
"""Seconds after which the driver unlocks a protective stop of it."""

PATIENT = {
    "frequency": 125.0,
    "sample_timeout": 3.0,
    "watchdog_frequency": 2.0,
    "open_timeout": 10.0,
    "move": {"joint_velocity": 2.0, "joint_acceleration": 20.0},
    "servo": {"lookahead": 0.05},
}
"""Configuration in which a busy machine is no fault, and moves are quick: half the lookahead has an arm that
is streamed at its goal a quarter of a second earlier. A driver with 125 samples a second takes less than half
the processor of one with 500, which `test_contract.py` and `test_rtde_stream.py` have."""

QUICK_WATCHDOG = 1.0
"""Hz, in place of `rigs.ur_watchdog.FREQUENCY`, where it is the controller's watchdog that stops the arm."""

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
"""Where the simulated arm starts, rad."""

FAR = (5.5, *HOME[1:])
"""Where an arm is not before two and a half seconds, rad: what ends its move may be late by two."""

WAYS = ("ur_rtde", "native")
"""Who carries commands out: values of the option `control`."""

PROTECTIVE_STOP = 3
"""Value of `safety_mode`."""

IDLE_CODES = frozenset({0, 35})
"""Values of ur-rtde's command register that ask for nothing: none, and the watchdog being set."""

SEQUENCES = ("input_int_register_1", "input_int_register_25")
"""Registers that our own control program's commands have, and what only feeds its watchdog has not."""


class Log(Observer):
    """Everything that the driver told, in order."""

    def __init__(self) -> None:
        self.statuses: list[Status] = []
        self.stamps: list[int] = []
        self.refusals: list[CommandRefused] = []
        self.warnings: list[str] = []

    def status_changed(self, status, stamp) -> None:
        self.statuses.append(status)
        self.stamps.append(stamp.wall_ns)

    def command_refused(self, refusal) -> None:
        self.refusals.append(refusal)

    def warned(self, text) -> None:
        self.warnings.append(text)

    @property
    def states(self) -> list[str]:
        """The operating states, without repetition."""
        states: list[str] = []
        for status in self.statuses:
            if not states or states[-1] != status.state:
                states.append(str(status.state))
        return states


class UrBench:
    """The two of them."""

    def __init__(self, sim: RunningSim, session: Session, control: str) -> None:
        self.sim = sim
        self.control = control
        self.session = session
        self.engine = session.engine
        self.device: Any = session.engine.device
        self.arm: Any = LocalDevice(session)
        self.log = Log()
        self.engine.add_observer(self.log)
        self._control_pid = 0

    # The driver

    @property
    def status(self) -> Status:
        return self.engine.status

    @property
    def child(self) -> int:
        """Process id of the control process."""
        return int(self.device._link.process.status.pid)

    def until_connected(self) -> None:
        eventually(lambda: self.engine.connected and self.engine.has_sample, "connected")

    def until_state(self, state: str, detail: str = "") -> Status:
        def reached() -> Status | None:
            status = self.engine.status
            return status if status.state == state and detail in status.detail else None

        try:
            found: Status = eventually(reached, state)
        except pytest.fail.Exception:
            pytest.fail(f"never {state} ({detail}): {self.engine.status}; {self.log.states}")
        return found

    def enable(self) -> None:
        """Enable, whatever was before; what was done at the controller until now is seen."""
        if self.engine.connected:
            self.cycles(2)  # the first of these may have been on its way
        if self.status.state == OperatingState.PAUSED:
            self.arm.resume(timeout=LONG)
        self.arm.enable(timeout=LONG)

    def reset(self) -> None:
        """No fault, ENABLED, at rest, at HOME, and nothing said yet."""
        self.sim.control.clear()
        self.until_connected()
        self.cycles(2)  # in which what the test before did is seen
        self.until_outputs(robot_mode=(3, 7))
        if self.outputs("safety_mode") == PROTECTIVE_STOP:
            self.arm.unlock_protective_stop(timeout=LONG)
        if self.status.state != OperatingState.ENABLED:
            self.enable()
        self.arm.hold()
        self.go_home()
        self.log.__init__()  # type: ignore[misc]

    def is_home(self) -> bool:
        return bool(np.allclose(self.q(), HOME, rtol=0.0, atol=1e-4))

    def go_home(self) -> None:
        if not self.is_home():
            assert self.arm.move_jp(HOME).wait(LONG)
            eventually(self.is_home, "home")
        self.arm.hold()  # or its last setpoint goes on being held
        self.cycles(3)  # in which that is carried out
        eventually(lambda: self.device.takes_setpoints, "it has stopped")
        self.until_still()
        if not self.is_home():  # it was about to move, which could not be seen yet
            self.go_home()

    # The arm

    def outputs(self, name: str) -> Any:
        return self.sim.control.outputs(name)[name]

    def until_outputs(self, **wanted: tuple[Any, ...]) -> None:
        """Wait until each output has one of the values that are given for it."""
        for name, values in wanted.items():
            eventually(lambda n=name, v=values: self.outputs(n) in v, f"{name} in {values}")

    def inject(self, kind: str, **parameters: Any) -> None:
        """Begin a fault that lasts, and wait until it has begun."""
        self.sim.control.inject(kind, **parameters)
        eventually(
            lambda: kind in [fault["kind"] for fault in self.sim.control.status()["faults"]], kind
        )

    def q(self) -> np.ndarray:
        return np.array(self.outputs("actual_q"))

    def cycles(self, count: int) -> None:
        """Wait for so many new samples."""
        goal = self.engine.health().samples + count
        eventually(lambda: self.engine.health().samples >= goal, f"{count} samples")

    def stands(self) -> bool:
        found = self.sim.control.outputs("target_qd", "actual_qd")
        return max(map(abs, (*found["target_qd"], *found["actual_qd"]))) < 1e-3

    def until_still(self) -> None:
        eventually(self.stands, "the arm stands")

    def until_moving(self, joint: int = 0, speed: float = 0.2) -> None:
        eventually(lambda: abs(self.outputs("actual_qd")[joint]) > speed, f"joint {joint} moves")

    def watch(self, seconds: float) -> float:
        """Return the largest joint speed in rad/s that the controller wanted within `seconds`."""
        fastest, end = 0.0, time.monotonic() + seconds
        while time.monotonic() < end:
            fastest = max(fastest, *map(abs, self.outputs("target_qd")))
            time.sleep(0.01)
        return fastest

    @contextmanager
    def nothing_moves(self) -> Iterator[None]:
        """The arm must stand at the end where it stood at the beginning."""
        before = self.q()
        yield
        assert self.watch(0.1) < 1e-3
        np.testing.assert_allclose(self.q(), before, atol=1e-4)

    # The wire

    def mark(self) -> int:
        """Return where the trace of received packages stands."""
        return int(self.sim.control.status()["input_packages"])

    def sent_since(self, mark: int) -> list[Mapping[str, Any]]:
        """Return what the controller was asked to do since `mark`, without feeding of its watchdog."""
        found: list[Mapping[str, Any]] = []
        while part := self.sim.control.trace(after=mark):
            mark = part[-1]["number"]
            found += [entry["values"] for entry in part if self._asks(entry["values"])]
        return found

    def _asks(self, values: Mapping[str, Any]) -> bool:
        if self.control == "native":
            return any(name in values for name in SEQUENCES)
        return values.get("input_int_register_0", 0) not in IDLE_CODES

    @contextmanager
    def nothing_sent(self) -> Iterator[None]:
        """No command may reach the controller within, and the arm must not move."""
        with self.nothing_moves():
            mark = self.mark()
            yield
            # So many packages later whatever was on its way has arrived.
            done = self.mark()
            eventually(lambda: self.mark() > done + 10, "the watchdog is fed")
        assert self.sent_since(mark) == []

    @contextmanager
    def refused(self, reason: str = "", command: str = "") -> Iterator[None]:
        """The one command within must be refused, and told so, once."""
        before = len(self.log.refusals)
        with pytest.raises(CommandRefused) as caught:
            yield
        assert reason in str(caught.value.reason), caught.value
        assert command in caught.value.command
        assert caught.value.detail
        assert [r.reason for r in self.log.refusals[before:]] == [caught.value.reason]


def brisk_sim(**options: Any) -> RunningSim:
    """Start a simulated controller for `driver_at`."""
    started: RunningSim = SIM.spawn(**{"realtime": True, **BRISK, **options})
    return started


@contextmanager
def ur_bench(
    config: Mapping[str, Any] | None = None, *, start: bool = True, **sim_options: Any
) -> Iterator[UrBench]:
    """A simulated controller and a driver that is connected to it."""
    model = sim_options.setdefault("model", "ur5e")
    with (
        brisk_sim(**{"trace_size": 2000, **sim_options}) as sim,
        driver_at(sim, {"model": model, **(config or {})}, start=start) as bench,
    ):
        yield bench


@contextmanager
def lenient() -> Iterator[None]:
    """Let threads and processes be silent for longer, and an arm lag whose controller starves.

    And be unlocked as soon as `BRISK` has it.
    """
    with (
        patch.object(robot, "UNLOCK_AFTER", UNLOCK_AFTER),
        patch.object(abilities, "FOLLOWING_ERROR", FAR_BEHIND),
        patch.object(threads, "STALL_LIMIT", LENIENT),
        patch.object(supervisor, "SILENCE_ALLOWED", LENIENT),
        patch.object(registers, "LOCK_TIMEOUT", LENIENT),
        patch.object(link, "PROGRAM_START_TIMEOUT", LONG),
        patch.object(link, "STOP_UNHEARD", LENIENT),
        patch.object(device, "DEAD_AFTER", LATE_STATE),
    ):
        yield


def patient_config(values: Mapping[str, Any], watchdog: float = ur_watchdog.FREQUENCY) -> UrConfig:
    """Return a configuration with the watchdog of a busy machine, in Hz, which users may not have."""
    loaded = load(PLUGIN.config, from_values(values))
    return loaded.model_copy(update={"watchdog_frequency": watchdog})


@contextmanager
def driver_at(
    sim: RunningSim, config: Mapping[str, Any] | None = None, *, start: bool = True
) -> Iterator[UrBench]:
    """A driver for a simulated controller that runs already."""
    values = {**PATIENT, "host": sim.host, **(config or {})}
    rate = (config or {}).get("watchdog_frequency", ur_watchdog.FREQUENCY)
    values["watchdog_frequency"] = max(PATIENT["watchdog_frequency"], rate)
    with lenient():
        loaded = patient_config(values, rate)
        bench = UrBench(sim, Session(PLUGIN, loaded), loaded.control)
        try:
            if start:
                bench.session.start()
                bench.until_connected()
            yield bench
        finally:
            bench.arm.close()
