"""Universal Robots' own RTDE client library and its examples, unmodified, against the simulator.

Its code is not part of this project. `UR_RTDE_PYTHON_CLIENT` names a checkout of
RTDE_Python_Client_Library: the folder with `rtde` and `examples`. Everything runs in processes of
its own, as users run it.
"""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import PrimaryClient
from rigs.waiting import eventually

FOLDER = Path(os.environ.get("UR_RTDE_PYTHON_CLIENT", ""))
EXAMPLES = FOLDER / "examples"
pytestmark = pytest.mark.skipif(
    Path() == FOLDER, reason="UR_RTDE_PYTHON_CLIENT does not name the sources of UR's RTDE client"
)

TIMEOUT = 50.0
CONTROLLERS = pytest.mark.parametrize(
    ("model", "version"), [("ur5e", "5.12.4"), ("ur5", "3.15.8"), ("ur10e", "10.11")]
)

# The control loop has "localhost" in its text.
AT_HOST = """
import runpy, socket, sys

host, script = sys.argv[1:]

class Redirected(socket.socket):
    def connect(self, address):
        assert address[0] == "localhost"
        super().connect((host, address[1]))

socket.socket = Redirected
runpy.run_path(script, run_name="__main__")
"""

# What rtde_control_loop.urp does, as URScript; its moves have 0.08 m/s.
CONTROL_LOOP = """
def rtde_control_loop():
  $ 2 "setp≔p[0,0,0,0,0,0]"
  global setp = p[0, 0, 0, 0, 0, 0]
  rtde_set_watchdog("input_int_register_0", 1, "PAUSE")
  write_output_integer_register(0, 1)
  $ 16 "Thread_1"
  thread Thread_1():
    while (True):
      global tmp = p[0, 0, 0, 0, 0, 0]
      tmp[0] = read_input_float_register(0)
      tmp[1] = read_input_float_register(1)
      tmp[2] = read_input_float_register(2)
      tmp[3] = read_input_float_register(3)
      tmp[4] = read_input_float_register(4)
      tmp[5] = read_input_float_register(5)
      global setp = tmp
      sync()
    end
  end
  threadId_Thread_1 = run Thread_1()
  while (True):
    $ 6 "If read_input_integer_register(0)≟1 and setp≠p[0, 0, 0, 0, 0, 0]"
    if (read_input_integer_register(0) == 1 and setp != p[0, 0, 0, 0, 0, 0]):
      movel(setp, a=1.2, v=0.8)
      textmsg("reached ", get_target_tcp_pose())
      write_output_integer_register(0, 0)
      while (read_input_integer_register(0) == 1):
        sync()
      end
      write_output_integer_register(0, 1)
    end
    sync()
  end
end
"""

