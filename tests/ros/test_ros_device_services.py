"""A device's own services and inputs on ROS, and its notes in the diagnostics."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from ros_client import TIMEOUT
from ros_rig import Rig, rig_of
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer, Input, Note, Service, Severity
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import Wrench
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice


class Scale(LoopbackDevice):
    """A gantry that can be tared."""

    bias: Wrench | None = None
    taring = threading.Event()
    go = threading.Event()

    @property
    def services(self) -> Mapping[str, Service]:
        return {"tare": Service("make the present load zero", self._tare)}

    @property
    def inputs(self) -> Mapping[str, Input]:
        return {"set_bias": Input("what counts as zero", Payload.WRENCH, self._set_bias)}

    @property
    def notes(self) -> tuple[Note, ...]:
        return (Note(Severity.ERROR, "overload", "saturated on Fz"),)

    def _tare(self) -> Answer:
        self.taring.set()
        while not self.go.is_set():
            yield
        return "tared"

    def _set_bias(self, value: Wrench) -> None:
        if value.force[0] > 100.0:
            raise CommandRefused("set_bias", Reason.OUT_OF_RANGE, "more than it can carry")
        self.bias = value


PLUGIN = DevicePlugin("scale", "a gantry that can be tared", LoopbackConfig, Scale)


@pytest.fixture(scope="module")
def rig() -> Iterator[Rig]:
    with rig_of("/test_ros_services", plugin=PLUGIN) as rig:
        yield rig


def device_of(rig: Rig) -> Scale:
    assert isinstance(rig.device, Scale)
    return rig.device


def test_a_service_that_takes_its_time_keeps_no_command_waiting(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    caller = client.node.create_client(Trigger, f"{client.namespace}/tare")
    assert caller.wait_for_service(TIMEOUT)
    answered = threading.Event()
    future = caller.call_async(Trigger.Request())
    future.add_done_callback(lambda _: answered.set())
    assert device.taring.wait(TIMEOUT)
    client.reach("enable", "ENABLED")
    client.send("hold", Empty())
    client.reach("disable", "DISABLED")
    assert not answered.is_set()
    device.go.set()
    assert answered.wait(TIMEOUT)
    assert (future.result().success, future.result().message) == (True, "tared")


def test_an_input_is_a_topic(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    sender = client.node.create_publisher(WrenchStamped, f"{client.namespace}/set_bias", 10)
    message = WrenchStamped()
    message.wrench.force.x = 101.0
    since = client["refusals"].mark()
    end = threading.Event()
    for _ in range(200):
        sender.publish(message)
        if any("set_bias" in m.data for m in client["refusals"].messages[since:]):
            break
        end.wait(0.05)
    told = json.loads(client["refusals"].wait(lambda m: "set_bias" in m.data, since).data)
    assert told["reason"] == "out_of_range"
    assert device.bias is None
    message.wrench.force.x = 7.0
    sender.publish(message)
    for _ in range(200):
        if device.bias is not None:
            break
        end.wait(0.05)
    assert device.bias is not None
    assert device.bias.force[0] == 7.0


def test_they_are_in_the_manifest_and_notes_in_the_diagnostics(rig: Rig) -> None:
    content = json.loads(rig.client["crtk_driver/crtk_capabilities"].wait().data)
    assert content["services"]["tare"] == {
        "name": "/test_ros_services/tare",
        "type": "std_srvs/srv/Trigger",
        "summary": "make the present load zero",
    }
    assert content["inputs"]["set_bias"]["type"] == "geometry_msgs/msg/WrenchStamped"

    def worst(message: object) -> bool:
        return any(
            s.level == DiagnosticStatus.ERROR and s.message == "saturated on Fz"
            for s in message.status  # type: ignore[attr-defined]
        )

    rig.client["/diagnostics"].wait(worst)
