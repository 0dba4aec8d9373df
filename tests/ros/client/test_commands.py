"""`crtk-driver state`, `enable`, `move`, `echo`, `call`: what they print, do, and end with."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import queue
import re
import signal
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Self

import numpy as np
import pytest
import yaml
from crtk_msgs.msg import OperatingState as OperatingStateMessage
from geometry_msgs.msg import TwistStamped
from sensor_msgs.msg import JointState
from std_msgs.msg import Empty

from crtk_drivers import client
from crtk_drivers.cli import hold_command, move_command, typed_goals
from crtk_drivers.cli.echo_command import as_yaml
from crtk_drivers.cli.reaching import Interrupted
from crtk_drivers.client import RemoteDevice, move_handle
from crtk_drivers.client.survey import reported
from crtk_drivers.commands import Payload
from crtk_drivers.device import Condition, Reading, Service, Steps
from crtk_drivers.errors import CommandRefused, DeviceFault, Reason
from crtk_drivers.front import base
from crtk_drivers.samples import Number, Pose
from crtk_drivers.state import OperatingState
from crtk_drivers.testing.loopback import PLUGIN, LoopbackConfig, LoopbackDevice
from rigs.loopback_client import Far, Node, far_device
from rigs.loopback_node import serve, slowly
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.ros
NAMESPACE = "/client_commands"

FOUND = ("--timeout", str(LONG))
"""On a busy machine."""

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def shared() -> Iterator[Far]:
    with far_device(NAMESPACE) as far:
        far.arm.add("operating_state")
        yield far


@pytest.fixture
def far(shared: Far) -> Far:
    shared.reset()
    return shared


class Kept(RemoteDevice):
    """A client that stays connected for the next command: to find a device may take three seconds."""

    def close(self) -> None:
        """Leave it to the fixture that opened it."""


@pytest.fixture
def run(run_far: Run, far: Far, monkeypatch: pytest.MonkeyPatch) -> Run:
    """As `run_far`, with the client that is connected already."""
    device = Kept(far.arm._space)
    monkeypatch.setattr(client, "connect", lambda namespace, timeout: device)
    return run_far


@pytest.fixture
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """For what is waited for in vain, the setpoint of what is DISABLED."""
    monkeypatch.setattr(base, "DEFAULT_WAIT", 3.0)


@pytest.mark.usefixtures("soon")
def test_state_tells_who_is_there_and_how_one_is(far: Far, run_far: Run) -> None:
    code, out, _ = run_far("state")
    assert code == 0
    assert re.search(rf"^{NAMESPACE} +DISABLED  homed", out, re.MULTILINE)
    code, out, _ = run_far("state", NAMESPACE, *FOUND)
    assert code == 0
    assert "DISABLED  homed\nnext: crtk-driver enable /client_commands\n" in out
    assert re.search(r"^joint_x +0\.0000 +-1 \.\. 1$|^x +0\.0000", out, re.MULTILINE)
    assert "tool  0.0000 0.0000 0.0000 m  0.0000 0.0000 0.0000 1.0000" in out
    assert "move_jp/jr" in out


def test_state_tells_the_reason_of_a_fault(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    # All have met, and been heard, before: what is waited for is the setpoint alone, in vain in FAULT.
    far.arm.add("measured_js", "measured_cp", "setpoint_js")
    far.arm.measured_js(), far.arm.measured_cp()
    monkeypatch.setattr(base, "DEFAULT_WAIT", 1.0)
    far.device.reported = Condition(OperatingState.FAULT, "the door is open")
    eventually(
        lambda: far.arm.operating_state().state is OperatingState.FAULT, "the fault is heard of"
    )
    code, out, _ = run("state", NAMESPACE)
    assert code == 0
    assert re.search(r"^FAULT  homed\nreason: .*the door is open", out, re.MULTILINE)
    assert "\nnext: remove the cause, then crtk-driver enable" in out
    far.device.reported = Condition(OperatingState.FAULT, "the door is open. Close it.")
    eventually(lambda: "Close it" in reported(far.arm).text, "the remedy is heard of")
    _, out, _ = run("state", NAMESPACE)
    assert "Close it" in out
    assert "\nnext: do what the reason says, then crtk-driver enable" in out


@pytest.mark.usefixtures("soon")
def test_state_names_a_loss_that_is_over(far: Far, run: Run) -> None:
    """Who looks a second later learns of it, too: by `/diagnostics`, which is what `state` shows."""
    losses = far.engine.health().reconnects
    far.device.reachable = False
    eventually(lambda: far.engine.health().reconnects > losses, "the link is lost")
    far.device.reachable = True
    eventually(lambda: far.engine.connected, "it is back")
    eventually(lambda: far.arm.operating_state().state is OperatingState.DISABLED, "it is heard of")
    code, out, _ = run("state", NAMESPACE)
    assert code == 0
    reason = "the link was lost (loopback: the link is gone) and is back"
    assert f"DISABLED  homed\nreason: {reason}\nnext: crtk-driver enable" in out


@pytest.mark.usefixtures("soon")
def test_state_names_what_is_beyond_crtk_and_units(run_far: Run) -> None:
    class Served(LoopbackDevice):
        @property
        def services(self) -> Mapping[str, Service]:
            return {"tare": Service("make it zero", lambda: iter(()))}  # type: ignore[arg-type]

        @property
        def readings(self) -> Mapping[str, Reading]:
            flags = (f"digital_in_{number}" for number in range(3))
            return {name: Reading("whether it is on", Payload.FLAG, lambda: None) for name in flags}

    namespace = "/client_served"
    with serve(LoopbackConfig(), namespace, [], plugin=replace(PLUGIN, create=Served)):
        code, out, _ = run_far("state", namespace, *FOUND)
        with client.connect(namespace, timeout=LONG) as arm:
            joints = {each["name"]: each["unit"] for each in arm.manifest["joints"]}
    assert code == 0
    assert re.search(r"^services: .*  tare$", out, re.MULTILINE)
    assert re.search(r"^readings: state/digital_in_0…2$", out, re.MULTILINE)
    assert "inputs:" not in out
    assert joints == {"x": "m", "y": "m", "z": "m", "yaw": "rad"}


@pytest.mark.slow
def test_state_tells_that_a_driver_is_connecting(run_far: Run) -> None:
    opens = threading.Event()

    class Slow(LoopbackDevice):
        def open(self, deadline: float) -> None:
            opens.wait(max(0.0, deadline - time.monotonic()))
            super().open(deadline)

    namespace, settings = "/client_connecting", LoopbackConfig(open_timeout=60.0)
    plugin = replace(PLUGIN, create=Slow)
    with serve(settings, namespace, [], plugin=plugin, connects=False):
        try:
            code, out, _ = run_far("state", namespace)
            _, everybody, _ = run_far("state")
            _, _, refusal = run_far("enable", namespace)
        finally:
            opens.set()
    assert code == 0
    assert re.search(r"^connecting to loopback since \d\d:\d\d:\d\d\nnext: wait", out, re.MULTILINE)
    assert "FAULT" not in out
    assert re.search(rf"^{namespace} +connecting to loopback since", everybody, re.MULTILINE)
    assert "connecting to loopback since" in refusal


def test_a_failed_enable_says_why(far: Far, run: Run) -> None:
    far.device.transition_time = 4.0
    transitions = far.engine._transitions

    def lose() -> None:
        eventually(lambda: transitions.leads_to is OperatingState.ENABLED, "it is being enabled")
        far.device.reachable = False
        far.device.transition_time = 0.0

    other = threading.Thread(target=lose)
    other.start()
    code, _, err = run("enable", NAMESPACE)
    other.join()
    assert code == 1
    assert re.search(r"enable ended in FAULT: .*(the link is gone|no answer)", err)
    assert "What comes next: crtk-driver state /client_commands" in err


def test_enable_that_leaves_a_fault_says_so_at_once(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The state does not change: it is the answer to the command that ends the waiting."""

    def shut() -> Steps:
        raise DeviceFault("the door is open", remedy="Close it.")

    monkeypatch.setattr(far.device, "_transition", shut)
    far.device.reported = Condition(OperatingState.FAULT, "the door is open")
    eventually(
        lambda: far.arm.operating_state().state is OperatingState.FAULT, "the fault is heard of"
    )
    code, _, err = run("enable", NAMESPACE)
    assert code == 1
    assert "enable: the door is open. Close it." in " ".join(err.split())
    assert "in time" not in err