SESSION = """
import json, logging, struct, sys
import rtde.rtde as rtde

told = []

class Collector(logging.Handler):
    def emit(self, record):
        told.append(record.getMessage())

logging.getLogger("rtde").addHandler(Collector())
logging.getLogger("rtde").setLevel(logging.INFO)

def refused(call, text):
    try:
        call()
    except ValueError as error:
        assert text in str(error), error
    else:
        raise AssertionError(f"not refused: {text}")

first, second = rtde.RTDE(sys.argv[1]), rtde.RTDE(sys.argv[1])
first.connect()
second.connect()
assert first.get_controller_version() == tuple(map(int, sys.argv[2].split("."))) + (0,)

assert not first.send_start(), "no outputs chosen"
refused(lambda: first.send_output_setup(["timestamp", "nonsense"]), "NOT_FOUND")
assert first.send_output_setup(["timestamp"], ["UINT32"]) is False
assert "Data type inconsistency" in told[-1]
inputs = ["input_int_register_0", "input_double_register_0"]
refused(lambda: first.send_input_setup([*inputs, "nonsense"]), "NOT_FOUND")
setpoint = first.send_input_setup(inputs, ["INT32", "DOUBLE"])
refused(lambda: second.send_input_setup(inputs[:1]), "already in use")
other = second.send_input_setup(["input_double_register_1"], ["DOUBLE"])
assert (setpoint.recipe_id, other.recipe_id) == (1, 1), "numbers of its own for each client"
assert first.send_pause(), "before the start"

outputs = ["timestamp", *inputs, "actual_q", "joint_mode"]
types = ["DOUBLE", "INT32", "DOUBLE", "VECTOR6D", "VECTOR6INT32"]
assert first.send_output_setup(outputs, types, 25)
assert first.send_start()
setpoint.input_int_register_0, setpoint.input_double_register_0 = 5, 1.5
assert first.send(setpoint)
while (state := first.receive()).input_int_register_0 != 5:
    pass
assert state.input_double_register_0 == 1.5 and state.joint_mode == [253] * 6
binary = first.receive(True)
assert len(binary) == 8 + 4 + 8 + 48 + 24
assert struct.unpack_from(">d", binary)[0] > state.timestamp
start = first.receive().timestamp
while (buffered := first.receive_buffered()) is None:
    pass
assert abs(buffered.timestamp - start - 0.04) < 1e-6, "every package, at the rate asked for"

assert first.send_message(b"hello", b"test")
first._RTDE__sendall(rtde.Command.RTDE_DATA_PACKAGE, b"\\x09\\x00")
while "fits no recipe" not in told[-1]:
    first.receive()

assert first.send_pause()
assert not first.has_data()
assert first.send_output_setup(["robot_mode"], ["INT32"])
assert first.send_start()
assert first.receive().robot_mode == 7
print("running", flush=True)

sys.stdin.readline()
while first.receive() is not None:
    pass
assert told[-1].startswith("no data received")
print("silence", flush=True)

sys.stdin.readline()
try:
    while True:
        first.receive()
except rtde.RTDEException as error:
    assert "received 0 bytes" in str(error)
assert not first.is_connected() and second.is_connected()
print("closed", flush=True)
"""


@pytest.fixture(scope="module")
def unpacking() -> None:
    """The library's sources of early 2026 (commit dd3bd91) unpack INT32 and UINT32 as lists.

    With these its own control loop waits for ever, on a robot too.
    """
    check = "from rtde import serialize; assert serialize.unpack_field([1], 0, 'INT32') == 1"
    if subprocess.run([sys.executable, "-c", check], cwd=FOLDER, capture_output=True).returncode:
        pytest.skip("these sources unpack INT32 as lists")


