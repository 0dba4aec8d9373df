"""The configuration of a chain: what is accepted, and how a mistake is told."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from crtk_driver_dynamixel.config import DynamixelConfig
from crtk_driver_dynamixel.gripper import Linear, SliderCrank
from crtk_driver_dynamixel.joints import Chain
from crtk_driver_dynamixel.models import OperatingMode
from crtk_drivers.config import from_assignments, from_file, from_values, load
from crtk_drivers.errors import ConfigError

JOINT = {"id": 1, "model": "xm430-w350"}
GRIPPER = {"id": 7, "model": "xl330-m288", "closed": 0.0, "open": 1.0, "velocity": 2.0}


def made(**values: Any) -> DynamixelConfig:
    return load(DynamixelConfig, from_values(values, "chain.yaml"))


def refusal(**values: Any) -> str:
    with pytest.raises(ConfigError) as caught:
        made(**values)
    return str(caught.value)


def test_least_configuration() -> None:
    config = made(port="/dev/ttyUSB0", joints={"pan": JOINT})
    assert config.bus("main").port == "/dev/ttyUSB0"
    assert config.bus("main").baud == 1_000_000
    assert made(baud=57600).bus("main").baud == 57600
    joint = config.joints["pan"]
    assert joint.range == pytest.approx((-3.14083, 3.14083), abs=1e-4)
    assert joint.operating_mode is OperatingMode.POSITION
    assert joint.ids == (1,)


def test_one_file_for_a_chain(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(
        """
buses:
  left: {port: /dev/left, baud: 4_000_000}
  right: {port: /dev/right}
joints:
  shoulder:
    id: 2
    bus: left
    model: XM540-W270-R
    sign: -1
    offset: 0.1
    lower: -1.5
    upper: 1.2
    velocity: 2.0
    shadows:
      - {id: 3, sign: 1}
  pan: {id: 2, bus: right, model: ax-12a, lower: -1.0, upper: 1.0, effort: 1.0}
gripper:
  id: 9
  bus: right
  model: xl330-m288
  mode: current_based_position
  finger: {kind: slider_crank, horn: 0.022, rod: 0.036}
  closed: 0.03
  open: 0.1
  velocity: 0.1
