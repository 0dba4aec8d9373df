"""Whatever arrives on a port: the simulator survives, and its other clients notice nothing."""

from __future__ import annotations

import contextlib
import json
import random
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.controller import Controller
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.ports.dashboard import COMMANDS, DashboardSession, Robot
from crtk_sim_backends.ur.ports.interpreter_port import InterpreterSession
from crtk_sim_backends.ur.ports.robot_api import (
    BASE,
    PROGRAM_ACTIONS,
    QUESTIONS,
    ROBOT_ACTIONS,
    RobotApiSession,
)
from crtk_sim_backends.ur.ports.rtde import InputClaims, RtdeError, RtdeSession, Trace
from crtk_sim_backends.ur.ports.script_port import ScriptSession
from crtk_sim_backends.ur.signals.variables import INPUTS, OUTPUTS
from rigs.examples import examples
from rigs.ur_clients import DashboardClient, InterpreterClient, RtdeClient, TcpClient
from rigs.ur_fuzz_corpus import CORPUS, DASHBOARD, INTERPRETER, ROBOT_API, RTDE, SCRIPT, rtde
from rigs.waiting import eventually

VERSION = (5, 12, 4, 0)
SEARCH = settings(
    max_examples=examples(60),
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.fixture(scope="module")
def controller():
    return Controller(MODELS["ur5e"], VERSION)


@pytest.fixture(scope="module")
def polyscope_x():
    with SIM.spawn(version="10.14", robot_api=True, robot_api_port=0) as running:
        yield running


INTERPRETED = """def p():
  a = 1
  def g(x):
    return x
  end
  while True:
    interpreter_mode(clearQueueOnEnter=False)
  end
end
"""


def in_pieces(data: bytes, seed: int) -> list[bytes]:
    cuts = sorted(random.Random(seed).choices(range(len(data) + 1), k=3))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@pytest.mark.parametrize("port", sorted(CORPUS))
def test_the_corpus_harms_neither_the_simulator_nor_other_clients(sim, port):
    with RtdeClient(sim.host) as bystander, DashboardClient(sim.host) as dashboard:
        bystander.setup_outputs("timestamp", 50.0)
        bystander.start()
        before = bystander.data()[0]
        for seed, data in enumerate(CORPUS[port].values()):
            with TcpClient(sim.host, port) as client, contextlib.suppress(ConnectionError):
                for piece in in_pieces(data, seed):
                    client.send(piece)
        eventually(lambda: sim.control.status()["connections"][port][1:] == [], timeout=20)
        assert bystander.wait_for(lambda values: values[0] > before + 0.1, 20)
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
        status = sim.control.status()
        assert status["statistics"]["defects"] == 0
        assert sim.running


def test_the_corpus_harms_no_simulator_whose_program_is_in_interpreter_mode(sim):
    with RtdeClient(sim.host) as bystander, TcpClient(sim.host, "primary") as script:
        bystander.setup_outputs("timestamp", 50.0)
        bystander.start()
        before = bystander.data()[0]
        for seed, data in enumerate(INTERPRETER.values()):
            script.send(INTERPRETED.encode())
            eventually(lambda: sim.control.status()["runtime_state"] == "PLAYING", timeout=20)
            with TcpClient(sim.host, "interpreter") as client, contextlib.suppress(ConnectionError):
                for piece in in_pieces(data, seed):
                    client.send(piece)
            with InterpreterClient(sim.host, 20) as client:
                eventually(
                    lambda ask=client.ask: ask("stateunexecuted").startswith("state: 0"), timeout=20
                )
            script.send(b"stop program\n")
            eventually(lambda: sim.control.status()["runtime_state"] == "STOPPED", timeout=20)
        assert bystander.wait_for(lambda values: values[0] > before + 0.1, 20)
        assert sim.control.status()["statistics"]["defects"] == 0
        assert sim.running


def test_the_corpus_of_the_robot_api_harms_nobody(polyscope_x):
    sim = polyscope_x
    with RtdeClient(sim.host) as bystander:
        bystander.setup_outputs("timestamp", 50.0)
        bystander.start()
        before = bystander.data()[0]
        for seed, data in enumerate(ROBOT_API.values()):
            client = TcpClient(sim.host, sim.ports["robot_api"])
            with client, contextlib.suppress(ConnectionError):
                for piece in in_pieces(data, seed):
                    client.send(piece)
        eventually(lambda: sim.control.status()["connections"]["robot_api"] == [], timeout=20)
        assert bystander.wait_for(lambda values: values[0] > before + 0.1, 20)
        assert sim.control.status()["statistics"]["defects"] == 0


requests = st.builds(
    lambda method, path, body, extra: (
        f"{method} {BASE}{path} HTTP/1.1\r\nContent-Length: {len(body) + extra}\r\n\r\n".encode()
        + body
    ),
    st.sampled_from(["GET", "PUT", "POST", "DELETE", "get", ""]),
    st.sampled_from(["", *QUESTIONS, "/popup/v1", "/system/v1/log"]),
    st.binary(max_size=20)
    | st.dictionaries(
        st.sampled_from(["action", "name", "message"]),
        st.sampled_from([*ROBOT_ACTIONS, *PROGRAM_ACTIONS, 1, None]) | st.text(max_size=8),
    ).map(lambda content: json.dumps(content).encode()),
    st.integers(-2, 2),
)


@SEARCH
@given(
    st.lists(requests | st.sampled_from(list(ROBOT_API.values())), max_size=8).map(b"".join)
    | st.binary(max_size=200),
    st.integers(),
)
def test_the_robot_api_takes_any_bytes(controller, data, seed):
    robot = Robot(controller, MODELS["ur5e"], (10, 14, 0, 0), "20230000000", lambda: None)
    session = RobotApiSession(robot)
    for piece in in_pieces(data, seed):
        answer = session.receive(piece)
        assert not answer or answer.startswith(b"HTTP/1.1 ")
        controller.tick()
    session.close()


names = st.lists(st.sampled_from([*OUTPUTS, *INPUTS]) | st.text(max_size=8), max_size=6).map(
    lambda chosen: ",".join(chosen).encode()
)
packages = st.one_of(
    st.builds(rtde, st.characters(max_codepoint=255), st.binary(max_size=40)),
    st.builds(lambda rate, text: rtde("O", rate + text), st.binary(min_size=8, max_size=8), names),
    st.builds(lambda text: rtde("I", text), names),
    st.builds(
        lambda number, data: rtde("U", bytes([number]) + data), st.integers(0, 9), st.binary()
    ),
    st.sampled_from([rtde("S"), rtde("P"), rtde("V", b"\0\2"), *RTDE.values()]),
)


@SEARCH
@given(st.lists(packages, max_size=12).map(b"".join) | st.binary(max_size=200), st.integers())
def test_rtde_takes_any_bytes(controller, data, seed):
    session = RtdeSession(controller, VERSION, InputClaims(), Trace(10))
    with contextlib.suppress(RtdeError):
        for piece in in_pieces(data, seed):
            session.receive(piece)
            controller.tick()
            session.package(0)
    session.close()


lines = st.one_of(
    st.text(max_size=30).map(lambda text: text.encode("utf-8", "surrogatepass") + b"\n"),
    st.binary(max_size=30),
    st.builds(
        lambda command, text: (
            f"{command.pattern.pattern.split('(')[0].strip(' ?')} {text}\n".encode(
                "utf-8", "surrogatepass"
            )
        ),
        st.sampled_from(COMMANDS),
        st.text(max_size=10),
    ),
    st.sampled_from(list(DASHBOARD.values())),
)


@SEARCH
@given(st.lists(lines, max_size=12).map(b"".join), st.integers())
def test_the_dashboard_takes_any_bytes(controller, data, seed):
    robot = Robot(controller, MODELS["ur5e"], VERSION, "20230000000", lambda: None)
    session = DashboardSession(robot, SimpleNamespace(append=str).append)
    for piece in in_pieces(data, seed):
        answer = session.receive(piece)
        assert not answer or answer.endswith(b"\n")
        controller.tick()


words = st.sampled_from(
    b'def sec end if while else: thread p() ( ) [ ] = , + - 1 0x " # \n \n True movej sync() x'.split(
        b" "
    )
)
texts = st.one_of(
    st.lists(words, max_size=40).map(b" ".join),
    st.binary(max_size=80),
    st.sampled_from(list(SCRIPT.values())),
)


@SEARCH
@given(texts, st.integers())
def test_script_ports_take_any_bytes(controller, data, seed):
    session = ScriptSession(controller.run_script)
    for piece in in_pieces(data + b"\n", seed):
        session.receive(piece)
        controller.tick()
    session.close()
    controller.player.end_all()
    controller.take_messages()


interpreted_lines = st.one_of(
    st.lists(
        st.sampled_from(
            b"def end if while else: thread f() a = 1 ( ) [ ] , 1 + run t() \n \n \n True sync() g(a) "
            b"return abort skipbuffer stateunexecuted clear_interpreter() end_interpreter() "
            b"global local sleep(0.01) movej([0,-1,1,0,0,0],r=0.1) x".split(b" ")
        ),
        max_size=40,
    ).map(b" ".join),
    st.binary(max_size=80),
    st.sampled_from(list(INTERPRETER.values())),
)


@SEARCH
@given(interpreted_lines, st.integers())
def test_the_interpreter_takes_any_bytes(controller, data, seed):
    controller.run_script(INTERPRETED)
    session = InterpreterSession(controller.interpreter)
    for piece in in_pieces(data + b"\n", seed):
        answer = session.receive(piece)
        assert not answer or answer.endswith(b"\n")
        for _ in range(5):
            controller.tick()
            session.receive(b"")
    session.close()
    controller.player.end_all()
    controller.tick()
    assert not any("Internal error" in str(message) for message in controller.take_messages())