def test_home_needs_no_hold_of_a_sensor(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    far.arm.enable()
    offered = {name: each for name, each in far.arm.crtk_commands.items() if name != "hold"}
    monkeypatch.setattr(RemoteDevice, "crtk_commands", offered)
    assert run("home", NAMESPACE)[:2] == (0, f"{NAMESPACE}  ENABLED  homed\n")


def test_nothing_moves_that_is_not_enabled(far: Far, run: Run) -> None:
    code, out, err = run("move", NAMESPACE, "0.1", "0", "0", "0")
    assert (code, out) == (1, "")
    assert "the device is DISABLED" in err
    assert "crtk-driver enable /client_commands" in err
    far.arm.enable()
    far.arm.pause()
    code, _, err = run("move", NAMESPACE, "0.1", "0", "0", "0")
    assert code == 1
    assert "the device is PAUSED" in err
    assert "crtk-driver resume /client_commands" in err
    assert np.allclose(far.arm.measured_jp(), 0.0, atol=1e-6)


def test_the_operating_state_is_commanded(far: Far, run: Run) -> None:
    for command, state in (
        ("enable", "ENABLED"),
        ("pause", "PAUSED"),
        ("resume", "ENABLED"),
        ("home", "ENABLED"),
        ("disable", "DISABLED"),
    ):
        assert run(command, NAMESPACE)[:2] == (0, f"{NAMESPACE}  {state}  homed\n")
    code, _, err = run("resume", NAMESPACE)
    assert code == 1
    assert "resume is invalid in DISABLED" in err
    assert run("hold", NAMESPACE)[0] == 0


def test_moves(far: Far, run: Run) -> None:
    far.arm.enable()
    names = far.arm.measured_js().name

    def arrives(goal: list[float], *arguments: str) -> None:
        code, out, err = run("move", NAMESPACE, *arguments)
        assert (code, err) == (0, "")
        assert re.match(r"reached in \d+\.\d s\n", out)
        # What told that it is reached may be another topic.
        eventually(lambda: np.allclose(far.arm.setpoint_jp(), goal, atol=1e-3), f"it is at {goal}")

    arrives([0.02, -0.03, 0.0, 0.1], "0.02", "-0.03", "-0e-3", ".1")
    arrives([0.02, -0.03, 0.01, 0.1], f"{names[2]}=0.01")
    arrives([0.0, -0.03, 0.01, 0.1], "--relative", f"{names[0]}=-0.02")
    arrives([0.0, -0.03, 0.01, np.radians(3.0)], "--degrees", f"{names[3]}=3")
    arrives([0.01, 0.0, 0.0, np.radians(3.0)], "--pose", "0.01", "0", "0")
    arrives([0.0, 0.0, 0.0, np.radians(3.0)], "--pose", "--relative", "-0.01", "0", "0")
    arrives([0.0, 0.0, 0.0, 0.0], "--pose", "0", "0", "0", "0", "0", "0", "1")


def test_a_slow_move_is_slow_and_the_next_is_not(far: Far, run: Run) -> None:
    far.arm.enable()
    ratios = far.arm.trajectory_j
    ratios.set_ratio_a(0.5)
    eventually(lambda: ratios.ratio_a() == 0.5, "it was so before")
    distance, share = 0.05, 0.1
    least = distance / (share * far.engine.capabilities.limits[0].velocity)
    code, out, _ = run("move", NAMESPACE, "--speed", f"{share}", str(distance), "0", "0", "0")
    assert code == 0
    assert float(out.split()[2]) >= least - 0.05, "it is shown in tenths of a second"
    eventually(lambda: (ratios.ratio_v(), ratios.ratio_a()) == (1.0, 0.5), "it is as before")
    ratios.set_ratio(1.0)


def test_another_clients_share_of_speed_ends_a_slow_move(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    far.arm.enable()
    submit = far.engine.submit

    def after_another(name: str, *rest: object, **more: object) -> None:
        if name == "move_jp":
            submit("trajectory_j/set_ratio", Number(1.0))
        submit(name, *rest, **more)

    monkeypatch.setattr(far.engine, "submit", after_another)
    with slowly(far.engine):
        code, _, err = run("move", NAMESPACE, "--speed", "0.1", "0.95", "0", "0", "0")
    assert code == 1
    assert "another client has changed the share" in err
    assert not far.engine.status.is_busy
    assert far.arm.setpoint_jp()[0] < 0.9
    assert far.arm.trajectory_j.ratio_v() == 1.0


def test_an_interrupted_slow_move_holds_and_puts_the_speed_back(far: Far, run: Run) -> None:
    far.arm.enable()

    def interrupt() -> None:
        eventually(lambda: far.arm.measured_jp()[0] > 0.01, "it is on its way")
        os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=interrupt)
    thread.start()
    code, _, err = run("move", NAMESPACE, "--speed", "0.1", "0.5", "0", "0", "0")
    thread.join()
    assert code == 130
    assert "hold was sent to /client_commands, and it stands still" in err
    ratios = far.arm.trajectory_j
    eventually(lambda: (ratios.ratio_v(), ratios.ratio_a()) == (1.0, 1.0), "it is as before")


class Shares:
    """The shares of a device, and a signal that comes as they are asked for, or set, the n-th time."""

    def __init__(self, signal_at: int) -> None:
        self.velocity, self.acceleration = 1.0, 0.5
        self.left = signal_at
        self.namespace, self.holds = "/shares", 0

    def hold(self) -> None:
        self.holds += 1

    @property
    def trajectory_j(self) -> Shares:
        return self

    def _step(self) -> None:
        self.left -= 1
        if self.left == 0:
            raise Interrupted

    def ratio_v(self) -> float:
        self._step()
        return self.velocity

    def ratio_a(self) -> float:
        self._step()
        return self.acceleration

    def set_ratio(self, value: float) -> None:
        self.velocity = self.acceleration = value
        self._step()

    def set_ratio_a(self, value: float) -> None:
        self.acceleration = value
        self._step()


@pytest.mark.parametrize("ends", ["well", "by an error"])
@pytest.mark.parametrize("signal_at", range(1, 6))
def test_shares_of_speed_are_put_back_whenever_a_signal_comes(
    monkeypatch: pytest.MonkeyPatch, signal_at: int, ends: str
) -> None:
    monkeypatch.setattr(move_command, "need", lambda device, name: None)
    device: Any = Shares(0)
    with suppress(Interrupted, ValueError), move_command._at_speed(device, 0.1, lambda: None):
        assert (device.velocity, device.acceleration) == (0.1, 0.1)
        device.left = signal_at
        if ends == "by an error":
            raise ValueError
    assert (device.velocity, device.acceleration) == (1.0, 0.5)


@pytest.mark.parametrize("signal_at", [0, 2])
def test_an_interrupt_stays_one_where_the_share_is_refused(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], signal_at: int
) -> None:
    """It comes within, or while the share is put back."""
    monkeypatch.setattr(move_command, "need", lambda device, name: None)
    device: Any = Shares(0)

    def refuse(value: float) -> None:
        raise CommandRefused("set_ratio", Reason.NOT_ENABLED, "it is busy")

    def end() -> None:
        with move_command._at_speed(device, 0.1, lambda: None):
            monkeypatch.setattr(device, "set_ratio", refuse)
            device.left = signal_at
            if not signal_at:
                raise Interrupted

    with pytest.raises(Interrupted):
        end()
    assert device.holds == (not signal_at)  # at the end of a move it is for the caller to hold
    told = " ".join(capsys.readouterr().err.split())
    assert "/shares: the share of its speed was not put back to 1: " in told
    assert "it is busy" in told


