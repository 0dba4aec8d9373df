"""crtk-driver dynamixel scan, info, calibrate and limits, against simulated servos."""

import re
import time
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml

from crtk_driver_dynamixel import PLUGIN, chain_link, terminal
from crtk_driver_dynamixel.bus import Bus
from crtk_driver_dynamixel.calibration import load_calibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.turns import Turns, TurnsFile
from crtk_drivers.cli import main
from crtk_drivers.config import from_file, from_values, load
from crtk_drivers.device import Device
from crtk_drivers.errors import ConfigError
from crtk_drivers.kit.serial_port import SerialPort
from crtk_drivers.samples import JointState, Vector
from crtk_sim_backends.dynamixel import SIM
from crtk_sim_backends.process import RunningSim
from rigs.dynamixel_bench import COUNT, HARMLESS, PATIENT, driver_at, opened, place, sim_for
from rigs.waiting import LONG

IDS = "3-5,9"
"""Of the servos, and one that is not there."""


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(servos="3:xm430-w350,5:xl330-m288@52,9:ax-12a", timing="none") as running:
        yield running


@pytest.fixture
def tty(sim: RunningSim) -> str:
    (path,) = sim.ttys.values()
    return path


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let servos be late where a tool opens their line."""
    monkeypatch.setattr(chain_link, "PATIENCE", 1.0)
    monkeypatch.setattr(terminal, "Bus", partial(Bus, latency_budget=0.1))


def run(*arguments: str) -> int:
    return main(["dynamixel", *arguments])


def test_scan_finds_servos_of_both_protocols_and_writes_a_configuration_that_holds(
    tty: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.yaml"
    arguments = ("--port", tty, "--ids", IDS, "--bauds", "1000000", "--out", str(out))
    assert run("scan", *arguments) == 0
    told = capsys.readouterr().out
    for part in ("xm430-w350", "xl330-m288", "ax-12a", f"written: {out}"):
        assert part in told
    config = load(DynamixelConfig, from_file(out))
    assert [joint.id for joint in config.joints.values()] == [3, 5, 9]
    assert config.bus("main").port == tty
    PLUGIN.make(config)
    assert run("scan", *arguments) == 2  # an existing file is left alone
    assert "cannot be written: File exists" in capsys.readouterr().err


def test_scan_finds_a_servo_whose_first_answer_is_lost(
    sim: RunningSim, tty: str, capsys: pytest.CaptureFixture[str]
) -> None:
    sim.control.inject("drop", every=3)
    try:
        assert run("scan", "--port", tty, "--ids", IDS, "--bauds", "1000000") == 0
    finally:
        sim.control.clear("drop")
    told = capsys.readouterr().out
    assert all(part in told for part in ("xm430-w350", "xl330-m288", "ax-12a")), told


def test_scan_tells_what_to_do_if_nobody_answers(
    tty: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("scan", "--port", tty, "--ids", "20-22", "--bauds", "set", "--baud", "1000000") == 1
    assert "Is the power of the servos on" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("--ids", "1-300", "numbers from 0 to 252"),
        ("--ids", "a", "neither a number nor a range"),
        ("--bauds", "5", "numbers from 9600"),
        ("--protocols", "3", "numbers from 1 to 2"),
    ],
)
def test_wrong_options_are_refused(
    option: str, value: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("scan", "--port", "/dev/null", option, value) == 2
    assert reason in capsys.readouterr().err.replace("\n", " ")


def test_scan_needs_a_port_and_no_joints(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("scan") == 2
    assert "no serial port is given" in capsys.readouterr().err


def test_info_tells_each_servo_and_writes_nothing(
    sim: RunningSim, tty: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "arm.yaml"
    joints = {"a": {"id": 3, "model": "xm430-w350"}, "b": {"id": 5, "model": "xl330-m288"}}
    path.write_text(yaml.safe_dump({"port": tty, "joints": joints}))
    assert run("info", "--config", str(path), "--cycles", "3") == 0
    told = capsys.readouterr().out
    assert "xm430-w350" in told
    assert "readings a second of all 2" in told
    assert "off" in told


def test_calibrate_keeps_by_how_much_the_joints_are_off(tty: str, tmp_path: Path) -> None:
    path, out = tmp_path / "arm.yaml", tmp_path / "calibration.yaml"
    path.write_text(
        yaml.safe_dump({"port": tty, "joints": {"a": {"id": 3, "model": "xm430-w350"}}})
    )
    arguments = ("--config", str(path), "--no-ask", "--out", str(out), "--at", "{a: 0.1}")
    assert run("calibrate", *arguments) == 0
    (servo,) = load_calibration(out).servos
    assert servo.shift == -65  # 0.1 rad
    assert run("calibrate", *arguments[:-1], "{b: 0.1}") == 2


def test_calibrate_says_what_the_driver_refuses(
    tty: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A homing offset of -98 ends the turn at count 3997, which is 2.990 rad."""
    path, out = tmp_path / "arm.yaml", tmp_path / "calibration.yaml"
    joint = {"id": 3, "model": "xm430-w350", "lower": -2.9, "upper": 3.0}
    path.write_text(yaml.safe_dump({"port": tty, "joints": {"a": joint}}))
    arguments = ("--config", str(path), "--no-ask", "--out", str(out), "--at")
    for more in ((), ("--eeprom",)):
        assert run("calibrate", *arguments, "{a: 0.15}", *more) == 0
        assert "does not start" not in capsys.readouterr().out
    assert run("calibrate", *arguments, "{a: -0.15}", "--eeprom") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "The driver does not start with it yet: the range of joint a (servo 3 on main)" in told


