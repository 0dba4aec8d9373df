"""The virtual arm as a device: its files, its states, and every CRTK command on it."""

import logging
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pinocchio")

import crtk_drivers
from crtk_driver_virtual import PLUGIN, plugin
from crtk_driver_virtual.config import VirtualConfig
from crtk_driver_virtual.device import VirtualDevice
from crtk_driver_virtual.models import BUILT_IN, FOLDER, load_arm
from crtk_drivers.commands import COMMANDS, Direction, Level
from crtk_drivers.device import Mode, Setpoint
from crtk_drivers.errors import CommandRefused, ConfigError, MissingExtra
from crtk_drivers.front import LocalDevice
from crtk_drivers.samples import Pose, Wrench, vector
from crtk_drivers.testing.clock import FakeClock
from rigs.waiting import eventually

SEVEN_AXIS = Path(__file__).parents[1] / "data" / "seven_axis.urdf"
"""Without masses, and with a joint without limits."""

CRANE = """
<robot name="crane">
  <link name="floor"/>
  <link name="mast"><inertial><mass value="20"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="0.5"/></inertial></link>
  <link name="carriage"><inertial><origin xyz="0.1 0 0"/><mass value="5"/>
    <inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>
  <link name="hook"><inertial><mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <link name="finger"><inertial><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="swing" type="continuous">
    <parent link="floor"/><child link="mast"/><axis xyz="0 0 1"/>
    <limit velocity="2" effort="300"/><dynamics damping="3"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="mast"/><child link="carriage"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="2" velocity="0.5" effort="400"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="carriage"/><child link="hook"/><origin xyz="1 0 0"/>
  </joint>
  <joint name="grip" type="revolute">
    <parent link="hook"/><child link="finger"/><axis xyz="0 1 0"/>
    <limit lower="0" upper="1" velocity="1" effort="5"/>
  </joint>
</robot>
"""


@pytest.fixture
def crane(tmp_path: Path) -> dict[str, str]:
    path = tmp_path / "crane.urdf"
    path.write_text(CRANE)
    return {"urdf": str(path), "base_link": "floor", "tip_link": "hook"}


@pytest.fixture
def arm() -> Iterator[Callable[..., LocalDevice]]:
    """Connects virtual arms, and closes them."""
    arms: list[LocalDevice] = []

    def connect(**values: Any) -> LocalDevice:
        options = {"rate": 100.0, "transition_time": 0.0, **values}
        arms.append(crtk_drivers.connect("virtual", **options))
        return arms[-1]

    yield connect
    for each in arms:
        each.close()


# ---------------------------------------------------------------------------------------------- files


@pytest.mark.parametrize(
    ("model", "reach"), [("six_axis", 0.87), ("seven_axis", 0.85), ("haptic", 0.3)]
)
def test_a_built_in_arm_reaches_as_far_as_it_says_and_starts_pointing_down(
    model: str, reach: float
) -> None:
    device = VirtualDevice(VirtualConfig(model=model))
    joints = np.zeros(len(device.capabilities.joints))
    shoulder = {"six_axis": 0.18, "seven_axis": 0.34, "haptic": 0.12}[model]
    assert device.kinematics.forward(joints).position[2] == pytest.approx(shoulder + reach)
    pose = device.kinematics.forward(vector(BUILT_IN[model].start))
    assert np.abs(pose.orientation) == pytest.approx((0.0, 1.0, 0.0, 0.0), abs=1e-4)


def test_every_built_in_arm_has_a_file_and_every_file_an_arm() -> None:
    assert {path.stem for path in FOLDER.glob("*.urdf")} == set(BUILT_IN)


def test_masses_limits_and_friction_come_from_a_file(crane: dict[str, str]) -> None:
    arm = load_arm(VirtualConfig(**crane, friction=2.0, acceleration=3.0))
    assert arm.chain.names == ("swing", "lift")
    # The finger is no part of the chain, but hangs from it; so does what is fixed to the carriage.
    assert [inertia.mass for inertia in arm.inertias] == [20.0, 8.0]
    assert [limit.velocity for limit in arm.limits] == [2.0, 0.5]
    assert [limit.effort for limit in arm.limits] == [300.0, 400.0]
    assert [limit.acceleration for limit in arm.limits] == [3.0, 3.0]
    assert arm.damping.tolist() == [6.0, 0.0]
    assert arm.rotor_inertia.tolist() == [1.5, 2.0]
    assert arm.start.tolist() == [0.0, 1.0]
    device = VirtualDevice(VirtualConfig(**crane))
    weight = device.plant.dynamics.weight(device.plant.position)
    assert weight == pytest.approx((0.0, 8.0 * 9.81))


