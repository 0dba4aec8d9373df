"""The lower layers of the CANopen driver against simulated drives, over the hub's python-can interface."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crtk_driver_canopen.bus import CanLink
from crtk_driver_canopen.bus_state import BusLost, Condition
from crtk_driver_canopen.commissioning import Prepared, prepare
from crtk_driver_canopen.config import CanopenConfig
from crtk_driver_canopen.cycle import Cycle, SentSync
from crtk_driver_canopen.heartbeat import NmtCommand, NmtState
from crtk_driver_canopen.homing import Homing, HomingPhase
from crtk_driver_canopen.identity import WrongDevice
from crtk_driver_canopen.layout import plan
from crtk_driver_canopen.master import BootUp, Master
from crtk_driver_canopen.modes import HandshakePhase, OpMode, SetpointHandshake
from crtk_driver_canopen.objects import OBJECTS
from crtk_driver_canopen.sdo import ObjectIgnored, Sdo, SdoSilent
from crtk_driver_canopen.statemachine import Drive402, State, decode
from crtk_driver_canopen.tools import bus_address
from crtk_driver_canopen.units import GroupUnits
from crtk_drivers.config import from_values, load
from crtk_drivers.errors import ConnectionFailed, ProtocolError
from crtk_sim_backends.canopen import SIM
from crtk_sim_backends.process import RunningSim
from rigs.canopen_arm import start_anew
from rigs.waiting import LONG

PERIOD = 0.005
PATIENT = {"ours_timeout": 2.0, "drives_timeout": 2.0}
"""The test is the driver: it, or a drive, may get no time for a while."""


@pytest.fixture(scope="module")
def drives() -> Iterator[RunningSim]:
    with SIM.spawn(nodes=2) as sim:
        yield sim


@pytest.fixture
def sim(drives: RunningSim) -> Iterator[RunningSim]:
    """The simulated drives, without faults and started anew."""
    yield drives
    drives.control.clear()
    start_anew(drives)


def arm(sim: RunningSim, joint: dict[str, Any] | None = None, **keys: Any) -> CanopenConfig:
    limits = {"lower": -6.0, "upper": 6.0, "velocity": 5.0, "gear": 1.0}
    waits = {"parameters": {"2010:1": 2000}}  # ms, for SYNC
    joints = {f"joint_{n}": {"node": n, **limits, **waits, **(joint or {})} for n in (1, 2)}
    bus = {"interface": "crtk", "channel": sim.paths["crtk"]}
    values = {
        "bus": bus,
        "joints": joints,
        "period": PERIOD,
        "heartbeat": PATIENT,
        "sdo_timeout": 5.0,
    } | keys
    return load(CanopenConfig, from_values(values))


class Rig:
    """Two drives with our layers on top, as a device will have them."""

    def __init__(self, config: CanopenConfig, link: CanLink) -> None:
        self.config = config
        self.master = Master(
            link,
            dict.fromkeys(config.nodes, config.heartbeat.drives_timeout),
            node=config.master_node,
            period=config.heartbeat.ours,
            sdo_timeout=config.sdo_timeout,
        )
        self.layout = plan(config)
        self.prepared: dict[str, Prepared] = prepare(self.master, config, self.layout)
        self.units = GroupUnits({name: each.units for name, each in self.prepared.items()})
        self.drives = [
            Drive402(stays_in_quick_stop=each.stays_in_quick_stop)
            for each in self.prepared.values()
        ]
        self.cycle = Cycle(self.master, self.layout.tpdos, self.layout.rpdos, SentSync(link))
        self.master.command_and_wait(NmtCommand.START, config.nodes, time.monotonic() + LONG)
        self.cycle.start()
        self.targets: list[int] | None = None
        self.mode = int(config.joints["joint_1"].op_modes[0])
        self._due = time.monotonic()

    def column(self, name: str) -> list[int]:
        places = self.layout.tpdos.places(OBJECTS[name])
        values = self.cycle.values
        return [values[place] for place in places.values()]

    def step(self) -> None:
        """One cycle: SYNC, TPDOs, machines, RPDOs."""
        self._due = max(self._due + PERIOD, time.monotonic() - PERIOD)
        self.master.poll(self._due)
        assert self.cycle.begin(self._due + PERIOD)
        self.cycle.collect(time.monotonic() + PERIOD)
        now = time.monotonic()
        if not self.cycle.complete:
            return
        words = [
            drive.step(word, now)
            for drive, word in zip(self.drives, self.column("statusword"), strict=True)
        ]
        targets = self.targets or self.column("position_actual")
        values = [0] * sum(len(pdo.entries) for pdo in self.layout.rpdos.pdos)
        for name, column in {
            "controlword": words,
            "target_position": targets,
            "mode_of_operation": [self.mode] * 2,
        }.items():
            places = self.layout.rpdos.places(OBJECTS[name])
            for place, value in zip(places.values(), column, strict=bool(places)):
                values[place] = value
        self.cycle.send(values)

    def until(self, done: Callable[[], bool]) -> None:
        end = time.monotonic() + LONG
        while not done():
            assert time.monotonic() < end, [(d.state, d.failure) for d in self.drives]
            self.step()

    def enable(self) -> None:
        for drive in self.drives:
            drive.request(State.ENABLED)
        self.until(lambda: all(drive.reached for drive in self.drives))


@pytest.fixture
def make(sim: RunningSim) -> Iterator[Callable[..., Rig]]:
    links: list[CanLink] = []

    def make(joint: dict[str, Any] | None = None, **keys: Any) -> Rig:
        config = arm(sim, joint, **keys)
        links.append(CanLink(bus_address(config)))
        links[-1].open()
        return Rig(config, links[-1])

    yield make
    for link in links:
        link.close()


def test_a_stream_of_positions_is_followed(make: Callable[..., Rig]) -> None:
    rig = make()
    first = rig.prepared["joint_1"]
    assert first.identity.profile == 402
    assert OpMode.CSP in first.modes
    rig.enable()
    start = rig.units.positions(rig.column("position_actual"))
    for n in range(1, 101):
        rig.targets = rig.units.position_counts(start + np.array([0.005, -0.003]) * n)
        rig.step()
    goal = start + np.array([0.5, -0.3])
    rig.until(
        lambda: bool(
            np.allclose(rig.units.positions(rig.column("position_actual")), goal, atol=0.01)
        )
    )
    assert all(drive.failure is None for drive in rig.drives)
    assert rig.cycle.counters.short == rig.cycle.counters.foreign_syncs == 0


DOORS: dict[str, Callable[[RunningSim], dict[str, Any]]] = {
    "socketcand": lambda sim: {
        "interface": "socketcand",
        "channel": "can0",
        "options": {"host": sim.host, "port": sim.ports["socketcand"]},
    },
    "slcan": lambda sim: {
        "interface": "slcan",
        "channel": next(iter(sim.ttys.values())),
        "options": {"sleep_after_open": 0.0},
    },
}


@pytest.mark.parametrize("door", DOORS)
def test_the_bus_may_be_any_of_python_can(
    make: Callable[..., Rig], sim: RunningSim, door: str
) -> None:
    rig = make(bus=DOORS[door](sim))
    rig.enable()
    rig.until(lambda: not any(rig.cycle.ages))
    assert all(drive.reached for drive in rig.drives)


@pytest.mark.parametrize("door", DOORS)
def test_a_clock_that_is_set_back_delays_nothing(
    sim: RunningSim, door: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`can.BusABC.recv` waits for an hour then."""
    config = arm(sim, bus=DOORS[door](sim))
    with closing(CanLink(bus_address(config))) as link:
        link.open()
        jumped = threading.Event()
        monkeypatch.setattr("can.bus.time", lambda: time.time() - 3600.0 * jumped.is_set())
        clock = threading.Timer(0.05, jumped.set)
        clock.start()
        while not jumped.is_set():
            link.receive(0.2)
        clock.join()
        assert Sdo(Master(link, sdo_timeout=LONG).sdo(1)).read(OBJECTS["serial_number"]) == 1