KOCH_POSE = {"shoulder_lift": 0.5, "elbow_flex": -0.5, "gripper": 0.3}
"""Joint positions in which the leader is calibrated, of those that are not 0."""


@pytest.fixture(scope="module")
def koch() -> Iterator[RunningSim]:
    with sim_for({"arm": "koch_leader"}, timing="none") as running:
        yield running


@pytest.mark.parametrize("first", [0, 1024, 1700, 2730, 3873])
def test_calibrate_works_from_any_mounting(koch: RunningSim, tmp_path: Path, first: int) -> None:
    """`first` is the count of the first servo in the pose; the others are a sixth of a turn apart."""
    counts = [(first + at * 683) % 4096 for at in range(6)]
    for id, count in enumerate(counts, start=1):
        place(koch, id, (count - 2048) * COUNT)
    out, turns = tmp_path / "calibration.yaml", tmp_path / "turns.yaml"
    (path,) = koch.ttys.values()
    config = tmp_path / "arm.yaml"
    values = {"arm": "koch_leader", "buses": {"main": {"port": path}}}
    config.write_text(yaml.safe_dump(values))
    given = ("--config", str(config), "--no-ask", "--out", str(out), "--at", str(KOCH_POSE))
    assert run("calibrate", *given) == 0
    for more in ({}, {"turns": str(turns)}):
        with opened(koch, {**PATIENT, **values, **more, "calibration": str(out)}) as device:
            found = joints_of(device)
            wanted = [0.0, 0.5, -0.5, 0.0, 0.0]
            assert np.allclose(found, wanted, atol=COUNT), (counts, found)


def joints_of(device: Device) -> Vector:
    """Where the joints are measured now."""
    sample = device.read(time.monotonic() + LONG)
    assert sample is not None
    joints = sample.values["measured_js"]
    assert isinstance(joints, JointState)
    return joints.position


def test_calibrate_begins_the_kept_turns_anew(koch: RunningSim, tmp_path: Path) -> None:
    """What was kept of another mounting would put the joint a whole turn off."""
    for id in range(1, 7):
        place(koch, id)
    out, turns = tmp_path / "calibration.yaml", tmp_path / "turns.yaml"
    before = dict.fromkeys(("shoulder_pan", "wrist_roll"), 2.0 * np.pi)
    TurnsFile(turns).save(Turns(clean=True, positions=before))
    (path,) = koch.ttys.values()
    config = tmp_path / "arm.yaml"
    values = {"arm": "koch_leader", "buses": {"main": {"port": path}}, "turns": str(turns)}
    config.write_text(yaml.safe_dump(values))
    assert run("calibrate", "--config", str(config), "--no-ask", "--out", str(out)) == 0
    with opened(koch, {**PATIENT, **values, "calibration": str(out)}) as device:
        assert np.allclose(joints_of(device), 0.0, atol=COUNT)


