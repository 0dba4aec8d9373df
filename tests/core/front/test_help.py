"""What a device says of itself at a prompt: `help`, `dir` and `repr`."""

import inspect
import pydoc
from collections.abc import Iterator

import pytest

import crtk_drivers
from crtk_drivers.commands import COMMANDS, Direction, Level, Payload
from crtk_drivers.device import Input, Reading, Service
from crtk_drivers.front import LocalDevice, local_devices
from crtk_drivers.front.method_forms import form_of, form_of_input, form_of_reading
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Flag
from crtk_drivers.session import Session
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.waiting import LONG


def nothing():
    yield
    return "done"


class Odd(LoopbackDevice):
    """A gantry with something of its own."""

    @property
    def services(self):
        return {"tare": Service("make the present load zero", nothing)}

    @property
    def inputs(self):
        return {"lamp": Input("switches the lamp", Payload.FLAG, lambda value: None)}

    @property
    def readings(self):
        return {"door": Reading("whether the door is open", Payload.FLAG, lambda: Flag(True))}

    @property
    def children(self):
        return {"wrist": self.wrist}

    def __init__(self, config: LoopbackConfig | None = None) -> None:
        super().__init__(config)
        self.wrist = LoopbackDevice(config)


PLUGIN = DevicePlugin("odd", "A gantry.", LoopbackConfig, Odd)


@pytest.fixture
def arm() -> Iterator[LocalDevice]:
    session = Session(PLUGIN, LoopbackConfig())
    with LocalDevice(session) as arm:
        session.start()
        yield arm


_RAISED = {
    Direction.PUBLISHED: ("DataTimeout", "ConnectionFailed"),
    Direction.COMMANDED: ("CommandRefused", "ConnectionLost", "ConnectionFailed", "DataTimeout"),
    Direction.SERVICE: ("CommandRefused", "KinematicsError", "ConnectionFailed", "DataTimeout"),
}


@pytest.mark.parametrize(
    "command",
    [each for each in COMMANDS.values() if each.name not in ("operating_state", "state_command")],
    ids=lambda each: each.name,
)
def test_each_command_has_a_form(command) -> None:
    form = form_of(command)
    assert form.doc.partition("\n")[0].endswith(".")
    assert "Raises:" in form.doc
    for error in _RAISED[command.direction]:
        assert error in form.doc.partition("Raises:")[2]
    assert ("MotionAborted" in form.doc) is (command.level is Level.MOVE)
    assert ("Returns:" in form.doc) is (form.signature.return_annotation != "None")
    if command.direction is Direction.PUBLISHED:
        assert form.is_feedback
    for name in form.signature.parameters:
        assert f"    {name}: " in form.doc


@pytest.mark.parametrize("payload", Payload)
def test_what_is_beyond_crtk_has_a_form_whatever_its_value(payload: Payload) -> None:
    assert "    value: " in form_of_input("sets it", payload).doc
    reading = form_of_reading("tells it", payload)
    assert reading.doc.startswith("Tells it.")
    assert f"    {reading.signature.return_annotation}: " in reading.doc


def test_a_reading_of_joints_is_a_joint_state() -> None:
    form = form_of_reading("where it is", Payload.JOINT_STATE)
    assert form.signature.return_annotation == "JointState"


def test_help_says_shapes_units_frame_and_errors(arm: LocalDevice) -> None:
    move = pydoc.render_doc(arm.move_jp, renderer=pydoc.plaintext)
    assert "move_jp(goal: 'JointsLike', /) -> 'Move'" in move
    assert "(n,) in rad (m)" in move
    assert "CommandRefused" in move
    pose = pydoc.render_doc(arm.measured_cp, renderer=pydoc.plaintext)
    assert "position (3,) in m, orientation (4,) a unit quaternion" in pose
    assert "base frame" in pose
    assert "DataTimeout" in pose
    twist = inspect.getdoc(arm.body.servo_cv) or ""
    assert "Along the axes of the tool, at the tool point." in " ".join(twist.split())
    position = inspect.getdoc(arm.measured_jp) or ""
    assert position.startswith("Return the measured joint positions.")


def test_help_of_a_device_lists_what_it_offers(arm: LocalDevice) -> None:
    text = pydoc.render_doc(arm, renderer=pydoc.plaintext)
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    for name, summary in arm.summaries().items():
        assert lines[name.replace("/", ".")].endswith(summary)
    assert lines["tare"].endswith("Make the present load zero.")
    assert "It offers" not in pydoc.render_doc(LocalDevice, renderer=pydoc.plaintext)


def test_dir_lists_what_is_offered(arm: LocalDevice) -> None:
    names = dir(arm)
    assert {"move_jp", "measured_jp", "body", "trajectory_j", "tare", "lamp", "wrist"} <= set(names)
    assert "use_gravity_compensation" not in names


def test_what_is_beyond_crtk_is_reached_by_attribute_and_by_name(arm: LocalDevice) -> None:
    assert arm.extras["tare"](timeout=LONG) == "done"
    raised = (inspect.getdoc(arm.tare) or "").partition("Raises:")[2]
    for error in ("CommandRefused", "DataTimeout", "TransitionFailed", "ConnectionLost"):
        assert error in raised
    assert arm.extras["state/door"]() is arm.state.door() is True
    assert arm.extras["lamp"](True) is None
    assert "value: True or False." in (inspect.getdoc(arm.lamp) or "")
    with pytest.raises(TypeError):
        arm.extras["other"] = print


def test_a_device_behind_it_is_reached_by_attribute_and_by_name(arm: LocalDevice) -> None:
    assert arm.child("wrist") is arm.wrist
    with pytest.raises(crtk_drivers.CrtkError, match=r"no device 'gripper'.*There is: wrist"):
        arm.child("gripper")
    with pytest.raises(crtk_drivers.CrtkError, match=r"Did you mean wrist\? There is: wrist"):
        arm.child("wirst")


def test_repr_says_state_and_address(arm: LocalDevice) -> None:
    arm.wait_for_operating_state("DISABLED", LONG)
    assert repr(arm) == "<odd DISABLED at loopback>"
    assert repr(arm.wrist) == "<odd 'odd/wrist' DISABLED at loopback>"
    arm.enable(LONG)
    assert repr(arm) == "<odd ENABLED at loopback>"
    arm.close()
    assert repr(arm) == "<odd closed at loopback>"
    assert repr(arm.wrist) == "<odd 'odd/wrist' closed at loopback>"


def test_repr_of_a_move_says_how_it_ended(arm: LocalDevice) -> None:
    arm.enable(LONG)
    move = arm.move_jp(arm.setpoint_jp() + 0.5)
    assert repr(move) == "<move_jp running>"
    arm.hold()
    with pytest.raises(crtk_drivers.CrtkError):
        move.wait(LONG)
    assert repr(move) == f"<move_jp {move.outcome}: {move.reason}>"


def test_a_kind_exists_for_annotations_only(arm: LocalDevice) -> None:
    assert crtk_drivers.Arm.__doc__
    with pytest.raises(TypeError):
        isinstance(arm, crtk_drivers.Arm)
    assert local_devices.Ur is LocalDevice
    with pytest.raises(AttributeError, match="no attribute 'Uhr'"):
        _ = local_devices.Uhr