@pytest.mark.parametrize("lost_in", ["set_ratio", "ratio_v"])
def test_a_signal_that_is_lost_while_the_share_is_set_sends_no_goal(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch, lost_in: str
) -> None:
    """rclpy swallows an exception that is raised while it makes a message."""
    far.arm.enable()
    far.arm.add("trajectory_j/set_ratio", "trajectory_j/ratio_v")
    ratios, came = far.arm.trajectory_j, []
    original, submit = getattr(ratios, lost_in), far.engine.submit

    def losing(*values: float) -> Any:
        if signal.getsignal(signal.SIGTERM) not in (signal.SIG_IGN, signal.SIG_DFL):
            with suppress(Interrupted):
                os.kill(os.getpid(), signal.SIGTERM)
                time.sleep(0.01)
        return original(*values)

    def heard(name: str, *rest: Any, **more: Any) -> Any:
        came.append(name)
        return submit(name, *rest, **more)

    monkeypatch.setattr(far.engine, "submit", heard)
    monkeypatch.setattr(Kept, "trajectory_j", ratios, raising=False)
    monkeypatch.setattr(ratios, lost_in, losing)
    code, _, err = run("move", NAMESPACE, "--speed", "0.1", "0.5", "0", "0", "0")
    assert code == 130, err
    assert "move_jp" not in came


