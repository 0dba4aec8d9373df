"""crtk-driver dynamixel scan, info and calibrate, against simulated servos."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from crtk_driver_dynamixel import PLUGIN
from crtk_driver_dynamixel.calibration import load_calibration
from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_drivers.cli import main
from crtk_drivers.config import from_file, from_values, load
from crtk_drivers.errors import ConfigError
from crtk_sim_backends.dynamixel import SIM
from crtk_sim_backends.process import RunningSim


@pytest.fixture(scope="module")
def sim() -> Iterator[RunningSim]:
    with SIM.spawn(servos="3:xm430-w350,5:xl330-m288@52,9:ax-12a", timing="none") as running:
        yield running


@pytest.fixture
def tty(sim: RunningSim) -> str:
    (path,) = sim.ttys.values()
    return path


def run(*arguments: str) -> int:
    return main(["dynamixel", *arguments])


def test_scan_finds_servos_of_both_protocols_and_writes_a_configuration_that_holds(
    tty: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "arm.yaml"
    arguments = ("--port", tty, "--ids", "1-10", "--bauds", "1000000", "--out", str(out))
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