def test_info_tells_of_servos_before_they_are_calibrated(
    koch: RunningSim, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for id in range(1, 7):
        place(koch, id)
    place(koch, 2, (3873 - 2048) * COUNT)
    config, out = tmp_path / "arm.yaml", tmp_path / "calibration.yaml"
    (path,) = koch.ttys.values()
    values = {"arm": "koch_leader", "buses": {"main": {"port": path}}}
    config.write_text(yaml.safe_dump(values))
    assert run("info", "--config", str(config), "--cycles", "1") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "3873" in told
    assert "rad is not where the joints are" in told
    assert run("calibrate", "--config", str(config), "--no-ask", "--out", str(out)) == 0
    config.write_text(yaml.safe_dump({**values, "calibration": str(out)}))
    capsys.readouterr()
    assert run("info", "--config", str(config), "--cycles", "1") == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "rad is not where the joints are" not in told
    assert re.search(r"shoulder_lift 2 .* 0\.0000 3873", told), "it is told as calibrated"


def test_limits_are_those_of_the_calibrated_joint(
    sim: RunningSim, tty: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The range of ±0.5 rad is ±326 counts around where the joint is calibrated."""
    place(sim, 3, 0.5)
    config, out = tmp_path / "arm.yaml", tmp_path / "calibration.yaml"
    joint = {"id": 3, "model": "xm430-w350", "lower": -0.5, "upper": 0.5}
    values = {"port": tty, "joints": {"a": joint}}
    config.write_text(yaml.safe_dump(values))
    assert run("calibrate", "--config", str(config), "--no-ask", "--out", str(out)) == 0
    config.write_text(yaml.safe_dump({**values, "calibration": str(out)}))
    before = registers(sim, 3)
    capsys.readouterr()
    try:
        assert run("limits", "--config", str(config), "--no-write") == 0
        told = capsys.readouterr().out
        assert f"min_position_limit {before['min_position_limit']} to {2048 + 326 - 326}" in told
        assert f"max_position_limit {before['max_position_limit']} to {2048 + 326 + 326}" in told
    finally:
        place(sim, 3)


LIMITED = {
    "id": 3,
    "model": "xm430-w350",
    "sign": -1,
    "gear": 2.0,
    "lower": -0.3,
    "upper": 0.5,
    "velocity": 1.0,
    "current_limit": 1.0,
}
WANTED = {
    "velocity_limit": 84,
    "min_position_limit": 1396,
    "max_position_limit": 2440,
    "current_limit": 372,
}
"""1 rad/s with a gear of 2 is 83.4 times 0.229 rpm; -0.5 and 0.3 rad are 2048 - 651.9 and + 391.1 counts."""
ADDRESSES = {
    "current_limit": 38,
    "velocity_limit": 44,
    "max_position_limit": 48,
    "min_position_limit": 52,
}


def registers(sim: RunningSim, id: int) -> dict[str, int]:
    """What a servo says of its limits on the wire."""
    with closing(Bus(SerialPort(sim.ttys["bus1"]), latency_budget=1.0)) as bus:
        bus.open()
        return {
            name: int.from_bytes(bus.read(id, address, 2), "little")
            for name, address in ADDRESSES.items()
        }


@pytest.fixture
def limited(tty: str, tmp_path: Path) -> str:
    path = tmp_path / "limited.yaml"
    joints = {"a": LIMITED, "b": {"id": 9, "model": "ax-12a", "lower": -1.0, "upper": 1.0}}
    path.write_text(yaml.safe_dump({"port": tty, "joints": joints}))
    return str(path)


def test_limits_of_the_configuration_go_into_the_servos_and_only_where_they_differ(
    sim: RunningSim,
    limited: str,
    capsys: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
) -> None:
    values = {**PATIENT, **yaml.safe_load(Path(limited).read_text())}
    with caplog.at_level("INFO"), driver_at(sim, values) as bench:
        for _ in range(2):
            bench.enable()
            bench.arm.disable(timeout=LONG)
        told = [text for text in caplog.messages if "wider than the configuration" in text]
        assert len(told) == 1
        assert "joint a (servo 3 on main) velocity_limit 200 for 84 (1 rad/s)" in told[0]
        assert re.search(r"; and \d+ more\. As a second line", told[0])
    before = registers(sim, 3)
    capsys.readouterr()
    assert run("limits", "--config", limited, "--no-write") == 0
    assert "differs: velocity_limit 200 to 84 (1 rad/s)" in capsys.readouterr().out
    assert registers(sim, 3) == before
    assert run("limits", "--config", limited) == 0
    told = capsys.readouterr().out
    for name, value in WANTED.items():
        assert f"joint a (servo 3 on main): changed: {name} {before[name]} to {value}" in told
    assert "joint b (servo 9 on main): changed: cw_angle_limit 0 to 316" in told
    assert registers(sim, 3) == WANTED
    mark = int(sim.control.status()["instructions"])
    assert run("limits", "--config", limited) == 0
    assert "have the limits of the configuration" in capsys.readouterr().out
    assert {entry["code"] for entry in sim.control.trace(after=mark)} <= HARMLESS
    caplog.clear()
    with caplog.at_level("INFO"), driver_at(sim, values) as bench:
        bench.enable()
        assert bench.arm.move_jp([0.2, 0.1]).wait(LONG)
        bench.arm.disable(timeout=LONG)
    assert not any("wider than the configuration" in text for text in caplog.messages)


def test_limits_are_not_written_to_a_servo_with_torque(
    sim: RunningSim, tty: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "arm.yaml"
    joints = {
        "a": {**LIMITED, "velocity": 0.5},
        "b": {"id": 5, "model": "xl330-m288", "velocity": 0.5},
    }
    path.write_text(yaml.safe_dump({"port": tty, "joints": joints}))
    before = registers(sim, 3)
    sim.control.call("write", id=5, address=64, data="01")
    try:
        assert run("limits", "--config", str(path)) == 1
    finally:
        sim.control.call("write", id=5, address=64, data="00")
    assert "joint b (servo 5 on main) has torque" in capsys.readouterr().err.replace("\n", " ")
    assert registers(sim, 3) == before


def test_a_simulated_chain_is_that_of_the_configuration() -> None:
    config = DynamixelConfig(arm="vx300s")
    assert PLUGIN.sim_options(config)["servos"] == "vx300s"
    changed = config.model_copy(update={"gripper": None})
    assert PLUGIN.sim_options(changed)["servos"].startswith(
        "1:xm540-w270,2:xm540-w270,3:xm540-w270&2"
    )
    assert PLUGIN.sim_options(DynamixelConfig())["servos"] == "arm6"


def test_what_is_missing_is_said() -> None:
    with pytest.raises(ConfigError, match="no joints are configured"):
        PLUGIN.check_real(DynamixelConfig())
    with pytest.raises(ConfigError, match=r"buses\.main\.port: is required"):
        PLUGIN.check_real(DynamixelConfig(arm="arm6"))


def test_no_figure_is_told_before_it_is_known(capsys: pytest.CaptureFixture[str]) -> None:
    config = load(DynamixelConfig, from_values({"arm": "arm6", "slow_interval": 60.0}))
    counters = PLUGIN.create(config).counters
    assert counters["replies"] == 0.0
    assert not {"voltage_min", "temperature_max"} & counters.keys()
    assert main(["check", "dynamixel", "--sim", "--set", "slow_interval=60"]) == 0
    told = capsys.readouterr().out
    assert "replies" in told
    assert "nan" not in told.lower()


def test_check_fails_on_a_servo_error_that_a_restart_may_leave(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with SIM.spawn(servos="arm6", timing="none") as sim:
        sim.control.inject("overheat", id=5, temperature=95.0)
        (path,) = sim.ttys.values()
        given = ["--set", "arm=arm6", "--set", f"buses.main.port={path}"]
        assert main(["check", "dynamixel", *given, "--sample-timeout", "10"]) == 1
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"operating state failed FAULT: .*overheating", text)
    assert "Remove the cause" in text
    assert "not ready: 1 of" in text