def test_a_share_of_speed_that_is_not_taken_moves_nothing(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(move_command, "START_TIMEOUT", 0.2)
    submit = far.engine.submit

    def without_shares(name: str, *rest: object, **more: object) -> None:
        if name != "trajectory_j/set_ratio":
            submit(name, *rest, **more)

    monkeypatch.setattr(far.engine, "submit", without_shares)
    far.arm.enable()
    code, _, err = run("move", NAMESPACE, "--speed", "0.1", "0.1", "0", "0", "0")
    assert code == 1
    assert "did not report" in err
    assert np.allclose(far.arm.measured_jp(), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["0.1", "0", "0", "0", "--speed", "0"], 2, "--speed"),
        (["0.1", "0", "0", "0", "--speed", "nan"], 2, "--speed"),
        (["0.1", "0.2"], 2, "2 values for 4 joints"),
        (["0.1"], 2, "1 value for 4 joints"),
        (["17", "0", "0", "0"], 1, "Values are in rad or m; --degrees takes degrees."),
        (["elbow=1"], 2, "elbow: no such joint"),
        (["=0.1"], 2, "'=0.1' names no joint"),
        (["body=1"], 2, "is a part of the device, and takes no joint values"),
        (["0.1", "0", "0", "fast"], 2, f"{NAMESPACE} value 4, of yaw: 'fast' is not a number"),
        (["0.1", "0", "0", "--fast"], 2, "--fast: no such option"),
        (["--pose", "1", "2"], 2, "2 numbers are no pose"),
        (["--pose", "0", "0", "0", "1", "1", "1", "1"], 2, "no unit quaternion"),
        (["9", "0", "0", "0"], 1, "move_jp refused (out_of_range)"),
    ],
)
def test_a_move_that_cannot_be_is_refused(
    far: Far, run: Run, arguments: list[str], code: int, message: str
) -> None:
    far.arm.enable()
    got, out, err = run("move", NAMESPACE, *arguments)
    assert (got, out) == (code, "")
    assert message in err
    assert np.allclose(far.arm.measured_jp(), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message", "example"),
    [
        (["yaw"], "yaw: has no value", "yaw=0"),
        (["x=0.1", "yaw"], "yaw: has no value", "yaw=0"),
        (["x=0.1", "yaw="], "yaw: has no value", "yaw=0"),
        (["x=abc"], "x: 'abc' is not a number", "x=0"),
        (["abc"], "value 1: 'abc' is not a number", "yaw=0"),
        (["ya"], "value 1: 'ya' is not a number", "yaw=0"),
        (["0", "abc", "0", "0"], "value 2, of y: 'abc' is not a number", "y=0"),
        (["0.1", "x=0.1"], "0.1 is for no joint: some joints were named", "yaw=0"),
        (["0.1"], "1 value for 4 joints", "yaw=0"),
        (["elbow=1"], "elbow: no such joint", "yaw=0"),
        (["yam=1"], "yam: no such joint", "yaw=0"),
        (["--degrees", "yaw"], "yaw: has no value", "--degrees yaw=0"),
        (["--degrees", "x"], "x: --degrees is for angles, and this joint is in m", "x=0"),
        (["--degrees", "x=1"], "x: --degrees is for angles, and this joint is in m", "x=0"),
        (["--degrees", "0", "0", "0", "3"], "x: --degrees is for angles", "x=0"),
        (["--relative", "x"], "x: has no value", "--relative x=0.01"),
    ],
)
def test_what_was_mistyped_is_answered_with_an_example_that_works(
    far: Far, run: Run, arguments: list[str], message: str, example: str
) -> None:
    far.arm.enable()
    code, _, err = run("move", NAMESPACE, *arguments)
    assert code == 2
    assert message in err
    if "--degrees" not in arguments:
        assert "Give one number for each of x, y, z, yaw; or joint=number for some:" in err
    unit = "degrees" if "--degrees" in example else "rad" if "yaw" in example else "m"
    assert f"move {NAMESPACE} {example} ({unit}, " in err
    assert ("Did you mean yaw?" in err) == (arguments[0] in ("ya", "yam=1"))
    code, _, err = run("move", NAMESPACE, *example.split())
    assert (code, err) == (0, "")