def test_a_fault_stops_one_and_is_reset_by_an_edge(
    make: Callable[..., Rig], sim: RunningSim
) -> None:
    rig = make()
    rig.enable()
    sim.control.inject("fault", node=2, error="over_current")
    rig.until(lambda: rig.drives[1].state is State.FAULT and 2 in rig.master.emergencies)
    assert rig.drives[1].failure is not None
    assert "over-current" in str(rig.master.emergencies[2])
    assert rig.drives[0].reached
    rig.drives[0].request(State.QUICK_STOP)
    rig.drives[1].reset_fault()
    rig.until(lambda: rig.drives[1].reached and rig.drives[1].state is State.DISABLED)
    assert rig.drives[1].failure is None
    rig.until(lambda: 2 not in rig.master.emergencies)
    rig.enable()


def test_profile_positions_are_handed_over(make: Callable[..., Rig]) -> None:
    rig = make({"modes": ["pp", "csp"], "parameters": {"profile_velocity": 600_000}})
    rig.enable()
    handshake = SetpointHandshake()
    target = rig.column("position_actual")[0] + 20_000
    for _ in range(2):  # the second one is where the first one ended
        rig.targets = [target, rig.column("position_actual")[1]]
        handshake.start()
        end = time.monotonic() + LONG
        while handshake.phase is not HandshakePhase.REACHED:
            assert time.monotonic() < end, (handshake.phase, handshake.failure)
            rig.drives[0].mode_bits = handshake.step(rig.drives[0].statusword, time.monotonic())
            rig.step()
        assert abs(rig.column("position_actual")[0] - target) < 500