def test_without_masses_it_takes_no_efforts_and_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "bare.urdf"
    bare = CRANE.replace('<mass value="5"/>', '<mass value="0"/>')
    path.write_text(bare.replace('"2"/>', '"0"/>').replace('"1"/>', '"0"/>'))
    with caplog.at_level(logging.WARNING):
        device = VirtualDevice(VirtualConfig(urdf=str(path), base_link="floor", tip_link="hook"))
    assert "no mass beyond joint lift" in caplog.text
    capabilities = device.capabilities
    assert capabilities.modes == {Mode.JOINT_POSITION, Mode.JOINT_VELOCITY}
    assert not capabilities.has_free
    assert not capabilities.has_gravity_compensation
    device.open(0.0)
    device.plant.braked = False
    goal = device.plant.position + 0.05
    device.write(Setpoint(Mode.JOINT_POSITION, vector(goal)))
    for _ in range(1000):
        device.plant.step()
    assert device.plant.position == pytest.approx(goal, abs=1e-6)
    sample = device.read(0.0)
    assert sample is not None
    assert sample.values["measured_js"].effort.size == 0  # type: ignore[union-attr]


def test_a_file_that_lacks_limits_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"no velocity limit above zero at a1\. Add <limit"):
        load_arm(VirtualConfig(urdf=str(SEVEN_AXIS), base_link="pedestal", tip_link="flange"))


@pytest.mark.parametrize("start", [(0.0,) * 5, (9.0, 0.0, 0.0, 0.0, 0.0, 0.0)])
def test_a_start_that_the_arm_cannot_have_is_refused(start: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match=r"start: .* Give 6 positions within: -3\.05 to 3\.05"):
        load_arm(VirtualConfig(start=start))


def test_a_wall_without_direction_is_refused() -> None:
    with pytest.raises(ConfigError, match="normal must have a direction"):
        crtk_drivers.connect("virtual", walls=[{"point": [0, 0, 0], "normal": [0, 0, 0]}])


def test_a_missing_library_names_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugin, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra) as caught:
        PLUGIN.create(VirtualConfig())
    assert "crtk-drivers[kinematics]" in caught.value.remedy


# ------------------------------------------------------------------------------------------- commands


def test_it_offers_every_command_of_motion(arm: Callable[..., LocalDevice]) -> None:
    motion = {
        name
        for name, command in COMMANDS.items()
        if command.direction is Direction.COMMANDED
        and command.level in (Level.SERVO, Level.INTERPOLATE, Level.MOVE)
    }
    offered = arm().crtk_commands
    assert motion <= set(offered)
    assert {"hold", "free", "use_gravity_compensation", "measured_cf", "setpoint_cf"} <= set(
        offered
    )


def test_a_tool_pressed_on_a_wall_measures_what_it_presses_with(
    arm: Callable[..., LocalDevice],
) -> None:
    height = arm().measured_cp().position[2]
    wall = {"point": [0.0, 0.0, height - 0.005], "normal": [0.0, 0.0, 3.0], "stiffness": 2e3}
    tester = arm(walls=[wall], friction=3.0)
    tester.enable()

    def pressed() -> bool:
        tester.servo_cf([0.0, 0.0, -20.0, 0.0, 0.0, 0.0])
        at_rest = np.abs(tester.measured_cv().vector).max() < 1e-3
        return bool(at_rest and abs(tester.measured_cf().force[2] - 20.0) < 1.0)

    eventually(pressed, "it comes to rest on the wall with 20 N upwards on the tool")
    found: list[tuple[Pose, Wrench]] = []

    def of_one_sample() -> bool:
        (pose, at), (load, told) = tester.measured_cp(extra=True), tester.measured_cf(extra=True)
        found.append((pose, load))
        return bool(at == told)

    eventually(of_one_sample, "it says where it is, and its load, of one instant")
    pose, load = found[-1]
    depth = height - 0.005 - pose.position[2]
    assert load.force[2] == pytest.approx(2e3 * depth, rel=0.05)


