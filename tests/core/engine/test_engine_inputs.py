"""Inputs that change what poses mean are taken at rest only, and count at once."""

import numpy as np
import pytest

from crtk_drivers.commands import Payload
from crtk_drivers.device import Input, MoveProgress
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.samples import Number, Pose, Twist, Vector, vector
from rigs.scripted_engine import Rig, SlideAndTurn, jp, pose


class LongTool(SlideAndTurn):
    def __init__(self, length: float) -> None:
        self.ahead = np.array((length, 0.0, 0.0))

    def forward(self, joints: Vector) -> Pose:
        found = super().forward(joints)
        return Pose(vector(found.position + self.ahead), found.orientation, "base")


class ToolRig(Rig):
    """A device whose tool may be made longer, along x."""

    length = 0.0

    def __init__(self) -> None:
        super().__init__()
        self.engine.inputs = {"tool": Input("its length", Payload.NUMBER, self._take, at_rest=True)}

    def _take(self, value: Number) -> None:
        self.length = value.value
        self.device.solver = LongTool(value.value)

    def refuses(self) -> None:
        before = len(self.told.refusals)
        with pytest.raises(CommandRefused, match="motion") as caught:
            self.engine.give("tool", Number(0.5))
        assert caught.value.reason is Reason.INVALID_TRANSITION
        assert self.told.refusals[before:] == [caught.value]
        assert self.length == 0.0


@pytest.fixture
def rig() -> ToolRig:
    rig = ToolRig()
    rig.enabled()
    return rig


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("servo_jp", jp(0.001, 0.0)),
        ("servo_cp", pose(0.001)),
        ("interpolate_jp", jp(0.5, 0.0)),
        ("interpolate_cp", pose(0.5)),
        ("move_jp", jp(0.5, 0.0)),
        ("free", None),
    ],
)
def test_it_is_refused_from_the_command_on_until_the_motion_is_over(rig, name, value):
    rig.engine.submit(name, value)
    rig.refuses()
    rig.cycle(3)
    if name == "servo_jp":  # whose position is held by itself, from the first cycle on
        rig.cycle(20)
    else:
        rig.refuses()
        rig.engine.submit("hold")
        rig.device.progress = MoveProgress.DONE
        rig.cycle(100)
    rig.engine.give("tool", Number(0.5))
    assert rig.length == 0.5


def test_the_pose_follows_it_at_once_and_the_joints_do_not_move(rig):
    rig.servo(0.05, 0.0)
    rig.cycle(40)
    before, _ = rig.value("setpoint_cp")
    writes = len(rig.written)
    rig.engine.give("tool", Number(0.5))
    after, _ = rig.value("setpoint_cp")
    assert after.position[0] == pytest.approx(before.position[0] + 0.5)
    assert rig.setpoint()["position"] == pytest.approx([0.05, 0.0])
    rig.cycle(10)
    assert len(rig.written) == writes


def test_another_tool_counts_for_twists_that_the_hardware_carries_out_as_well(rig):
    class Far(SlideAndTurn):
        """Its tool goes a hundred times as far as the joint."""

        def jacobian(self, joints):
            return 100.0 * super().jacobian(joints)

    twist = Twist(vector((0.2, 0, 0)), vector((0, 0, 0)))
    rig.device.position = np.array((0.999, 0.0))
    rig.cycle()
    rig.engine.submit("servo_cv", twist)
    rig.cycle()
    assert 0.0 < rig.written[-1].values[0] < 0.2, "slowed before the end of the range"
    rig.device.solver = Far()
    rig.engine.submit("servo_cv", twist)
    rig.cycle()
    assert rig.written[-1].values[0] == 0.2


def test_it_is_taken_in_any_state():
    rig = ToolRig()
    rig.connect()
    rig.engine.give("tool", Number(0.5))
    assert rig.length == 0.5
