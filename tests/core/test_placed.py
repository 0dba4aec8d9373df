"""A device with kinematics or a place of its own: what is around it, and what goes through."""

from __future__ import annotations

import inspect
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_drivers.config import KinematicsConfig
from crtk_drivers.device import Device, Goal, JointLimits, Mode, Setpoint
from crtk_drivers.errors import ConfigError
from crtk_drivers.front import LocalDevice
from crtk_drivers.geometry.frames import inverse_pose, product
from crtk_drivers.geometry.quaternions import quaternion_from_rpy
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import JointState, Pose, Sample, Stamp, Twist, Vector, Wrench, vector
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import GantryKinematics, LoopbackConfig, LoopbackDevice
from crtk_drivers.wrappers.base_frame import PlacedDevice
from crtk_drivers.wrappers.forwarding import WrappedDevice
from crtk_drivers.wrappers.kinematic_model import ModelledDevice
from rigs.waiting import LONG

DATA = Path(__file__).parents[1] / "data"
TURNED = {"frame_id": "world", "position": [1.0, 2.0, 0.5], "rpy": [0.0, 0.0, math.pi / 2]}


def test_a_wrapper_passes_everything_on_that_a_device_has() -> None:
    missing = [
        name
        for name, member in inspect.getmembers(Device)
        if not name.startswith("_")
        and (callable(member) or isinstance(member, property))
        and name not in vars(WrappedDevice)
    ]
    assert missing == []


# ---------------------------------------------------------------------------------------------- a place


def session_of(plugin: DevicePlugin, values: dict[str, Any]) -> Iterator[LocalDevice]:
    session = Session(plugin, plugin.load_config(values, {}))
    with LocalDevice(session) as arm:
        session.start()
        arm.measured_js(wait=5.0)
        yield arm


GANTRY = DevicePlugin("gantry", "of the tests", LoopbackConfig, LoopbackDevice)


@pytest.fixture
def placed() -> Iterator[LocalDevice]:
    yield from session_of(GANTRY, {"base": TURNED})


def test_what_is_measured_is_in_the_other_frame_and_in_its_own_as_local(
    placed: LocalDevice,
) -> None:
    placed.enable()
    placed.move_jp([0.1, 0.2, 0.3, 0.0]).wait(LONG)
    pose, local = placed.setpoint_cp(), placed.forward_kinematics([0.1, 0.2, 0.3, 0.0])
    assert pose.frame_id == local.frame_id == "world"
    assert pose.position == pytest.approx([0.8, 2.1, 0.8], abs=1e-9)
    measured = placed.local.measured_cp()
    assert measured.frame_id == "local"
    assert measured.position == pytest.approx([0.1, 0.2, 0.3], abs=1e-2)