def test_homing_twice(make: Callable[..., Rig]) -> None:
    rig = make({"modes": ["csp"], "homing": {"method": 37, "position": 0.25}})
    for _ in range(2):
        rig.mode = OpMode.HM
        rig.enable()
        homings = [Homing(37), Homing(37)]
        for homing in homings:
            homing.start()
        end = time.monotonic() + LONG
        while not all(homing.over for homing in homings):
            assert time.monotonic() < end
            shown = rig.column("mode_of_operation_display")
            for drive, homing, mode in zip(rig.drives, homings, shown, strict=True):
                drive.mode_bits = homing.step(drive.statusword, mode, time.monotonic())
            rig.step()
        assert [homing.phase for homing in homings] == [HomingPhase.DONE] * 2
        position = rig.units.positions(rig.column("position_actual"))
        assert position == pytest.approx([0.25, 0.25], abs=1e-3)
        for drive in rig.drives:
            drive.mode_bits = 0
        rig.mode = OpMode.CSP
        rig.until(lambda: rig.column("mode_of_operation_display") == [8, 8])


def test_a_drive_that_starts_anew_is_told(make: Callable[..., Rig], sim: RunningSim) -> None:
    rig = make()
    rig.enable()
    rig.master.take_events()
    rig.master.command(NmtCommand.RESET_NODE, 2)
    rig.until(lambda: BootUp(2) in rig.master.take_events())
    rig.until(lambda: {pdo.node for pdo in rig.cycle.stale(3)} == {2})


def test_drives_stop_when_we_are_silent(make: Callable[..., Rig], sim: RunningSim) -> None:
    rig = make(heartbeat={**PATIENT, "ours_timeout": 0.5})
    rig.enable()
    time.sleep(2.0 * rig.config.heartbeat.ours_timeout)  # as if this process hung

    # They stop, and leave the operational state, in which alone there are PDOs.
    rig.until(lambda: {pdo.node for pdo in rig.cycle.stale(3)} == {1, 2})
    lives = rig.master.watch.nodes
    rig.until(lambda: {lives[node].state for node in (1, 2)} == {NmtState.PRE_OPERATIONAL})
    for node in (1, 2):
        statusword = Sdo(rig.master.sdo(node)).read(OBJECTS["statusword"])
        assert decode(statusword) is not State.ENABLED


def test_safe_torque_off_leaves_the_drive_reachable(
    make: Callable[..., Rig], sim: RunningSim
) -> None:
    sim.control.inject("safe_torque_off", node=1)
    rig = make()
    for drive in rig.drives:
        drive.request(State.ENABLED)
    rig.until(lambda: rig.drives[0].failure is not None and rig.drives[1].reached)
    assert "safe torque off" in rig.drives[0].failure.text  # type: ignore[union-attr]
    sim.control.clear("safe_torque_off")
    for _ in range(20):
        rig.step()
    assert rig.drives[0].state is State.DISABLED  # it does not come up by itself
    rig.enable()


@pytest.mark.parametrize("index", [0x1016, 0x1017, 0x6007])
def test_a_drive_that_ignores_its_watchdog_is_refused(
    make: Callable[..., Rig], sim: RunningSim, index: int
) -> None:
    sim.control.inject("ignored_writes", node=2, index=index)
    keys = {"joint": {"abort_option": 2}}
    with pytest.raises(ObjectIgnored, match=f"node 2: {index:04X}h.*nothing stops the drive"):
        make(**keys)
    if index != 0x1017:  # without its heartbeat nobody tells whether it has started
        allowed = make(**keys, heartbeat={**PATIENT, "required": False})
        assert f"{index:04X}h" in allowed.prepared["joint_2"].notes[0]
        assert allowed.prepared["joint_1"].notes == ()