@contextmanager
def started(
    *arguments: str, folder: Path | None = None, expected: int = 0
) -> Iterator[subprocess.Popen[str]]:
    """A Python process with the library in its path, which must end as expected."""
    process = subprocess.Popen(
        [sys.executable, "-u", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(FOLDER)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        yield process
        _, told = process.communicate(timeout=TIMEOUT)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == expected, told


def said(process: subprocess.Popen[str]) -> str:
    """The next line that a process prints; fails with what it printed as it died."""
    assert process.stdout is not None
    assert process.stderr is not None
    line = process.stdout.readline()
    assert line, process.stderr.read()
    return line.strip()


def recorded(output: Path) -> tuple[list[str], list[float]]:
    """Names of the columns, and the stamps, of what record.py wrote."""
    with output.open(newline="") as file:
        header, *rows = csv.reader(file, delimiter=" ")
    assert {len(row) for row in rows} == {len(header)}
    return header, [float(row[0]) for row in rows]


@CONTROLLERS
@pytest.mark.parametrize("frequency", [125, 500])
@pytest.mark.parametrize("options", [[], ["--buffered"]], ids=["latest", "buffered"])
def test_record(
    tmp_path: Path, model: str, version: str, frequency: int, options: list[str]
) -> None:
    output = tmp_path / "data.csv"
    arguments = ["--frequency", str(frequency), "--samples", "100", "--output", str(output)]
    with (
        SIM.spawn(model=model, version=version) as sim,
        started("record.py", "--host", sim.host, *arguments, *options, folder=EXAMPLES),
    ):
        pass
    header, stamps = recorded(output)
    assert len(header) == 118
    assert len(stamps) >= 99
    period = 0.002 if frequency == 500 and version[0] != "3" else 0.008
    steps = [(after - before) / period for before, after in pairwise(stamps)]
    assert steps == pytest.approx([round(step) for step in steps], abs=1e-3)
    assert min(steps) > 0.9
    if options:
        assert max(steps) < 1.1, "buffered: nothing is left out"


def test_record_until_the_controller_is_gone(tmp_path: Path) -> None:
    output = tmp_path / "data.csv"
    with SIM.spawn() as sim:
        arguments = ["--host", sim.host, "--output", str(output)]
        with started("record.py", *arguments, folder=EXAMPLES) as record:
            assert record.stdout is not None
            told = ""
            while "samples." not in told:
                told += record.stdout.read(1)
            sim.stop()
    _, stamps = recorded(output)
    assert len(stamps) >= 124  # it counts from 1


@CONTROLLERS
@pytest.mark.usefixtures("unpacking")
def test_control_loop(model: str, version: str) -> None:
    """It never ends by itself; a lost connection ends it with an exception."""
    with (
        SIM.spawn(model=model, version=version) as sim,
        started(
            *("-c", AT_HOST, sim.host, "example_control_loop.py"), folder=EXAMPLES, expected=1
        ) as loop,
        PrimaryClient(sim.host, timeout=TIMEOUT) as primary,
    ):
        eventually(lambda: sim.control.status()["input_packages"] > 0, timeout=TIMEOUT)
        primary.send(CONTROL_LOOP.encode())
        sent, confirmed = [], []
        for _ in range(5):
            kind, _, values = said(loop).partition(" = ")
            assert kind == "New pose"
            sent.append(json.loads(values))
            kind, _, values = said(loop).partition(" = ")
            assert kind == "Move to confirmed pose"
            confirmed.append(json.loads(values))
        assert sent == [sent[0], sent[1], sent[0], sent[1], sent[0]]
        reached = [primary.message(0, TIMEOUT).decode() for _ in range(5)]
        assert sim.control.status()["runtime_state"] == "PLAYING"
        sim.control.inject("disconnect", port="rtde")
    poses = [json.loads(text.removeprefix("reached p")) for text in reached]
    for pose in poses:
        assert any(pose == pytest.approx(goal, abs=1e-4) for goal in sent[:2])
    assert any(a != pytest.approx(b, abs=1e-3) for a, b in pairwise(poses))
    assert any(a != pytest.approx(b, abs=1e-3) for a, b in pairwise(confirmed))


@CONTROLLERS
@pytest.mark.usefixtures("unpacking")
def test_the_library(model: str, version: str) -> None:
    full = ".".join([*version.split("."), "0"][:3])
    with (
        SIM.spawn(model=model, version=version) as sim,
        started("-c", SESSION, sim.host, full) as client,
    ):
        assert client.stdin is not None
        assert said(client) == "running"
        sim.control.inject("silence", port="rtde")
        client.stdin.write("\n")
        client.stdin.flush()
        assert said(client) == "silence"
        sim.control.clear("silence")
        sim.control.inject("disconnect", port="rtde")
        client.stdin.write("\n")
        client.stdin.flush()
        assert said(client) == "closed"


@pytest.mark.skipif(
    not (EXAMPLES / "example_read_properties.py").exists(), reason="releases of 2026 have it"
)
@pytest.mark.parametrize(
    ("version", "expected", "text"),
    [
        ("5.26.3", 0, "software_version=5.26.3.0\ncontrol_box type=5 subtype=2\n"),
        ("10.15", 0, "software_version=10.15.0.0\ncontrol_box type=5 subtype=2\n"),
        ("5.12.4", 1, "RTDE properties not supported"),
    ],
)
def test_properties(version: str, expected: int, text: str) -> None:
    with (
        SIM.spawn(version=version) as sim,
        started(
            *("example_read_properties.py", "--host", sim.host), folder=EXAMPLES, expected=expected
        ) as example,
    ):
        assert example.stdout is not None
        assert text in example.stdout.read()