def test_commands_in_the_other_frame_and_in_its_own(placed: LocalDevice) -> None:
    placed.enable()
    turned = quaternion_from_rpy(0.0, 0.0, math.pi / 2)
    placed.move_cp(Pose(vector((0.8, 2.1, 0.8)), turned, "world")).wait(LONG)
    assert placed.setpoint_jp() == pytest.approx([0.1, 0.2, 0.3, 0.0], abs=1e-6)
    placed.local.move_cp([0.2, 0.0, 0.1, 0.0, 0.0, 0.0, 1.0]).wait(LONG)
    assert placed.setpoint_jp() == pytest.approx([0.2, 0.0, 0.1, 0.0], abs=1e-6)
    placed.move_cr([0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 1.0]).wait(LONG)
    assert placed.setpoint_jp()[0] == pytest.approx(0.25, abs=1e-6)  # its x is the world's y
    placed.local.move_cr([0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).wait(LONG)
    assert placed.setpoint_jp()[0] == pytest.approx(0.30, abs=1e-6)


numbers = st.floats(-1.0, 1.0)
three = st.tuples(numbers, numbers, numbers).map(vector)
poses = st.builds(lambda p, r: Pose(p, quaternion_from_rpy(*r.tolist()), "world"), three, three)


class Recorder(LoopbackDevice):
    """Keeps what it is told, and measures what it is told to."""

    def __init__(self, sample: Sample | None = None) -> None:
        super().__init__()
        self.sample = sample
        self.told: list[Setpoint | Goal] = []

    def read(self, deadline: float) -> Sample | None:
        return self.sample

    def write(self, setpoint: Setpoint) -> None:
        self.told.append(setpoint)

    def move(self, goal: Goal) -> None:
        self.told.append(goal)


@given(poses, poses, three, three)
def test_every_value_goes_there_and_back(
    base: Pose, tool: Pose, first: Vector, second: Vector
) -> None:
    inner = Recorder()
    device = PlacedDevice(inner, base)
    seven = vector((*tool.position, *tool.orientation))
    device.write(Setpoint(Mode.CARTESIAN_POSITION, seven))
    device.write(Setpoint(Mode.CARTESIAN_VELOCITY, vector((*first, *second))))
    device.move(Goal(pose=tool))
    position, velocity, goal = inner.told
    assert isinstance(position, Setpoint)
    assert isinstance(velocity, Setpoint)
    assert isinstance(goal, Goal)
    assert goal.pose is not None
    pose = product(inverse_pose(base), tool)
    assert position.values[:3] == pytest.approx(pose.position, abs=1e-9)
    assert goal.pose.position == pytest.approx(pose.position, abs=1e-9)
    back = Sample(
        Stamp(1, 1.0),
        {
            "measured_cp": Pose(position.values[:3], position.values[3:], "base"),
            "measured_cv": Twist(velocity.values[:3], velocity.values[3:], "base"),
            "measured_cf": Wrench(first, second, "tool"),
        },
    )
    found = PlacedDevice(Recorder(back), base).read(0.0)
    assert found is not None
    there, twist, wrench = (found.values[f"measured_c{kind}"] for kind in "pvf")
    assert isinstance(there, Pose)
    assert isinstance(twist, Twist)
    assert isinstance(wrench, Wrench)
    assert there.position == pytest.approx(tool.position, abs=1e-9)
    assert abs(there.orientation @ tool.orientation) == pytest.approx(1.0, abs=1e-9)
    assert twist.vector == pytest.approx((*first, *second), abs=1e-9)
    assert (wrench.frame_id, wrench.force.tolist()) == ("tool", first.tolist())


@given(poses, st.tuples(numbers, numbers, numbers, numbers).map(vector))
def test_the_jacobian_is_the_derivative_of_the_pose(base: Pose, joints: Vector) -> None:
    kinematics = PlacedDevice(LoopbackDevice(), base).kinematics
    jacobian = kinematics.jacobian(joints)
    for axis in range(3):
        step = 1e-6 * np.eye(4)[axis]
        after = kinematics.forward(vector(joints + step)).position
        found = (after - kinematics.forward(joints).position) / 1e-6
        assert jacobian[:3, axis] == pytest.approx(found, abs=1e-5)


def test_kinematics_that_change_while_it_is_open_do_so_at_the_place_as_well() -> None:
    class Longer(GantryKinematics):
        def forward(self, joints: Vector) -> Pose:
            found = super().forward(joints)
            return replace(found, position=vector(found.position + np.array((0.0, 0.0, 0.1))))

    class Changing(LoopbackDevice):
        kinematics = GantryKinematics("here")

    inner = Changing()
    device = PlacedDevice(inner, Pose(vector((1.0, 0, 0)), vector((0, 0, 0, 1)), "world"))
    joints = vector((0.2, 0.0, 0.0, 0.0))
    before = device.kinematics
    assert before is device.kinematics, "the same answers, the same object"
    inner.kinematics = Longer("here")
    assert before.forward(joints).position.tolist() == [1.2, 0.0, 0.0]
    assert device.kinematics.forward(joints).position.tolist() == [1.2, 0.0, 0.1]


# ---------------------------------------------------------------------------------------------- a model


class Joints(LoopbackDevice):
    """Six joints without kinematics."""

    def __init__(self, count: int = 7) -> None:
        super().__init__()
        names = tuple(f"axis{i}" for i in range(1, count + 1))
        limit = JointLimits(-2.0, 2.0, 1.0, 5.0, 50.0, 10.0)
        self._capabilities = replace(
            self._capabilities,
            joints=names,
            limits=(limit,) * count,
            modes=frozenset({Mode.JOINT_POSITION}),
            measured=("measured_js",),
            cartesian_limits=None,
            following=None,
        )
        self.sample = Sample(
            Stamp(7, 7.0),
            {"measured_js": JointState(vector([0.1] * count), vector([0.2] * count), name=names)},
        )

    @property
    def kinematics(self) -> None:
        return None

    def read(self, deadline: float) -> Sample | None:
        return self.sample


ROWS = [{"a": 0.0, "alpha": math.pi / 2, "d": 0.2}, {"a": 0.3}, {"a": 0.3, "theta": 0.5}]


def test_a_dh_table_gives_a_device_its_kinematics() -> None:
    config = KinematicsConfig.model_validate(
        {"dh": ROWS, "tool": {"position": [0.1, 0.0, 0.0]}, "position_only": True}
    )
    kinematics = ModelledDevice(Joints(3), config).kinematics
    assert kinematics is not None
    joints = vector((0.3, 0.4, -0.6))
    pose = kinematics.forward(joints)
    reach = 0.3 * math.cos(0.4) + 0.4 * math.cos(0.4 - 0.6 + 0.5)
    height = 0.2 + 0.3 * math.sin(0.4) + 0.4 * math.sin(0.4 - 0.6 + 0.5)
    expected = [reach * math.cos(0.3), reach * math.sin(0.3), height]
    assert pose.position == pytest.approx(expected, abs=1e-12)
    found = kinematics.inverse(pose, vector((0.2, 0.3, -0.5)))
    assert kinematics.forward(found).position == pytest.approx(expected, abs=1e-9)


def test_a_urdf_gives_every_sample_its_pose_and_twist_with_the_same_stamp() -> None:
    config = KinematicsConfig(
        urdf=str(DATA / "seven_axis.urdf"),
        base_link="pedestal",
        tip_link="flange",
        joints=tuple(f"a{i}" for i in range(1, 8)),
    )
    device = ModelledDevice(Joints(), config)
    sample = device.read(0.0)
    assert sample is not None
    assert sample.stamp.wall_ns == 7
    state, pose, twist = (sample.values[f"measured_{n}"] for n in ("js", "cp", "cv"))
    assert isinstance(state, JointState)
    assert isinstance(pose, Pose)
    assert isinstance(twist, Twist)
    assert state.name[0] == "axis1"
    ahead = device.kinematics.forward(vector(state.position + 1e-6 * state.velocity))
    assert (ahead.position - pose.position) / 1e-6 == pytest.approx(twist.linear, abs=1e-5)


@pytest.mark.parametrize(
    ("values", "count", "text"),
    [
        ({"dh": ROWS}, 4, "3 rows for 4 joints"),
        ({"urdf": "/nowhere.urdf"}, 3, "nowhere.urdf"),
        ({"urdf": str(DATA / "seven_axis.urdf"), "joints": ["a", "b"]}, 3, "2 names for 3 joints"),
    ],
)
def test_a_model_that_does_not_fit_is_refused(
    values: dict[str, Any], count: int, text: str
) -> None:
    with pytest.raises(ConfigError, match=text):
        ModelledDevice(Joints(count), KinematicsConfig.model_validate(values))


def test_a_device_with_kinematics_takes_no_model() -> None:
    with pytest.raises(ConfigError, match="has kinematics of its own"):
        ModelledDevice(LoopbackDevice(), KinematicsConfig.model_validate({"dh": ROWS}))


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"kinematics": {}}, "give urdf or dh"),
        ({"kinematics": {"dh": ROWS, "urdf": "x"}}, "give urdf or dh"),
        ({"base": {"orientation": [0, 0, 0, 2]}}, "norm of 1"),
        ({"base": {"orientation": [0, 0, 0, 1], "rpy": [0, 0, 0]}}, "not both"),
    ],
)
def test_the_configuration_says_what_is_wrong(values: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError, match=text):
        GANTRY.load_config(values, {})