def test_bus_off_ends_the_bus_and_it_is_opened_anew(
    make: Callable[..., Rig], sim: RunningSim
) -> None:
    rig = make()
    rig.enable()
    link = rig.master.link
    sim.control.inject("bus_off", node="*")
    with pytest.raises(BusLost) as caught:
        rig.until(lambda: False)
    assert caught.value.condition is Condition.BUS_OFF
    sim.control.clear()
    link.close()
    link.open()
    again = Rig(rig.config, link)
    # Without power either way: told to be, or in fault because we were silent for too long.
    off = {State.DISABLED, State.FAULT}
    again.until(lambda: all(drive.state in off for drive in again.drives))


@pytest.mark.parametrize("door", ["crtk", *DOORS])
def test_a_bus_that_ends_is_gone(door: str) -> None:
    with SIM.spawn(nodes=2) as sim:
        config = arm(sim, **({} if door == "crtk" else {"bus": DOORS[door](sim)}))
        with closing(CanLink(bus_address(config))) as link:
            link.open()
            rig = Rig(config, link)
            sim.kill()
            with pytest.raises(BusLost) as caught:
                rig.until(lambda: False)
            assert caught.value.condition is Condition.GONE
            assert "server of the bus" in caught.value.remedy
            with pytest.raises(ConnectionFailed, match=f"canopen {door}"):
                link.open()


def test_a_late_answer_is_never_taken_for_another(sim: RunningSim) -> None:
    config = arm(sim)
    with closing(CanLink(bus_address(config))) as link:
        link.open()
        patient = Sdo(Master(link, sdo_timeout=LONG).sdo(1))
        names = ("device_type", "feed", "product_code")
        right = {name: patient.read(OBJECTS[name]) for name in names}
        hasty = Sdo(Master(link, sdo_timeout=0.03).sdo(1))
        sim.control.inject("slow_sdo", node=1, delay=0.04)
        for name, value in list(right.items()) * 5:
            try:
                assert hasty.read(OBJECTS[name]) == value
            except (SdoSilent, ProtocolError) as error:
                assert "node 1: read of" in str(error)  # noqa: PT017 - or it is told
        sim.control.clear()
        link.poll(time.monotonic() + 0.1)
        patient = Sdo(Master(link, sdo_timeout=LONG).sdo(1))
        assert {name: patient.read(OBJECTS[name]) for name in names} == right


def test_the_configuration_is_written_once(make: Callable[..., Rig]) -> None:
    rig = make()
    rig.master.command_and_wait(
        NmtCommand.PRE_OPERATIONAL, rig.config.nodes, time.monotonic() + LONG
    )
    sdo = Sdo(rig.master.sdo(1))
    assert sdo.read(OBJECTS["interpolation_period_value"]) == 5
    assert sdo.read(OBJECTS["abort_connection_option"]) == 3
    before = rig.master.link.counters.sent
    prepare(rig.master, rig.config, rig.layout, [1])
    again = rig.master.link.counters.sent - before
    assert again < 80  # reads alone


def test_a_dcf_and_parameters_are_written(
    make: Callable[..., Rig], sim: RunningSim, tmp_path: Path
) -> None:
    text = Path(sim.paths["eds"]).read_text()
    dcf = tmp_path / "drive.dcf"
    dcf.write_text(
        text.replace("[6065]", "[6065]\nParameterValue=1234").replace(
            "[1017]", "[1017]\nParameterValue=7"
        )
    )
    rig = make({"eds": str(dcf), "parameters": {"6066": 30, "profile_velocity": 4000}})
    sdo = Sdo(rig.master.sdo(2))
    assert sdo.read(OBJECTS["following_error_window"]) == 1234
    assert sdo.read(OBJECTS["following_error_time"]) == 30
    assert sdo.read(OBJECTS["profile_velocity"]) == 4000
    assert sdo.read(OBJECTS["producer_heartbeat_time"]) == 100  # ours, not that of the DCF


def test_another_drive_is_refused(sim: RunningSim) -> None:
    config = arm(sim, {"identity": {"serial": 4711}})
    with closing(CanLink(bus_address(config))) as link:
        link.open()
        with pytest.raises(WrongDevice, match="serial number is 1, not 4711"):
            prepare(Master(link), config, plan(config))