def test_a_hand_pushes_a_free_arm_but_not_a_disabled_one(arm: Callable[..., LocalDevice]) -> None:
    pushed = arm()
    push = Wrench(vector((0.0, 0.0, 30.0)), vector((0.0, 0.0, 0.0)), "base")
    before = pushed.measured_cp().position[2]
    pushed.apply_wrench(push)
    eventually(lambda: pushed.measured_cf().force[2] == 30.0, "it feels the hand")
    assert pushed.measured_cp(age=0).position[2] == before
    pushed.apply_wrench([0.0] * 6)
    pushed.enable()
    pushed.free()
    pushed.apply_wrench(push)
    eventually(lambda: pushed.measured_cp().position[2] > before + 0.02, "it follows the hand")
    pushed.apply_wrench([0.0] * 6)
    pushed.hold()


@pytest.mark.parametrize(
    ("wrench", "why"),
    [
        (Wrench(vector((np.nan, 0.0, 0.0)), vector((0.0, 0.0, 0.0))), "not_finite"),
        (Wrench(vector((1.0, 0.0)), vector((0.0, 0.0, 0.0))), "not_finite"),
        (Wrench(vector((1.0, 0.0, 0.0)), vector((0.0, 0.0, 0.0)), "tool"), "wrong_frame"),
    ],
)
def test_what_is_no_wrench_in_the_base_is_refused(wrench: Wrench, why: str) -> None:
    device = VirtualDevice(VirtualConfig())
    with pytest.raises(CommandRefused, match=why):
        device.apply_wrench(wrench)
    assert not device.plant.hand.any()


def test_gravity_compensation_can_be_left_out_and_had_again(
    arm: Callable[..., LocalDevice],
) -> None:
    heavy = arm(rate=250.0)
    heavy.enable()
    start = heavy.measured_cp().position[2]
    heavy.use_gravity_compensation(False)

    def fell() -> bool:
        heavy.servo_jf(np.zeros(6))
        return bool(heavy.measured_cp().position[2] < start - 0.03)

    eventually(fell, "it falls without it")
    heavy.hold()
    heavy.use_gravity_compensation(True)
    eventually(lambda: np.abs(heavy.measured_js().velocity).max() < 1e-3, "it comes to rest")
    # While efforts are zero the motors carry the weight.
    eventually(lambda: not heavy.is_busy(), "it is idle")
    here = heavy.measured_cp().position[2]
    for _ in range(20):
        heavy.servo_jf(np.zeros(6))
        time.sleep(0.01)
    assert heavy.measured_cp().position[2] == pytest.approx(here, abs=2e-3)


def test_it_can_stand_somewhere_else(arm: Callable[..., LocalDevice]) -> None:
    placed = arm(base={"position": [1.0, 0.0, 0.5], "frame_id": "table"})
    pose, local = placed.measured_cp(), placed.engine.feedback("local/measured_cp")
    assert local is not None
    assert pose.frame_id == "table"
    assert pose.position - local[0].position == pytest.approx((1.0, 0.0, 0.5))  # type: ignore[union-attr]
    assert "local/servo_cf" in placed.crtk_commands


def test_a_pause_of_the_process_is_no_jump_of_the_plant() -> None:
    clock = FakeClock()
    device = VirtualDevice(VirtualConfig(), clock.stamp)
    device.open(0.0)
    clock.advance(10.0)
    device.read(0.0)
    counters = device.counters
    assert counters["plant time (s)"] <= 0.05 + 1e-9
    assert counters["time left out (s)"] == pytest.approx(9.95)


def test_the_tool_moves_on_beside_a_joint_at_the_end_of_its_range() -> None:
    with crtk_drivers.connect("virtual", rate=100.0) as arm:
        arm.state_command("enable")
        limit = arm.engine.capabilities.limits[0].upper
        position = np.array(arm.setpoint_js().position)
        position[0] = limit
        arm.move_jp(position).wait(30.0)
        ahead, up = vector((np.cos(limit), np.sin(limit), 0.0)), vector((0.0, 0.0, 1.0))
        for way in (up, ahead, -up, -ahead):  # in none of which the first joint has a part
            begin = arm.measured_cp().position
            deadline = time.monotonic() + 20.0
            while (arm.measured_cp().position - begin) @ way < 0.03:
                assert time.monotonic() < deadline, "the tool stands"
                arm.servo_cv([*(0.1 * way), 0.0, 0.0, 0.0])
                time.sleep(0.01)
            arm.hold()
