"""What goes wrong with a WSG gripper and the way to it: what is told, and that nothing opens by itself."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from typing import Any

import pytest

import crtk_drivers
from crtk_driver_weiss_wsg.tables import FAULTS, STATUS, Flag
from crtk_drivers.config import AttachedConfig
from crtk_drivers.errors import CommandRefused, ConfigError, DeviceError, MotionAborted
from crtk_drivers.plugins.at_tool import attached
from crtk_drivers.state import OperatingState
from crtk_sim_backends.weiss_wsg import SIM, RunningSim
from rigs.waiting import LONG, eventually
from rigs.wsg_bench import FREE_PORTS, LINKS, WsgBench, bench

ENABLED, DISABLED = OperatingState.ENABLED, OperatingState.DISABLED
PAUSED, FAULT = OperatingState.PAUSED, OperatingState.FAULT
WIDTH = 0.03
"""Of what is gripped, in m."""
WIDER = WIDTH + 0.004
"""To which no finger may open that holds it."""
FLAGS = {
    "temperature": Flag.TEMPERATURE,
    "power": Flag.POWER,
    "current": Flag.CURRENT,
    "finger": Flag.FINGER,
}


@pytest.fixture(scope="module")
def shared() -> Iterator[RunningSim]:
    with SIM.spawn(**FREE_PORTS) as sim:
        yield sim


@pytest.fixture
def sim(shared: RunningSim) -> Iterator[RunningSim]:
    """A simulated gripper, half open, as nobody has used it."""
    shared.control.clear()
    eventually(lambda: not any(shared.control.status()["connections"].values()), "nobody there")
    shared.control.inject("as_new", opening=0.06)
    yield shared
    shared.control.clear()


@pytest.fixture(params=LINKS)
def running(sim: RunningSim, request: pytest.FixtureRequest) -> Iterator[WsgBench]:
    """A driver at it, on each way."""
    with WsgBench(sim, link=request.param) as bench:
        yield bench


@pytest.fixture
def tcp(sim: RunningSim) -> Iterator[WsgBench]:
    """A driver at its binary port."""
    with WsgBench(sim) as bench:
        yield bench


def gripped(bench: WsgBench) -> None:
    """Let it hold something."""
    bench.sim.control.inject("object", width=WIDTH)
    bench.front.enable()
    bench.front.part_width(WIDTH)
    assert "holds an object" in bench.front.grip()
    bench.grip("holds an object")
    assert bench.front.state.holds()


def holds_on(bench: WsgBench) -> None:
    """The fingers are where they were, and hold it."""
    assert bench.simulated("opening") < WIDER
    assert bench.simulated("grasping") == 4


def slowly(bench: WsgBench, goal: float) -> Any:
    """Begin a move that takes seconds."""
    bench.front.trajectory_j.set_ratio(0.02)
    move = bench.front.move_jp([goal])
    eventually(lambda: bench.simulated("moves"), "it moves")
    return move


# ------------------------------------------------------------------------------------------ the grip


@pytest.mark.sweep(3)
def test_a_move_ends_at_what_it_meets_and_keeps_it(running: WsgBench) -> None:
    running.sim.control.inject("object", width=WIDTH)
    running.front.enable()
    assert running.front.move_jp([0.0]).wait(LONG)
    running.grip("holds an object")
    assert running.front.state.holds()
    assert running.front.measured_js().position[0] == pytest.approx(WIDTH, abs=0.002)
    running.front.move_jp([0.05]).wait(LONG)
    running.grip("at the position")
    assert not running.front.state.holds()


@pytest.mark.sweep(3)
def test_a_part_is_gripped_watched_and_released(running: WsgBench) -> None:
    running.front.force(40.0)
    gripped(running)
    assert running.front.measured_js().effort[0] == pytest.approx(-40.0)
    assert running.front.state.force() == pytest.approx(40.0)
    running.front.move_jp([0.0]).wait(LONG)
    holds_on(running)
    assert "open to 39" in running.front.release()
    running.grip("at the position")
    gripped(running)
    running.front.move_jp([0.06]).wait(LONG)
    assert running.simulated("opening") == pytest.approx(0.06, abs=1e-4)


@pytest.mark.sweep(3)
def test_a_part_that_is_lost_is_told(running: WsgBench) -> None:
    gripped(running)
    running.sim.control.inject("slip", speed=0.02, duration=0.1)
    running.samples(5)
    assert running.front.state.holds()
    running.sim.control.inject("object_lost")
    running.grip("object lost")
    assert not running.front.state.holds()
    notes = {note.key: note.text for note in running.front.health().notes}
    assert notes == {"object": "what it held is gone"}
    running.state(ENABLED)
    running.front.move_jp([0.05]).wait(LONG)


def test_no_part_and_a_part_of_another_width_are_told(tcp: WsgBench) -> None:
    tcp.front.enable()
    tcp.front.part_width(0.04)
    with pytest.raises(DeviceError, match="a part of that width"):
        tcp.front.grip()
    tcp.grip("nothing gripped")
    tcp.front.move_jp([0.07]).wait(LONG)
    tcp.sim.control.inject("object", width=0.055)
    with pytest.raises(DeviceError, match="blocked"):
        tcp.front.grip()
    tcp.state(ENABLED)
    tcp.front.move_jp([0.07]).wait(LONG)


def test_a_stop_ends_a_grip_that_is_under_way(sim: RunningSim) -> None:
    with WsgBench(sim, speed=0.01) as slow:
        slow.front.enable()
        answer: list[Exception] = []

        def grip() -> None:
            try:
                slow.front.grip()
            except DeviceError as error:
                answer.append(error)

        thread = threading.Thread(target=grip)
        thread.start()
        eventually(lambda: slow.simulated("moves"), "it grips")
        slow.front.hold()
        thread.join(LONG)
        assert "broken off" in str(answer[0])
        eventually(lambda: not slow.simulated("moves"), "it stands")
        assert slow.simulated("opening") > 0.03


@pytest.mark.parametrize("link", ["tcp", "text"])
@pytest.mark.parametrize("behaviour", ["replace", "refuse"])
@pytest.mark.sweep(2)
def test_a_move_takes_the_place_of_another(link: str, behaviour: str) -> None:
    with bench(simulated={"while_moving": behaviour}, link=link) as running:
        running.front.enable()
        first = slowly(running, 0.0)
        running.front.trajectory_j.set_ratio(1.0)
        assert running.front.move_jp([0.08]).wait(LONG)
        with pytest.raises(MotionAborted):
            first.wait(LONG)
        assert running.simulated("opening") == pytest.approx(0.08, abs=1e-4)
        assert running.front.measured_js().position[0] == pytest.approx(0.08, abs=1e-4)


@pytest.mark.parametrize("behaviour", ["replace", "refuse"])
@pytest.mark.sweep(2)
def test_a_stream_is_followed_to_its_end(behaviour: str) -> None:
    with bench(simulated={"while_moving": behaviour}) as running:
        running.front.enable()
        for step in range(60):
            running.front.servo_jp([0.05 + 0.0005 * step])
            running.samples(1)
        eventually(lambda: running.simulated("opening") == pytest.approx(0.0795, abs=1e-4), "there")
        running.state(ENABLED)


def test_a_stream_lets_a_part_go_only_to_open(tcp: WsgBench) -> None:
    gripped(tcp)
    tcp.front.hold()  # from where the grip has taken it
    eventually(lambda: tcp.front.setpoint_js().position[0] < WIDER, "held there")
    here = tcp.front.setpoint_js().position[0]
    for _ in range(5):
        tcp.front.servo_jp([here - 0.001])
        tcp.samples(1)
    holds_on(tcp)
    for step in range(20):
        tcp.front.servo_jp([here + 0.001 * step])
        tcp.samples(1)
    eventually(lambda: tcp.simulated("opening") > here + 0.018, "opened")


# ----------------------------------------------------------------------------- what would move it


@pytest.mark.sweep(2)
@pytest.mark.parametrize("link", ["tcp", "text"])
def test_a_lost_link_stops_it_fast_and_opens_nothing(sim: RunningSim, link: str) -> None:
    with WsgBench(sim, link=link) as running:
        gripped(running)
        before, widest = running.simulated("motions"), running.simulated("opening") + 0.001
        sim.control.inject("disconnect")
        running.state(FAULT)
        assert running.simulated("fast_stop"), "that is its dead-man's switch"
        sim.control.clear("disconnect")
        running.connected()
        running.state(DISABLED, "stopped fast")
        running.samples(20)
        assert running.simulated("fast_stop"), "never acknowledged by itself"
        running.front.enable()
        running.samples(10)
        assert not running.simulated("fast_stop")
        assert running.simulated("motions") == before
        assert running.simulated("opening") < widest


def test_a_lost_link_stops_a_motion(tcp: WsgBench) -> None:
    tcp.front.enable()
    move = slowly(tcp, 0.0)
    tcp.sim.control.inject("disconnect")
    with pytest.raises(MotionAborted):
        move.wait(LONG)
    assert not tcp.simulated("moves")
    assert tcp.simulated("opening") > 0.03
    tcp.sim.control.clear("disconnect")
    tcp.connected()
    tcp.samples(5)  # it is seen to stand: closing need not say that nobody knows


def test_a_fast_stop_in_motion_is_a_fault_that_enable_acknowledges(running: WsgBench) -> None:
    running.front.enable()
    slowly(running, 0.0)
    running.sim.control.inject("fast_stop")
    running.state(FAULT, "stopped fast")
    with pytest.raises(CommandRefused):
        running.front.move_jp([0.05])
    running.front.trajectory_j.set_ratio(1.0)
    running.front.enable()
    running.state(ENABLED)
    running.front.move_jp([0.05]).wait(LONG)


@pytest.mark.parametrize("policy", ["if needed", "always"])
def test_a_fast_stop_with_a_part_held_locks_nobody_out(policy: str) -> None:
    """`enable` acknowledges it, also where it refuses then: the service by its name refuses before that."""
    with bench(home=policy) as running:
        running.front.enable()
        running.sim.control.inject("object", width=0.03)
        running.front.part_width(0.03)
        running.front.grip()
        eventually(running.front.state.grip, "it holds")
        if policy == "if needed":  # without power it forgets its reference
            running.sim.control.inject("unpowered")
            running.state(FAULT)
            running.connected()
        running.sim.control.inject("fast_stop")
        eventually(lambda: running.simulated("fast_stop"), "it is stopped fast")
        running.samples(20)
        with pytest.raises(DeviceError, match="may still hold something"):
            running.front.enable()
        assert not running.simulated("fast_stop")
        running.sim.control.inject("object_lost")
        running.front.reference()
        running.front.enable()
        running.state(ENABLED)


def test_the_end_of_a_driver_that_moves_is_a_fast_stop(sim: RunningSim) -> None:
    """Whose stop could not be read back: what stops the hardware by itself stays armed."""
    with WsgBench(sim) as running:
        running.front.enable()
        slowly(running, 0.0)
        sim.control.inject("deaf", command="STOP")
        with pytest.raises(DeviceError, match="stop"):
            running.front.close()
    eventually(lambda: sim.control.status()["fast_stop"], "stopped fast")
    assert sim.control.status()["opening"] > 0.01


def test_nothing_on_close_lets_a_motion_go_on_and_says_so(sim: RunningSim) -> None:
    with WsgBench(sim, on_close="nothing") as running:
        running.front.enable()
        slowly(running, 0.03)
        with pytest.raises(DeviceError, match="stop has not been carried out"):
            running.front.close()
    eventually(lambda: sim.control.status()["opening"] < 0.0301, "it goes on to its goal")
    assert not running.simulated("fast_stop")


@pytest.mark.sweep(3)
@pytest.mark.parametrize("policy", ["if needed", "always", "never"])
@pytest.mark.parametrize("link", ["tcp", "text"])
def test_homing_is_asked_for(policy: str, link: str) -> None:
    with bench(simulated={"referenced": False}, home=policy, link=link) as running:
        running.state(DISABLED, "reference")
        assert not running.front.state.referenced()
        assert running.simulated("motions") == 0
        if policy == "never":
            with pytest.raises(DeviceError, match="reference"):
                running.front.enable()
            assert running.simulated("motions") == 0
            return
        running.front.enable()
        assert running.simulated("referenced")
        running.front.disable()
        running.front.enable()
        homed = 2 if policy == "always" else 1
        assert running.simulated("motions") == homed
        running.front.pause()
        running.front.resume()
        assert running.simulated("motions") == homed


def test_a_text_mode_without_flags_learns_by_a_refusal_that_it_has_no_reference() -> None:
    with bench(simulated={"referenced": False, "text_flags": False}, link="text") as running:
        running.front.enable()
        with pytest.raises(MotionAborted):
            running.front.move_jp([0.06]).wait(LONG)
        running.state(DISABLED, "reference")
        running.front.enable()
        running.front.move_jp([0.06]).wait(LONG)


def test_it_homes_to_the_side_that_is_asked_for() -> None:
    with bench(simulated={"referenced": False}, home_direction="close") as running:
        running.front.enable()
        assert running.simulated("opening") == 0.0


def test_a_gripper_that_lost_its_power_while_it_held_is_not_opened_by_enable(tcp: WsgBench) -> None:
    gripped(tcp)
    tcp.sim.control.inject("unpowered")
    tcp.state(DISABLED, "reference")
    tcp.connected()
    with pytest.raises(DeviceError, match="may still hold something"):
        tcp.front.enable()
    assert tcp.simulated("opening") < WIDER
    assert "reference" in tcp.front.reference()
    tcp.front.enable()
    assert tcp.simulated("opening") > 0.1


def test_always_homing_does_not_drop_what_a_fast_stop_holds(sim: RunningSim) -> None:
    with WsgBench(sim, home="never") as running:
        gripped(running)
        running.front.close()
    with WsgBench(sim, home="always") as running:
        running.samples(2)
        running.sim.control.inject("fast_stop")
        running.grip("stopped by an error")
        with pytest.raises(DeviceError, match=r"home: always\), and may still hold something"):
            running.front.enable()
        assert running.simulated("opening") < WIDER


# --------------------------------------------------------------------------- somebody else at it


def test_another_program_pauses_and_resume_takes_over(tcp: WsgBench) -> None:
    tcp.front.enable()
    tcp.sim.control.inject("other_program", opening=0.0)
    tcp.state(PAUSED, "another program")
    tcp.front.resume()
    tcp.samples(10)
    tcp.state(ENABLED)
    assert not tcp.simulated("moves")
    tcp.front.move_jp([0.05]).wait(LONG)


def test_enable_ends_a_motion_that_somebody_else_has_begun(running: WsgBench) -> None:
    running.sim.control.inject("other_program", opening=0.0)
    running.grip("moving")
    running.front.enable()
    assert not running.simulated("moves")
    assert running.simulated("opening") > 0.01


def test_a_second_driver_is_told_that_there_is_another(sim: RunningSim) -> None:
    with WsgBench(sim) as first:
        second = WsgBench(sim, open_timeout=1.0)
        second.session.start()
        try:
            second.state(FAULT, "one program")
        finally:
            second.front.close()
        first.samples(5)
        assert not first.simulated("fast_stop")


# -------------------------------------------------------------------------------- faults it reports


@pytest.mark.sweep(3)
@pytest.mark.parametrize(
    ("name", "link"), [*((name, "tcp") for name in FLAGS), ("temperature", "text")]
)
def test_a_fault_of_its_own_is_told(sim: RunningSim, name: str, link: str) -> None:
    text, remedy = FAULTS[FLAGS[name]]
    with WsgBench(sim, link=link) as running:
        running.front.enable()
        sim.control.inject("flag", name=name)
        assert remedy in running.state(FAULT, text)
        assert text in running.front.state.fault()
        sim.control.clear("flag")
        eventually(lambda: running.front.state.fault() == "", "gone")
        running.front.enable()
        running.state(ENABLED)


def test_a_fault_of_its_own_outlasts_enable(tcp: WsgBench) -> None:
    tcp.front.enable()
    tcp.sim.control.inject("flag", name="current")
    tcp.state(FAULT)
    with pytest.raises(DeviceError, match="overcurrent"):
        tcp.front.enable()
    tcp.state(FAULT)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("temperature_warning", "temperature"),
        ("soft_limit_plus", "soft limit"),
        ("script_running", "script"),
        ("script_failure", "script failed"),
    ],
)
def test_what_hinders_nothing_is_a_note(tcp: WsgBench, name: str, key: str) -> None:
    tcp.front.enable()
    tcp.sim.control.inject("flag", name=name)
    eventually(lambda: [note.key for note in tcp.front.health().notes] == [key], "told")
    tcp.state(ENABLED)


REFUSED = sorted(set(STATUS) - {3, 4, 19, 29})
"""Status codes with which any motion may be refused, or end; these four mean something to the driver."""


@pytest.mark.parametrize(("kind", "link"), [("refuse", "tcp"), ("fail", "text")])
def test_every_status_code_is_told_in_words(sim: RunningSim, kind: str, link: str) -> None:
    with WsgBench(sim, link=link) as running:
        running.front.enable()
        for status in REFUSED:
            sim.control.inject(kind, command="MOVE", status=status)
            with pytest.raises(MotionAborted):
                running.front.move_jp([0.0595]).wait(LONG)
            assert STATUS[status][0] in running.front.state.fault()
        running.state(ENABLED)
        sim.control.clear(kind)
        running.front.move_jp([0.06]).wait(LONG)
        assert running.front.state.fault() == ""


@pytest.mark.parametrize("command", ["FSACK", "SETFORCE", "SETACC", "SETLIMITS"])
def test_what_enable_asks_for_in_vain_is_told(sim: RunningSim, command: str) -> None:
    with WsgBench(sim, acceleration=1.0, soft_limits=[0.01, 0.1]) as running:
        if command == "FSACK":
            sim.control.inject("fast_stop")
            running.grip("stopped by an error")
        sim.control.inject("refuse", command=command, status=16)
        with pytest.raises(DeviceError, match="does not let us"):
            running.front.enable()
        sim.control.clear("refuse")
        running.front.enable()
        assert running.simulated("acceleration") == 1.0
        assert running.simulated("soft_limits") == [pytest.approx(0.01), pytest.approx(0.1)]
        running.front.move_jp([0.1]).wait(LONG)


def test_homing_that_fails_leaves_it_disabled() -> None:
    with bench(simulated={"referenced": False}) as running:
        running.sim.control.inject("refuse", command="HOME", status=29)
        with pytest.raises(DeviceError, match="blocked"):
            running.front.enable()
        assert running.front.operating_state().state is not ENABLED


# ------------------------------------------------------------------------------------------ the wire


BAD_WIRES: list[tuple[str, str, dict[str, Any]]] = [
    ("tcp", "bad_crc", {"every": 3}),
    ("tcp", "doubled", {}),
    ("tcp", "held", {"seconds": 0.05}),
    ("tcp", "held", {"seconds": 0.7}),
    ("tcp", "split", {"size": 3, "spacing": 0.001}),
    ("tcp", "corrupt", {"every": 4, "direction": "out"}),
    ("text", "doubled", {}),
    ("text", "held", {"seconds": 0.7}),
    ("text", "coalesce", {"seconds": 0.05}),
]


@pytest.mark.sweep(3)
@pytest.mark.parametrize(("link", "kind", "parameters"), BAD_WIRES, ids=str)
def test_a_bad_wire_is_lived_with(
    sim: RunningSim, link: str, kind: str, parameters: dict[str, Any]
) -> None:
    """Positions stay true, moves end, and nothing is told that was not."""
    with WsgBench(sim, link=link) as running:
        running.front.enable()
        sim.control.inject(kind, **parameters)
        for goal in (0.05, 0.06):
            assert running.front.move_jp([goal]).wait(LONG)
            assert running.simulated("opening") == pytest.approx(goal, abs=1e-4)
        running.state(ENABLED)


@pytest.mark.parametrize("link", ["tcp", "text"])
def test_a_move_whose_answers_are_lost_is_sent_again(sim: RunningSim, link: str) -> None:
    with WsgBench(sim, link=link) as running:
        running.front.enable()
        sim.control.inject("swallow", command="MOVE", duration=0.3)
        assert running.front.move_jp([0.05]).wait(LONG)
        assert running.simulated("opening") == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize("command", ["GRIP", "RELEASE"])
def test_a_grip_whose_answers_are_lost_is_seen_by_what_it_does(
    sim: RunningSim, command: str
) -> None:
    with WsgBench(sim) as running:
        sim.control.inject("swallow", command=command)
        gripped(running)
        before = running.simulated("motions")
        running.front.release()
        running.grip("at the position")
        assert running.simulated("motions") == before + 1


@pytest.mark.slow
def test_a_driver_that_is_killed_stops_it_fast(sim: RunningSim) -> None:
    """Its quick brother loses the link alone."""
    host, port = sim.host, sim.ports["binary"]
    script = (
        "import crtk_drivers\n"
        f"g = crtk_drivers.connect('weiss-wsg', host={host!r}, tcp_port={port})\n"
        "g.enable()\n"
        "g.trajectory_j.set_ratio(0.02)\n"
        "g.move_jp([0.0]).wait(60.0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script]) as driver:
        eventually(lambda: sim.control.status()["moves"], "it moves")
        driver.kill()
    eventually(lambda: sim.control.status()["fast_stop"], "stopped fast")
    assert sim.control.status()["opening"] > 0.02


def test_a_command_that_is_never_answered_is_told(sim: RunningSim) -> None:
    with WsgBench(sim) as running:
        running.front.enable()
        sim.control.inject("deaf", command="MOVE")
        with pytest.raises(MotionAborted):
            running.front.move_jp([0.05]).wait(LONG)
        eventually(lambda: running.front.health().reconnects > 0, "given up")
        sim.control.clear("deaf")
        running.connected()
        running.state(DISABLED, "stopped fast")


def test_a_gripper_that_falls_silent_is_a_fault_and_found_again(sim: RunningSim) -> None:
    with WsgBench(sim, open_timeout=1.0, sample_timeout=1.0) as running:
        running.front.enable()
        sim.control.inject("silence")
        running.state(FAULT)
        sim.control.clear("silence")
        running.connected()
        running.state(DISABLED)


def test_a_simulator_that_is_killed_and_started_anew() -> None:
    with SIM.spawn(**FREE_PORTS) as first:
        ports = {f"{name}_port": first.ports[name] for name in ("binary", "text")}
        host = first.host
        with WsgBench(first, open_timeout=1.0) as running:
            running.front.enable()
            first.kill()
            running.state(FAULT)
            with SIM.spawn(**ports, host=host, referenced=False) as running.sim:
                running.connected()
                running.state(DISABLED, "reference")
                running.front.enable()


# ------------------------------------------------------------------------------- what is not right


@pytest.mark.parametrize(
    ("link", "simulated", "text"),
    [
        ("tcp", {"model": "wsg-50-210"}, "its stroke is 210 mm"),
        ("tcp", {"swap": True}, "speak this protocol"),
        ("text", {"swap": True}, "speak this protocol"),
    ],
)
def test_another_gripper_or_protocol_is_told(
    link: str, simulated: dict[str, Any], text: str
) -> None:
    swap = simulated.pop("swap", False)
    with SIM.spawn(**FREE_PORTS, **simulated) as sim:
        if swap:
            sim.ports.update(binary=sim.ports["text"], text=sim.ports["binary"])
        running = WsgBench(sim, link=link, open_timeout=0.5)
        running.session.start()
        try:
            running.state(FAULT, text)
        finally:
            running.front.close()
        assert swap or not sim.control.status()["fast_stop"], "it has said goodbye"


def test_at_an_arm_it_has_an_address_of_its_own() -> None:
    given = AttachedConfig(plugin="weiss-wsg", settings={"host": "192.168.1.20"})
    plugin, config = attached(given, "192.168.1.10")
    assert plugin.create(config).address == "192.168.1.20:1000"
    with pytest.raises(ConfigError, match="address of its own"):
        attached(AttachedConfig(plugin="weiss-wsg"), "192.168.1.10")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"force": 0.3}, "force: 0.3 N"),
        ({"force": 300}, "5 to 80 N"),
        ({"acceleration": 500}, "m/s²"),
        ({"speed": 50}, "m/s"),
        ({"part_width": 30}, "m"),
        ({"soft_limits": [0.0, 0.2]}, "stroke"),
        ({"soft_limits": [0.1, 0.05]}, "stroke"),
        ({"rate": 500}, "140"),
        ({"home": "sometimes"}, "if needed"),
    ],
)
def test_what_a_configuration_may_not_say(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        crtk_drivers.connect("weiss-wsg", sim=True, **values)


def test_real_hardware_needs_an_address() -> None:
    with pytest.raises(ConfigError, match="host"):
        crtk_drivers.connect("weiss-wsg")
    with pytest.raises(ConfigError, match="port"):
        crtk_drivers.connect("weiss-wsg", link="serial")