def test_a_pose_that_was_mistyped_names_its_part(far: Far, run: Run) -> None:
    far.arm.enable()
    code, _, err = run("move", NAMESPACE, "--pose", "0", "0", "up")
    assert code == 2
    assert "--pose value 3, z: 'up' is not a number" in err
    assert f"move {NAMESPACE} --pose --relative 0 0 0.01" in err


def test_an_interrupt_holds_the_arm(far: Far, run: Run) -> None:
    far.arm.enable()

    def interrupt() -> None:
        eventually(lambda: far.arm.measured_jp()[0] > 0.01, "it is on its way")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    with slowly(far.engine):
        code, _, err = run("move", NAMESPACE, "0.95", "0", "0", "0")
    thread.join()
    assert code == 130
    assert "hold was sent to /client_commands, and it stands still" in err
    assert far.engine.status.state is OperatingState.ENABLED
    assert 0.01 < far.arm.setpoint_jp()[0] < 0.9
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_move_that_never_begins_is_followed_by_a_hold(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its command is late, or lost: it must move nothing when nobody looks any more."""
    far.arm.enable()
    came: list[str] = []
    monkeypatch.setattr(far.engine, "submit", lambda name, *rest, **more: came.append(name))
    monkeypatch.setattr(move_handle, "ACCEPT_TIMEOUT", 0.05)
    monkeypatch.setattr(move_command, "START_TIMEOUT", 0.0)
    code, _, err = run("move", NAMESPACE, "0.95", "0", "0", "0")
    assert code == 1
    assert "was never busy" in err
    eventually(lambda: came == ["move_jp", "hold"], "it is told to hold")


def test_hold_says_when_the_device_stands(far: Far, run: Run) -> None:
    far.arm.enable()
    with slowly(far.engine):
        move = far.arm.move_jp([0.95, 0.0, 0.0, 0.0])
        assert move.is_busy()
        code, out, err = run("hold", NAMESPACE)
        assert not far.engine.status.is_busy
    assert (code, err) == (0, "")
    assert re.fullmatch(rf"{NAMESPACE}  stands, seen \d+\.\d s after hold was sent\n", out)


def test_hold_of_a_device_that_moves_on_says_what_to_do(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    far.arm.enable()
    submit = far.engine.submit

    def deaf(name: str, *rest: Any, **more: Any) -> Any:
        return None if name == "hold" else submit(name, *rest, **more)

    monkeypatch.setattr(hold_command, "STOP_TIMEOUT", 0.5)
    with slowly(far.engine), monkeypatch.context() as patched:
        patched.setattr(far.engine, "submit", deaf)
        far.arm.move_jp([0.95, 0.0, 0.0, 0.0])
        code, out, err = run("hold", NAMESPACE)
    far.arm.hold()
    assert (code, out) == (1, "")
    told = " ".join(err.split())
    assert re.search(
        r"hold was sent, and it is not seen to stand after \d+\.\d s: it is still busy", told
    )
    assert "press its emergency stop. More: crtk-driver state /client_commands" in told


class Moved:
    """A device of another maker that says where it is; of its operating state it is silent, or has none."""

    def __init__(
        self, namespace: str, *, speed: float, place: bool = True, mute: bool = False
    ) -> None:
        self.namespace = namespace
        self._speed, self._place, self._mute = speed, place, mute
        self._stop = threading.Event()
        self._made = Node(namespace.strip("/"))
        self.holds = 0

    def __enter__(self) -> Self:
        node = self._made.__enter__().node
        node.create_subscription(Empty, f"{self.namespace}/hold", self._hold, 10)
        if self._mute:
            node.create_publisher(OperatingStateMessage, f"{self.namespace}/operating_state", 10)
        # Something is published in any case: who listens only is not found as a device.
        name = "measured_js" if self._place else "setpoint_js"
        publisher = node.create_publisher(JointState, f"{self.namespace}/{name}", 10)

        def publish() -> None:
            message, begun = JointState(), time.monotonic()
            while not self._stop.wait(0.01):
                message.header.stamp = node.get_clock().now().to_msg()
                message.position = [0.5 + self._speed * (time.monotonic() - begun)]
                publisher.publish(message)

        self._thread = threading.Thread(target=publish)
        self._thread.start()
        return self

    def _hold(self, message: Empty) -> None:
        self.holds += 1

    def __exit__(self, *details: object) -> None:
        self._stop.set()
        self._thread.join()
        self._made.__exit__(*details)


@pytest.mark.parametrize(
    ("device", "code", "says"),
    [
        ({"speed": 0.0}, 0, r"stands, seen \d+\.\d s after"),
        ({"speed": 1.0}, 1, "measured_js still changes"),
        ({"speed": 0.01}, 1, "measured_js still changes"),
        ({"speed": 0.0, "place": False}, 0, "does not report whether it stands"),
        ({"speed": 1.0, "mute": True}, 1, "hold was sent, .* measured_js still changes"),
    ],
    ids=["stands", "moves", "creeps", "says nothing", "moves with a silent state"],
)
def test_hold_of_a_device_without_operating_state(
    run_far: Run, device: dict[str, Any], code: int, says: str
) -> None:
    with Moved("/stateless", **device) as moved:
        ended, out, err = run_far("hold", moved.namespace, *FOUND)
        eventually(lambda: moved.holds, "it was told to hold")
    assert ended == code
    assert re.search(says, " ".join((out + err).split()))


def test_hold_of_a_sensor_says_what_it_offers(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    offered = {name: each for name, each in far.arm.crtk_commands.items() if name != "hold"}
    monkeypatch.setattr(RemoteDevice, "crtk_commands", offered)
    code, _, err = run("hold", NAMESPACE)
    assert code
    assert "does not offer hold" in err


def _shown_at(how: str, *arguments: str) -> subprocess.Popen[bytes]:
    """Start a command in a shell that redirects what it shows."""
    script = f'exec "$0" -m crtk_drivers.cli "$@" {how}'
    return subprocess.Popen(["sh", "-c", script, sys.executable, *arguments])


@pytest.mark.real_time  # a shell
@pytest.mark.parametrize("how", ["2>/dev/full", "2>&-", ">/dev/full 2>&1", "<&- >&- 2>&-"])
@pytest.mark.parametrize("command", ["hold", "pause", "disable"])
@pytest.mark.sweep(4)
def test_a_stop_is_sent_whatever_its_output(far: Far, command: str, how: str) -> None:
    far.arm.enable()
    with slowly(far.engine):
        far.arm.move_jp([0.95, 0.0, 0.0, 0.0])
        child = _shown_at(how, command, NAMESPACE, *FOUND)
        code = child.wait(LONG)
        assert not far.engine.status.is_busy, "it was not stopped"
    assert far.arm.setpoint_jp(age=0)[0] < 0.9
    wanted = {"hold": "ENABLED", "pause": "PAUSED", "disable": "DISABLED"}[command]
    assert far.engine.status.state == wanted
    assert code == 0 or ">/dev/full" in how


@pytest.mark.real_time  # a shell
@pytest.mark.parametrize("how", ["2>/dev/full", "2>&-", ">/dev/full 2>&1"])
@pytest.mark.sweep(2)
def test_an_interrupted_move_holds_whatever_its_output(far: Far, how: str) -> None:
    far.arm.enable()
    child = _shown_at(how, "move", NAMESPACE, "0.95", "0", "0", "0", *FOUND)
    with slowly(far.engine):
        eventually(lambda: far.engine.status.is_busy, "it moves")
        child.send_signal(signal.SIGINT)
        child.wait(LONG)
        eventually(lambda: not far.engine.status.is_busy, "it is held")
    assert far.arm.setpoint_jp()[0] < 0.9


def test_a_move_whose_display_fails_is_held(
    far: Far, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    far.arm.enable()
    made = typed_goals.joint_goal

    def fail() -> str:
        raise OSError("no space left")

    def failing(*arguments: Any) -> typed_goals.Goal:
        return replace(made(*arguments), to_go=fail)

    monkeypatch.setattr(move_command, "joint_goal", failing)
    with slowly(far.engine):
        with pytest.raises(OSError, match="no space"):
            run("move", NAMESPACE, "0.95", "0", "0", "0")
        eventually(lambda: not far.engine.status.is_busy, "it is held")
    assert far.arm.setpoint_jp(age=0)[0] < 0.9


@pytest.mark.slow
def test_a_terminal_that_is_gone_holds_the_arm(far: Far) -> None:
    """What is written there fails, also while it is taken away what showed how it goes."""
    far.arm.enable()
    ours, theirs = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-m", "crtk_drivers.cli", "move", NAMESPACE, "0.95", "0", "0", "0"],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )
    os.close(theirs)
    os.set_blocking(ours, False)

    def moves() -> bool:
        with suppress(BlockingIOError):  # it would wait for room in the terminal
            os.read(ours, 65536)
        return far.arm.is_busy()

    with slowly(far.engine):
        eventually(moves, "it moves")
        os.close(ours)
        child.wait(30.0)
    eventually(lambda: not far.arm.is_busy(), "it is held")
    assert far.arm.setpoint_jp()[0] < 0.9


def test_echo_tells_what_was_said_before(far: Far, run_far: Run) -> None:
    with pytest.raises(CommandRefused):
        far.arm.move_jp([0.0] * 4)
    code, out, err = run_far("echo", NAMESPACE, "refusals", "--once", *FOUND)
    assert code == 0, err
    assert json.loads(yaml.safe_load(out)["data"])["reason"]  # the oldest of the last ones


def test_what_was_said_before_is_told_whoever_heard_it_already(far: Far) -> None:
    with pytest.raises(CommandRefused):
        far.arm.move_jr([0.1] * 4)
    first: queue.Queue[str] = queue.Queue()
    end = far.arm.on_message("refusals", lambda message: first.put(message.data))
    while "move_jr" not in (newest := first.get(timeout=LONG)):
        pass
    second: list[str] = []
    end_second = far.arm.on_message("refusals", lambda message: second.append(message.data))
    end(), end_second()
    assert second == [newest]


def test_echo(far: Far, run: Run) -> None:
    code, out, _ = run("echo", NAMESPACE, "measured_js", "--once")
    assert code == 0
    assert yaml.safe_load(out)["name"] == list(far.arm.measured_js().name)
    code, out, _ = run("echo", NAMESPACE, "operating_state", "--once")
    assert yaml.safe_load(out)["state"] == "DISABLED"
    code, out, err = run("echo", NAMESPACE, "mesured_js", "--once")
    assert (code, out) == (1, "")
    assert "Did you mean measured_js?" in err


def test_echo_ends_with_ctrl_c_and_tells_the_rate(far: Far, run: Run) -> None:
    far.arm.add("measured_cv")

    def interrupt() -> None:
        inbox = far.arm._space.link.inbox(f"{NAMESPACE}/measured_cv", TwistStamped)
        eventually(lambda: bool(inbox._listeners), "echo listens")
        os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=interrupt)
    thread.start()
    code, _, err = run("echo", NAMESPACE, "measured_cv", "--rate", "1")
    thread.join()
    assert code == 0
    assert re.search(r"\d+ values of measured_cv in [\d.]+ s: [\d.]+ Hz", err)


def test_call(far: Far, run: Run) -> None:
    joints = [0.1, 0.2, 0.3, 0.4]
    code, out, _ = run("call", NAMESPACE, "forward_kinematics", *map(str, joints))
    assert code == 0
    position = yaml.safe_load(out)["cp"]["position"]
    assert position == {"x": 0.1, "y": 0.2, "z": 0.3}
    where = ["cp.position.x=0.1", "cp.orientation={x: 0, y: 0, z: 0, w: 1}", "jp=[0, 0, 0, 0]"]
    code, out, _ = run("call", NAMESPACE, "inverse_kinematics", *where)
    assert (code, yaml.safe_load(out)["jp"]) == (0, [0.1, 0.0, 0.0, 0.0])
    tilted = ["0.1", "0", "0", "0.7071", "0", "0", "0.7071"]
    code, out, _ = run("call", NAMESPACE, "inverse_kinematics", *tilted)
    assert (code, yaml.safe_load(out)["result"]) == (1, False)
    assert yaml.safe_load(run("call", NAMESPACE, "crtk_version")[1])["success"] is True
    for arguments, message in (
        (["inverse_kinematics", "cp.position.x=high"], "cp.position.x: 'high' is no double"),
        (["forward_kinematics", "joints=[1]"], "joints: there is no such field"),
        (["crtk_version", "3"], "takes no bare numbers"),
    ):
        code, _, err = run("call", NAMESPACE, *arguments)
        assert code == 2
        assert message in err


def test_a_frame_is_named_as_on_its_topic(far: Far) -> None:
    far.arm.enable()
    pose = far.arm.measured_cp()
    # A refused move to where the tool is already may count as reached.
    elsewhere = Pose(pose.position + 0.01, pose.orientation, "world")
    with pytest.raises(CommandRefused, match=f"Give it in '{pose.frame_id}'"):
        far.arm.move_cp(elsewhere).wait(LONG)


def test_a_namespace_may_end_with_a_slash_and_a_wrong_one_is_named_as_it_was_given(
    far: Far, run_far: Run
) -> None:
    assert run_far("hold", f"{NAMESPACE}/", *FOUND)[0] == 0
    code, _, err = run_far("hold", "/client commands")
    assert code == 2
    assert "error: '/client commands' is not a namespace" in err
    assert "Try: /client_commands" in err


def test_yaml_is_written_in_the_characters_of_the_text() -> None:
    assert as_yaml({"message": "0 N·m"}) == "{message: 0 N·m}\n"


def test_nobody_there_says_who_is(far: Far, run_far: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    with Node("who_knows") as mine:
        topic = f"{NAMESPACE}/operating_state"
        eventually(lambda: mine.node.count_publishers(topic), "it knows who is there")
        monkeypatch.setattr(client, "connect", partial(client.connect, node=mine.node))
        code, out, err = run_far("enable", "/nobody", "--timeout", "0.5")
    assert (code, out) == (1, "")
    assert f"CRTK devices are at: {NAMESPACE}" in err
    assert far.engine.status.state is OperatingState.DISABLED