"""
    )
    config = load(DynamixelConfig, from_file(path))
    assert list(config.joints) == ["shoulder", "pan"]
    assert config.joints["shoulder"].model == "xm540-w270"
    assert config.joints["shoulder"].ids == (2, 3)
    assert config.bus("left").baud == 4_000_000
    assert config.gripper is not None
    assert isinstance(config.gripper.finger.finger, SliderCrank)


def test_values_of_one_joint_can_be_set_alone() -> None:
    layer = from_assignments(DynamixelConfig, ["joints.waist.offset=0.25", "joints.waist.id=11"])
    config = load(DynamixelConfig, from_values({"arm": "arm6"}), layer)
    waist = config.joints["waist"]
    assert (waist.offset, waist.id, waist.model) == (0.25, 11, "xm540-w270")
    assert len(config.joints) == 6


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"id": 253}, r"joints.elbow.id: must be less than or equal to 252, not 253"),
        ({"id": "three"}, r"joints.elbow.id: must be a whole number"),
        ({"model": "xm430-w35"}, r"joints.elbow.model: 'xm430-w35' is not a model"),
        ({"modell": "x"}, r"joints.elbow.modell: unknown key. Did you mean 'joints.elbow.model'"),
        ({"sign": 0}, r"joints.elbow.sign: must be 1 or -1, not 0"),
        ({"gear": 0.0}, r"joints.elbow.gear: must be greater than 0"),
        ({"gear": float("nan")}, r"joints.elbow.gear: must be a finite number"),
        ({"lower": float("nan")}, r"joints.elbow.lower: must be a finite number"),
        ({"upper": float("inf")}, r"joints.elbow.upper: must be a finite number"),
        ({"lower": 1.0, "upper": -1.0}, r"joints.elbow: lower \(1\) must be below upper \(-1\)"),
        ({"velocity": -1.0}, r"joints.elbow.velocity: must be greater than 0"),
        ({"acceleration": 0.0}, r"joints.elbow.acceleration: must be greater than 0"),
        ({"mode": "positions"}, r"joints.elbow.mode: .*Did you mean 'position'"),
        ({"lower": -4.0, "upper": 4.0}, r"joints.elbow: .*set mode to extended_position"),
        ({"gear": 2.0, "lower": -3.0, "upper": 3.0}, r"joints.elbow: .*extended_position"),
        ({"bus": "other"}, r"joints.elbow.bus: there is no bus 'other', but main"),
        ({"gains": {"position_p": 40000}}, r"joints.elbow.gains.position_p: must be less"),
        ({"model": "ax-12a", "protocol": 2}, r"joints.elbow: protocol: ax-12a speaks protocol 1"),
        (
            {"model": "xl430-w250", "torque_constant": 1.0},
            r"elbow: torque_constant: xl430-w250 meas",
        ),
        (
            {"model": "xl430-w250", "mode": "current_based_position"},
            r"joints.elbow: mode: xl430-w250 has no current_based_position, but position, ext",
        ),
        ({"pwm_effort": True}, r"elbow: pwm_effort: xm430-w350 takes efforts by its current"),
        ({"model": "ax-12a", "pwm_effort": True}, r"elbow: pwm_effort: ax-12a has no PWM mode"),
        ({"model": "xl-320", "pwm_effort": True}, r"elbow: pwm_effort: xl-320 has no PWM mode"),
        (
            {"model": "mx-28", "protocol": 1, "pwm_effort": True},
            r"elbow: pwm_effort: mx-28 has no PWM mode here",
        ),
        ({"model": "ax-12a", "gains": {"position_p": 10}}, r"elbow: gains: ax-12a has no such"),
        (
            {"model": "mx-28-1.0", "profile_acceleration": 1.0},
            r"elbow: profile_acceleration: mx-28-1.0 has no such",
        ),
        (
            {"model": "xl-320", "reverse": True},
            r"elbow: reverse: xl-320 has no Drive Mode: set sign to -1",
        ),
        (
            {"model": "ax-12a", "shadows": [{"id": 2, "sign": 1, "reverse": True}]},
            r"elbow: shadows: servo 2, a ax-12a, has no Drive Mode: leave reverse out, and change",
        ),
        (
            {"model": "ax-12a", "shadows": [{"id": 2, "sign": 1, "follow": "secondary_id"}]},
            r"elbow: shadows: servo 2, a ax-12a, has no Secondary ID: set follow to goals",
        ),
        (
            {"shadows": [{"id": 2, "sign": 1, "follow": "cable"}]},
            r"elbow: shadows: servo 2, a xm430-w350, has no synchronisation cable",
        ),
        ({"model": "xw430-t200", "effort": 1.0}, r"elbow: velocity: give a limit, none is known"),
        ({"shadows": [{"id": 2}]}, r"joints.elbow.shadows\[0\].sign: is required"),
        (
            {"shadows": [{"id": 1, "sign": -1}]},
            r"joints.elbow: shadows: two of its servos have the same id",
        ),
        (
            {"shadows": [{"id": 2, "sign": -1, "model": "ax-12a"}]},
            r"elbow: shadows: .*different units",
        ),
        (
            {"shadows": [{"id": 2, "sign": -1, "follow": "secondary_id"}]},
            r"elbow: shadows: servo 2 takes the goals of servo 1.*set its sign to 1",
        ),
    ],
)
def test_mistakes_name_the_joint(values: dict[str, Any], text: str) -> None:
    message = refusal(joints={"elbow": {**JOINT, **values}})
    assert re.search(text, message), message
    assert message.startswith("chain.yaml: ")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        (
            {"joints": {"a": JOINT, "b": JOINT}},
            "joints.b: id 1 on bus main is also that of joints.a",
        ),
        (
            {"joints": {"a": JOINT}, "gripper": {**GRIPPER, "id": 1}},
            "gripper: id 1 on bus main is also that of joints.a",
        ),
        (
            {
                "joints": {
                    "a": {**JOINT, "shadows": [{"id": 2, "sign": 1}]},
                    "b": {**JOINT, "id": 2},
                }
            },
            "joints.b: id 2 on bus main is also that of joints.a",
        ),
        ({"joints": {"": JOINT}}, "joints: a joint has no name"),
        ({"rate": -1.0}, "rate: must be greater than or equal to 1, not -1"),
        ({"rate": 0}, "rate: must be greater"),
        ({"watchdog": 3.0}, "watchdog: must be less than or equal to 2.54"),
        ({"latency_budget": float("nan")}, "latency_budget: must be a finite number"),
        (
            {"silent_timeout": 0.5},
            "silent_timeout (0.5 s) must be below sample_timeout (0.5 s): the whole link",
        ),
        (
            {"rate": 5.0, "watchdog": 0.0},
            "silent_timeout (0.25 s) must be 0.4 s at least, two cycles at a rate of 5 Hz: a single",
        ),
        (
            {"latency_budget": 0.1, "watchdog": 0.0},
            "silent_timeout (0.25 s) must be above 0.3 s: a cycle waits up to 3 times latency_budget",
        ),
        ({"watchdog": 0.04, "rate": 40.0}, "watchdog (0.04 s) must be 0 or 0.05 s at least"),
        ({"watchdog": 0.1, "latency_budget": 0.06}, "watchdog (0.1 s) must be 0 or 0.12 s at"),
        ({"watchdogg": 1.0}, "watchdogg: unknown key. Did you mean 'watchdog'"),
        ({"arm": "koch_folower"}, "there is no arm 'koch_folower'. Did you mean 'koch_follower'"),
        (
            {"arm": "other"},
            "There are arm6, koch_follower, koch_leader, open_manipulator_x, vx300s",
        ),
        ({"arm": "nowhere.yaml"}, "nowhere.yaml: cannot be read"),
        ({"port": "/dev/a", "buses": {"main": {"port": "/dev/b"}}}, "give port or buses.main.port"),
        ({"port": "/dev/a", "buses": {"left": {}, "right": {}}}, "whose only bus is 'main'"),
        ({"buses": {}}, "buses: "),
        ({"joints": {"gripper": JOINT}, "gripper": GRIPPER}, "joints.gripper: is also the name"),
    ],
)
def test_mistakes_of_the_chain(values: dict[str, Any], text: str) -> None:
    assert text in refusal(**values)


def test_timings_that_agree() -> None:
    made(silent_timeout=0.4, sample_timeout=0.41, rate=5.0, watchdog=0.4)
    made(watchdog=0.0, latency_budget=0.08)
    made(rate=1.0, silent_timeout=2.0, sample_timeout=5.0, watchdog=2.0)


def test_the_same_id_on_two_buses_is_two_servos() -> None:
    other = {**JOINT, "bus": "right"}
    made(buses={"main": {}, "right": {}}, joints={"a": JOINT, "b": other})


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"closed": 1.0, "open": 0.5}, r"gripper: closed (1) must be below open (0.5)"),
        ({"finger": {"kind": "slider_crank", "horn": 0.02}}, "gripper.finger: rod: is needed for"),
        ({"finger": {"kind": "jaw", "horn": 0.02}}, "gripper.finger: horn: is not for jaw"),
        (
            {"finger": {"kind": "slider_crank", "horn": 0.03, "rod": 0.02}},
            "the rod is longer than the horn",
        ),
        (
            {"finger": {"kind": "slider_crank", "horn": 0.022, "rod": 0.036}, "closed": 0.03},
            "gripper: an opening of 1 m cannot be reached",
        ),
        ({"finger": {"kind": "linear", "travel": 0.001}}, "set mode to extended_position"),
        ({"closed": float("nan")}, "gripper.closed: must be a finite number"),
        ({"velocity": 0.0}, "gripper.velocity: must be greater than 0"),
    ],
)
def test_mistakes_of_the_gripper(values: dict[str, Any], text: str) -> None:
    assert text in refusal(gripper={**GRIPPER, **values})


def test_a_linear_gripper_may_close_with_rising_angle() -> None:
    finger = {"kind": "linear", "travel": -0.02, "gap": 0.02}
    config = made(gripper={**GRIPPER, "finger": finger, "closed": 0.0, "open": 0.05})
    assert config.gripper is not None
    assert config.gripper.finger.finger == Linear(-0.02, 0.02)


def test_paths_in_the_file_of_an_arm_are_beside_it(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(
        "joints:\n  a: {id: 1, model: xm430-w350}\n"
        "calibration: mine.calibration.yaml\nturns: turns.yaml\n"
        "kinematics: {urdf: mine.urdf}\n"
    )
    config = made(arm=str(tmp_path / "mine.yaml"), kinematics={"tip_link": "hand"})
    assert config.kinematics is not None
    assert config.kinematics.urdf == str(tmp_path / "mine.urdf")
    assert config.kinematics.tip_link == "hand"
    assert config.calibration == str(tmp_path / "mine.calibration.yaml")
    assert config.turns == str(tmp_path / "turns.yaml")


def test_an_arm_names_no_arm(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("arm: arm6\n")
    assert "names another arm" in refusal(arm=str(path))


def test_a_mistake_in_the_file_of_an_arm_is_told(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("joints:\n  a: {id: 1, model: xm430-w350, ofset: 1.0}\n")
    assert "joints.a.ofset: unknown key. Did you mean 'joints.a.offset'" in refusal(arm=str(path))


GUIDE = Path(__file__).parents[3] / "docs" / "dynamixel.md"
EXAMPLES = re.findall(r"^```yaml\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("text", EXAMPLES)
def test_the_examples_of_the_guide_hold(tmp_path: Path, text: str) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(text)
    assert Chain.of(load(DynamixelConfig, from_file(path))).servos


def test_the_guide_has_examples() -> None:
    assert len(EXAMPLES) >= 3
