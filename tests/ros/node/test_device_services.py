"""A device's own services and inputs on ROS, and its notes in the diagnostics."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from types import MappingProxyType
from typing import Any

import pytest
from crtk_msgs.msg import StringStamped
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from std_msgs.msg import Bool, Empty, Float64, Float64MultiArray
from std_srvs.srv import Trigger

from crtk_drivers.commands import Payload
from crtk_drivers.device import Answer, Input, Note, Reading, Service, Severity
from crtk_drivers.engine import Engine
from crtk_drivers.errors import CommandRefused, Reason
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.ros import qos
from crtk_drivers.ros.names import STOPS_NODE_NAME
from crtk_drivers.ros.policy import interfaces
from crtk_drivers.samples import Flag, Number, Numbers, Text, Value, Wrench
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
from rigs.loopback_node import Rig, rig_of
from rigs.waiting import LONG, eventually


class Scale(LoopbackDevice):
    """A gantry that can be tared."""

    bias: Wrench | None = None
    told: Mapping[str, Value | None] = MappingProxyType({})
    taring = threading.Event()
    go = threading.Event()
    sweeps = 0

    @property
    def services(self) -> Mapping[str, Service]:
        return {
            "tare": Service("make the present load zero", self._tare),
            "sweep": Service("move from end to end", self._sweep, moves=True),
            "halt": Service("a stop of its own", self._halt, stops=True),
        }

    @property
    def inputs(self) -> Mapping[str, Input]:
        return {
            "set_bias": Input("what counts as zero", Payload.WRENCH, self._set_bias),
            "label": Input(
                "what it is called", Payload.TEXT, lambda text: self._tell("name", text)
            ),
            "points": Input(
                "of its scale", Payload.NUMBERS, lambda given: self._tell("row", given)
            ),
        }

    @property
    def readings(self) -> Mapping[str, Reading]:
        kinds = {
            "door": Payload.FLAG,
            "load": Payload.NUMBER,
            "row": Payload.NUMBERS,
            "name": Payload.TEXT,
            "guard": Payload.FLAG,
        }
        return {
            name: Reading(f"its {name}", kind, partial(self._told, name))
            for name, kind in kinds.items()
        }

    def _told(self, name: str) -> Value | None:
        return self.told.get(name)

    def _tell(self, name: str, value: Value) -> None:
        self.told = {**self.told, name: value}

    @property
    def notes(self) -> tuple[Note, ...]:
        return (Note(Severity.ERROR, "overload", "saturated on Fz"),)

    def _tare(self) -> Answer:
        self.taring.set()
        while not self.go.is_set():
            yield
        return "tared"

    def _sweep(self) -> Answer:
        self.sweeps += 1
        yield
        return "swept"

    def _halt(self) -> Answer:
        yield
        return "halted"

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
    assert caller.wait_for_service(LONG)
    answered = threading.Event()
    future = caller.call_async(Trigger.Request())
    future.add_done_callback(lambda _: answered.set())
    assert device.taring.wait(LONG)
    client.reach("enable", "ENABLED")
    client.send("hold", Empty())
    client.reach("disable", "DISABLED")
    assert not answered.is_set()
    device.go.set()
    assert answered.wait(LONG)
    assert (future.result().success, future.result().message) == (True, "tared")


def test_one_that_is_a_stop_waits_for_no_other(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    device.taring.clear()
    device.go.clear()
    answered = {"tare": threading.Event(), "halt": threading.Event()}
    callers = {
        name: client.node.create_client(Trigger, f"{client.namespace}/{name}") for name in answered
    }
    futures = {}
    for name, caller in callers.items():
        assert caller.wait_for_service(LONG)
        futures[name] = caller.call_async(Trigger.Request())
        futures[name].add_done_callback(lambda _, ended=answered[name]: ended.set())
        assert device.taring.wait(LONG)
    for ended in answered.values():
        assert ended.wait(LONG)
    device.go.set()
    assert (futures["halt"].result().success, futures["halt"].result().message) == (True, "halted")
    assert "by halt" in futures["tare"].result().message
    (own, *_) = interfaces(device, client.namespace)
    assert f"{client.namespace}/{STOPS_NODE_NAME}" in own.nodes


@pytest.mark.parametrize("stop", ["hold", "pause", "disable", "halt"])
def test_one_that_moves_from_before_a_stop_is_refused(rig: Rig, stop: str) -> None:
    client, device, engine = rig.client, device_of(rig), rig.session.engine
    client.reach("enable", "ENABLED")
    device.taring.clear()
    device.go.clear()
    callers = [
        client.node.create_client(Trigger, f"{client.namespace}/{name}")
        for name in ("tare", "sweep", "halt")
    ]
    assert all(caller.wait_for_service(LONG) for caller in callers)
    before = device.sweeps
    tared = callers[0].call_async(Trigger.Request())
    assert device.taring.wait(LONG)
    swept = callers[1].call_async(Trigger.Request())  # behind the one that takes its time
    with heard(engine, "hold") as held:
        if stop == "hold":
            client.send("hold", Empty())
            assert held.wait(LONG)
        elif stop == "halt":
            halted = callers[2].call_async(Trigger.Request())
            eventually(halted.done, "halted")
        else:
            client.reach(stop, {"pause": "PAUSED", "disable": "DISABLED"}[stop])
    device.go.set()
    eventually(lambda: tared.done() and swept.done(), "both are answered")
    assert device.sweeps == before, "it moved"
    assert not swept.result().success
    assert "came before it was carried out" in swept.result().message
    assert engine.health().refusals["sweep: too_old"]
    assert client.trigger("sweep").success
    client.reach("disable", "DISABLED")


@contextmanager
def heard(engine: Engine, name: str) -> Iterator[threading.Event]:
    """Give what is set once the engine is told to carry out a command."""
    event = threading.Event()
    before = engine.hearers
    engine.hearers = (*before, lambda told, *_: told == name and event.set())
    try:
        yield event
    finally:
        engine.hearers = before


def test_an_input_is_a_topic(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    sender = client.node.create_publisher(WrenchStamped, f"{client.namespace}/set_bias", 10)
    message = WrenchStamped()
    message.wrench.force.x = 101.0
    since = client["refusals"].mark()

    def is_refused() -> bool:
        sender.publish(message)
        return any("set_bias" in m.data for m in client["refusals"].messages[since:])

    eventually(is_refused, "it is refused")
    told = json.loads(client["refusals"].wait(lambda m: "set_bias" in m.data, since).data)
    assert told["reason"] == "out_of_range"
    assert device.bias is None
    message.wrench.force.x = 7.0
    sender.publish(message)
    bias = eventually(lambda: device.bias, "it is taken")
    assert bias.force[0] == 7.0


def test_readings_are_latched_topics_that_tell_each_change_once(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    topics = {"door": Bool, "load": Float64, "row": Float64MultiArray, "name": StringStamped}
    heard: dict[str, list[Any]] = {name: [] for name in topics}
    for name, kind in topics.items():
        client.node.create_subscription(
            kind, f"{client.namespace}/state/{name}", heard[name].append, qos.LATCHED
        )
    device.told = {"door": Flag(True), "load": Number(2.5), "row": Numbers((1.0, 2.0))}
    eventually(lambda: all(heard[name] for name in device.told), "the readings")
    assert heard["door"][0].data is True
    assert heard["load"][0].data == 2.5
    assert list(heard["row"][0].data) == [1.0, 2.0]
    device.told = {**device.told, "door": Flag(False), "name": Text("front")}
    eventually(lambda: len(heard["door"]) > 1 and heard["name"], "the changes")
    assert heard["door"][1].data is False
    assert heard["name"][0].string == "front"
    device.told = {"door": None}
    inbox = client["operating_state"]
    inbox.wait(since=inbox.mark())
    assert [len(heard[name]) for name in topics] == [2, 1, 1, 1]


def test_a_reading_of_a_wrong_class_is_said_once_without_a_traceback(
    rig: Rig, caplog: pytest.LogCaptureFixture
) -> None:
    client, device = rig.client, device_of(rig)
    heard: list[Bool] = []
    client.node.create_subscription(
        Bool, f"{client.namespace}/state/door", heard.append, qos.LATCHED
    )
    device.told = {"guard": True, "door": Flag(True)}  # type: ignore[dict-item]
    eventually(lambda: heard and heard[-1].data, "the reading beside it")
    device.told = {"guard": False, "door": Flag(False)}  # type: ignore[dict-item]
    eventually(lambda: not heard[-1].data, "the next one")
    device.told = {}
    said = [record for record in caplog.records if "guard" in record.getMessage()]
    assert [record.getMessage() for record in said] == [
        f"{rig.session.engine.where}: reading 'guard': returned bool, "
        "must return Flag (crtk_drivers.samples)"
    ]
    assert said[0].exc_info is None


def test_texts_and_numbers_are_inputs(rig: Rig) -> None:
    client, device = rig.client, device_of(rig)
    messages = {"label": StringStamped(string="left"), "points": Float64MultiArray(data=[1.0, 0.5])}
    senders = {
        name: client.node.create_publisher(type(message), f"{client.namespace}/{name}", 10)
        for name, message in messages.items()
    }

    def arrived() -> bool:
        for name, sender in senders.items():
            sender.publish(messages[name])
        return device.told.get("name") is not None and device.told.get("row") is not None

    device.told = {}
    eventually(arrived, "both")
    assert device.told == {"name": Text("left"), "row": Numbers((1.0, 0.5))}


def test_they_are_in_the_manifest_and_notes_in_the_diagnostics(rig: Rig) -> None:
    content = json.loads(rig.client["crtk_driver/crtk_capabilities"].wait().data)
    assert content["services"]["tare"] == {
        "name": "/test_ros_services/tare",
        "type": "std_srvs/srv/Trigger",
        "summary": "make the present load zero",
    }
    assert content["inputs"]["set_bias"]["type"] == "geometry_msgs/msg/WrenchStamped"
    assert content["readings"]["door"] == {
        "name": "/test_ros_services/state/door",
        "type": "std_msgs/msg/Bool",
        "summary": "its door",
    }

    def worst(message: object) -> bool:
        return any(
            s.level == DiagnosticStatus.ERROR and s.message == "saturated on Fz"
            for s in message.status  # type: ignore[attr-defined]
        )

    rig.client["/diagnostics"].wait(worst)
