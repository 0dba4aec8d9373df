"""The command line in this process: what it prints, and its exit codes."""

import io
import json
import logging
import math
import os
import re
import resource
import signal
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import chain, count, repeat
from pathlib import Path
from typing import Any

import pytest
import typer
from rich.console import Console

import crtk_drivers
from crtk_drivers import plugins
from crtk_drivers.cli import bench_runs, config_reference, device_command, main
from crtk_drivers.cli.app import app, split_arguments
from crtk_drivers.cli.log_setup import LogFormat, set_up_logging
from crtk_drivers.cli.name_lists import short_names
from crtk_drivers.cli.own_commands import OWN_COMMANDS
from crtk_drivers.cli.reaching import is_seen_to_stand
from crtk_drivers.cli.status_line import StatusLine, status_text
from crtk_drivers.cli.terminal import ERR, OUT
from crtk_drivers.config import from_values
from crtk_drivers.config.keys import setting_names
from crtk_drivers.device import Note, Severity
from crtk_drivers.errors import ConfigError, ConnectionFailed, DataTimeout
from crtk_drivers.errors.wording import SCRIPT
from crtk_drivers.labs.verdicts.judging import Verdict
from crtk_drivers.plugins import Description, entries
from crtk_drivers.ros.names import ANOTHER_DRIVER
from crtk_drivers.samples import JointState, vector
from crtk_drivers.state import OperatingState, Status
from crtk_drivers.status.health import Health
from crtk_drivers.status.stop_request import StopRequest, stop_signals

ENTRY_POINTS = """
[crtk_drivers.devices]
loopback = crtk_drivers.testing.loopback:PLUGIN
deaf = deaf_device:PLUGIN
tooled = tooled_device:PLUGIN
simulated = tooled_device:SIMULATED
bad = no_such_module:PLUGIN
[crtk_drivers.sims]
ur = crtk_sim_backends.ur:SIM
[crtk_drivers.pages]
web = crtk_sim_backends.page.device:PAGE
"""

TOOLED = """
from pydantic import Field
from crtk_drivers.config import Settings
from crtk_drivers.errors import ConnectionFailed
from crtk_drivers.plugins import DevicePlugin, Tool
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
class Options(Settings):
    count: int = Field(default=1, ge=1, description="how often")
def info(config, options):
    print(f"{config.address} looked at {options.count} times")
    if options.count == 13:
        raise ConnectionFailed("nobody is there", where=config.address)
    return 3 if options.count == 3 else 0
PLUGIN = DevicePlugin("tooled", "has a tool", LoopbackConfig, LoopbackDevice,
                      tools=(Tool("info", "tells what it is.", info, Options),
                             Tool("again", "the same", info, Options, arguments=("count",))))
SIMULATED = DevicePlugin("simulated", "has a simulator", LoopbackConfig, LoopbackDevice, sim="ur",
                         addresses=("address", "limits.max_step"))
"""

DEAF = """
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
def create(config):
    device = LoopbackDevice(config)
    device.reachable = False
    return device
PLUGIN = DevicePlugin("deaf", "never answers", LoopbackConfig, create)
"""


@pytest.fixture(autouse=True)
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """This distribution as if installed, with two more devices."""
    info = tmp_path / "crtk_drivers-9.8.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: crtk-drivers\nVersion: 9.8\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    (tmp_path / "deaf_device.py").write_text(DEAF)
    (tmp_path / "tooled_device.py").write_text(TOOLED)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv(plugins.ONLY, "")
    monkeypatch.setenv("COLUMNS", "200")
    yield
    sys.modules.pop("deaf_device", None)
    sys.modules.pop("tooled_device", None)


Capture = pytest.CaptureFixture[str]


def refusal(capsys: Capture, *arguments: str) -> str:
    """Run what must be refused as wrong usage and return the message."""
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert "Traceback" not in captured.err
    return captured.err


def test_help_lists_devices_and_tools(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for part in ("loopback", "gantry", "bad", "broken, see crtk-driver list", "schema", "sim"):
        assert part in text


def test_help_shows_one_first_step_a_line(capsys: Capture) -> None:
    assert main(["--help"]) == 0
    _, _, steps = capsys.readouterr().out.partition("First steps:\n")
    assert [len(re.findall(r"crtk-driver ", line)) for line in steps.splitlines() if line] == [
        1,
        1,
        1,
    ]


def test_help_has_each_option_of_the_script(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = Path(__file__).parents[2] / "crtk-driver"
    options = set(re.findall(r"^ +(--[a-z]+)\)", script.read_text(), re.MULTILINE))
    assert {"--extra", "--run"} <= options
    assert main(["--help"]) == 0
    assert "--extra" not in capsys.readouterr().out
    monkeypatch.setenv(SCRIPT, "./crtk-driver")
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert "Options of ./crtk-driver itself" in text
    assert set(re.findall(r"^  (--[a-z]+) ", text, re.MULTILINE)) >= options


def test_what_to_do_next_is_one_command_a_line() -> None:
    hint = device_command.what_next("/arm", ["measured_js", "move_jp"])
    assert hint.splitlines() == [
        "in another terminal:",
        "  crtk-driver state /arm",
        "  crtk-driver enable /arm",
        "  crtk-driver move --help",
    ]


def test_every_scalar_key_of_a_device_is_an_option(capsys: Capture) -> None:
    assert main(["loopback", "--help"]) == 0
    text = capsys.readouterr().out
    for option in ("--rate", "--no-needs-homing", "--open-timeout", "--set", "--ns", "--config"):
        assert option in text
    assert "Longest time to connect, in s. [default: 5]" in text
    assert "hold|pause|fault" in text
    assert "--sim " not in text


@pytest.mark.sweep(2)
@pytest.mark.parametrize("width", [80, 40])
def test_no_name_in_a_help_page_is_cut(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    monkeypatch.setattr(OUT, "_width", width)  # it looked at COLUMNS when it was made
    root = click_app()
    for path, command in pages(root):
        assert main([*path, "--help"]) == 0
        text = capsys.readouterr().out
        assert "…" not in text, path
        names = [name for param in command.params for name in (*param.opts, *param.secondary_opts)]
        for name in names:
            assert re.search(rf"{re.escape(name)}\b", text, re.IGNORECASE), (path, name)
        for line in text.splitlines():
            assert len(line) <= max(width, 70), (path, line)


def click_app() -> Any:
    return typer.main.get_command(app)


def pages(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands with a help page."""
    yield path, command
    context = command.make_context(
        "crtk-driver", [], obj=split_arguments([]), resilient_parsing=True
    )
    for name in command.list_commands(context) if hasattr(command, "list_commands") else ():
        if name not in ("bad", "again"):
            yield from pages(command.get_command(context, name), (*path, name))


def test_settings_stand_under_headings(capsys: Capture) -> None:
    assert main(["tooled", "--help"]) == 0
    text = capsys.readouterr().out
    own, streams = text.index("Settings of tooled:"), text.index("Streams of commands:")
    assert own < text.index("--address") < streams < text.index("--stream-timeout")
    assert main(["sim", "ur", "--help"]) == 0
    text = capsys.readouterr().out
    assert text.index("Safety limits:") < text.index("--tool-force-limit")
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert text.index("Devices:") < text.index("tooled") < text.index("Tools:")


def test_every_key_under_a_heading_exists() -> None:
    for group in (plugins.devices(), plugins.sims()):
        for entry in group.values():
            if entry.error is None:
                model = getattr(entry.plugin, "config", None) or entry.plugin.Config
                for each in model.__mro__:
                    for names in vars(each).get("HEADINGS", {}).values():
                        assert set(names) <= set(setting_names(model)), each


def test_list_is_one_line_a_device(capsys: Capture) -> None:
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert re.search(r"^  loopback +installed +A gantry .*\.$", text, re.MULTILINE)
    assert re.search(r"^  tooled +ok +Has a tool\.$", text, re.MULTILINE), "not described: imported"
    assert re.search(
        r"^  bad +broken +ModuleNotFoundError: No module named 'no_such_module'$",
        text,
        re.MULTILINE,
    )
    devices = text.partition("Devices\n")[2].partition("\n\n")[0]
    assert len(devices.splitlines()) == len(plugins.devices())
    assert re.search(r"Simulators of no device\n  none installed", text)
    assert re.search(r"Pages for the browser\n  web +installed", text)


def test_list_on_a_terminal_cuts_no_trouble(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OUT, "_width", 40)
    monkeypatch.setattr(OUT, "_force_terminal", True)
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    assert "No module named 'no_such_module'" in text
    assert re.search(r"A gantry.*…", text)


def test_list_says_which_extra_is_missing(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(entries, "_not_installed", lambda dist, extra: ["no-such-library"])
    monkeypatch.setattr(entries, "described", lambda plugin: Description("is lame", "walking"))
    assert main(["list"]) == 0
    assert re.search(r"  tooled +needs extra walking +Is lame\.", capsys.readouterr().out)
    monkeypatch.setenv(SCRIPT, "./crtk-driver")
    main(["list", "tooled"])
    assert "Install it with: ./crtk-driver --extra walking --version" in capsys.readouterr().out


def test_list_of_one_shows_commands_or_the_traceback(capsys: Capture) -> None:
    assert main(["list", "loopback"]) == 0
    assert re.search(r"servo_jv +rad/s or m/s +direct real-time", capsys.readouterr().out)
    assert main(["list", "web"]) == 0
    assert re.search(r"web +page +ok .*\s+Shows a device", capsys.readouterr().out)
    assert main(["list", "bad"]) == 1
    assert "Traceback (most recent call last)" in capsys.readouterr().out


def test_short_names_keep_sub_namespaces_apart() -> None:
    commands = plugins.commands_of("loopback")
    names = ("measured_js", "local/measured_cp", "hold", "body/servo_cv", "body/servo_cf")
    chosen = {name: commands[name] for name in names}
    assert short_names(chosen) == "measured_js  hold  local/: measured_cp  body/: servo_cv/cf"


def test_schema_is_json_when_piped(capsys: Capture) -> None:
    assert main(["schema", "loopback"]) == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["properties"]["rate"]["minimum"] == 1.0
    assert main(["schema", "loopback", "--markdown"]) == 0
    assert "| `rate` | number ≥ 1, ≤ 1000 | 100 |" in capsys.readouterr().out


def test_a_schema_names_commands_as_any_machine_has_them(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SCRIPT, "./crtk-driver")
    assert main(["schema", "loopback"]) == 0
    text = capsys.readouterr().out
    assert "`crtk-driver bench`" in text
    assert "./crtk-driver" not in text


def test_the_reference_knows_when_it_is_out_of_date(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(plugins.ONLY, "loopback,ur")
    file = tmp_path / "configuration.md"
    assert config_reference.main(["--check", str(file)]) == 1
    assert "out of date" in capsys.readouterr().err
    assert config_reference.main([str(file)]) == 0
    assert config_reference.main(["--check", str(file)]) == 0
    text = file.read_text(encoding="utf-8")
    for part in ("## Device `loopback`", "## Simulator `ur`", "| `control_port` | integer |"):
        assert part in text
    file.write_text(text + "by hand\n", encoding="utf-8")
    assert config_reference.main(["--check", str(file)]) == 1


def test_unknown_names_bring_a_suggestion(capsys: Capture) -> None:
    assert "Did you mean 'loopback'?" in refusal(capsys, "lopback")
    assert "Did you mean 'loopback'?" in refusal(capsys, "check", "lopback")
    assert "Did you mean 'loopback'?" in refusal(capsys, "schema", "lopback")
    assert "no simulator 'urr'" in refusal(capsys, "sim", "urr")
    text = refusal(capsys, "list", "lopback")
    assert "no device, simulator or page 'lopback'" in text
    assert "Did you mean 'loopback'?" in text


def test_a_misspelt_command_is_no_device(capsys: Capture) -> None:
    text = refusal(capsys, "enabel", "/ur5")
    assert "there is no command or device 'enabel'" in text
    assert "Did you mean 'enable'?" in text


def test_a_broken_plugin_is_refused_when_used(capsys: Capture) -> None:
    assert "ModuleNotFoundError: No module named 'no_such_module'" in refusal(capsys, "bad")


def test_only_the_allowed_plugins(capsys: Capture) -> None:
    assert main(["--only", "loopback", "list"]) == 0
    text = capsys.readouterr().out
    assert "loopback" in text
    assert "bad" not in text
    assert "CRTK_DRIVERS_ONLY allows no others" in refusal(capsys, "--only", "loopback", "deaf")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "limts.max_step=1"], "--set limts.max_step=1: limts: unknown key"),
        (["--rate", "fast"], "--rate: must be a number, not 'fast'"),
        (["--config", "/no/such.yaml"], "/no/such.yaml: cannot be read: No such file"),
        (["--ns", "demo/"], "hint: Try: --ns /demo"),
        (["--ns", "/a b"], "hint: Try: --ns /a_b"),
        (["--log-level", "loud"], "--log-level: 'loud' is not a log level"),
    ],
)
def test_a_run_is_refused_before_anything_starts(
    capsys: Capture, arguments: list[str], message: str
) -> None:
    assert message in refusal(capsys, "loopback", *arguments)


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        (["--address", "there"], "--address: address is where"),
        (["--set", "limits.max_step=1"], "--set limits.max_step=1: limits.max_step is where"),
    ],
)
def test_real_hardware_and_a_simulator_at_once_are_refused(
    capsys: Capture, arguments: list[str], where: str
) -> None:
    assert where in refusal(capsys, "simulated", "--sim", *arguments)
    with pytest.raises(ConfigError, match="a simulator was asked for"):
        crtk_drivers.connect("simulated", sim=True, address="there")


def test_an_empty_address_asks_for_no_hardware() -> None:
    plugins.device("simulated").check_simulated(from_values({"address": "", "limits": {}}))


def test_a_file_of_settings_is_overridden_by_options(tmp_path: Path, capsys: Capture) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("rate: 20\nneeds_homing: yes\nnode:\n  tf_rate: -1\n")
    message = refusal(capsys, "check", "loopback", "-c", str(file), "--rate", "0")
    assert "2 mistakes" in message
    assert "--rate: must be greater than or equal to 1" in message
    assert "a.yaml:4: node.tf_rate" in message


def test_debug_shows_the_traceback(capsys: Capture) -> None:
    assert main(["check", "loopback", "--rate", "0", "--debug"]) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_ros_arguments_are_taken_as_they_are(capsys: Capture) -> None:
    split = split_arguments(["ur", "--debug", "--ros-args", "-r", "__ns:=/a", "--debug"])
    assert split.arguments == ["ur"]
    assert split.ros_args == ["--ros-args", "-r", "__ns:=/a", "--debug"]
    assert split.debug
    assert "`list` starts no node" in refusal(capsys, "list", "--ros-args", "-r", "a:=b")


@pytest.mark.parametrize(("count", "code"), [("2", 0), ("3", 3), ("13", 1), ("0", 2)])
def test_a_tool_of_a_device(count: str, code: int, capsys: Capture) -> None:
    assert main(["tooled", "info", "--address", "there", "--count", count]) == code
    shown = capsys.readouterr()
    if code != 2:
        assert f"there looked at {count} times" in shown.out
    assert ("nobody is there" in shown.err) is (code == 1)
    assert ("--count" in shown.err) is (code == 2)


def test_the_tools_of_a_device_are_in_its_help(capsys: Capture) -> None:
    assert main(["tooled", "--help"]) == 0
    shown = capsys.readouterr().out
    assert "Tells what it is. Starts no node." in shown
    assert "--ns" in shown
    assert main(["tooled", "info", "--help"]) == 0
    assert "How often" in capsys.readouterr().out


def test_options_of_a_tool_may_be_typed_without_their_names(capsys: Capture) -> None:
    assert main(["tooled", "again", "2", "--address", "there"]) == 0
    assert "there looked at 2 times" in capsys.readouterr().out
    assert main(["tooled", "again", "0"]) == 2
    assert "count" in capsys.readouterr().err
    assert main(["tooled", "again", "--help"]) == 0
    assert "[COUNT]" in capsys.readouterr().out


def test_version(capsys: Capture) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == "crtk-drivers 9.8\n"


def test_check_of_a_device_that_is_ready(capsys: Capture) -> None:
    patient = ["--sample-timeout", "10"]  # a busy machine is no fault
    assert main(["check", "loopback", "--rate", "50", *patient]) == 0
    text = capsys.readouterr().out
    for pattern in (
        r"reachable +ok",
        r"operating state +ok +DISABLED",
        r"rate +\w+ +[\d.]+ Hz of 50 Hz over 1 s",
        r"late cycles +\w+ +\d+ of \d+",
        r"ROS 2 +\w+",
        r"real-time priority +\w+",
    ):
        assert re.search(pattern, text), pattern
    assert "\nready" in text


def test_check_names_what_gives_real_time_priority(
    monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda limit: (0, 0))
    assert main(["check", "loopback", "--rate", "50", "--sample-timeout", "10"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "`sudo groupadd -f realtime; sudo usermod -aG realtime $USER`" in text
    assert "`@realtime - rtprio 98` to /etc/security/limits.conf. Log in again." in text


def test_check_of_a_device_that_does_not_answer(capsys: Capture) -> None:
    assert main(["check", "deaf", "--open-timeout", "0.1", "--sample-timeout", "0.1"]) == 1
    captured = capsys.readouterr()
    assert re.search(r"reachable +failed", captured.out)
    assert "not ready: 1 of" in captured.out


def test_our_commands_are_listed_as_their_own_pages_begin() -> None:
    root = click_app()
    for name, listed in OWN_COMMANDS.items():
        page = " ".join(root.get_command(None, name).help.split("\n\n")[0].split())
        assert page == listed.summary, name


HEAVY = {"numpy", "rclpy", "crtk_drivers.config", "crtk_driver_ur", "crtk_sim_backends"}


@pytest.mark.parametrize("command", ["--help", "list"])
def test_lists_import_neither_plugins_nor_their_libraries(command: str) -> None:
    code = f"""
import sys
from crtk_drivers.cli import main
assert main([{command!r}]) == 0
print(sorted(set(sys.modules) & {HEAVY}))
"""
    environment = {**os.environ, plugins.ONLY: "loopback,ur,web"}
    out = subprocess.check_output([sys.executable, "-c", code], text=True, env=environment)
    assert "Universal Robots" in out
    assert out.endswith("\n[]\n")


def test_importing_the_package_brings_neither_ros_nor_the_command_line() -> None:
    code = (
        "import sys, crtk_drivers; "
        "print([m for m in ('rclpy', 'typer', 'rich', 'numpy') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=100, check=True
    )
    assert result.stdout == "[]\n"


def test_a_lab_is_brought_up_without_importing_ros() -> None:
    code = "import sys, crtk_drivers.cli.up_command; print('rclpy' in sys.modules)"
    out = subprocess.check_output([sys.executable, "-c", code], text=True, timeout=100)
    assert out == "False\n"


@pytest.mark.sweep(2)
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_simulator_runs_until_it_is_told_to_stop(tmp_path: Path, end: signal.Signals) -> None:
    code = "import sys; from crtk_drivers.cli import main; sys.exit(main(['sim', 'ur']))"
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    with process:
        assert process.stderr is not None
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "Ctrl-C" in line:
                break
        process.send_signal(end)
        assert process.wait(30) == 0
    assert re.search(r"rtde +127\.\d+\.\d+\.\d+:30004", "".join(lines))


def test_signals_may_come_while_others_are_handled() -> None:
    """As from a launcher that passes them on: a handler that waits for a lock would wait for itself."""
    before = signal.getsignal(signal.SIGTERM)
    with stop_signals() as stopped:
        sending = (
            f"import os, time\nfor _ in range(9000): os.kill({os.getpid()}, 15); time.sleep(1e-5)"
        )
        sender = subprocess.Popen([sys.executable, "-c", sending])
        with sender:
            while sender.poll() is None:
                stopped.is_set()
                stopped.set()
        assert stopped.is_set()
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_terminal_that_is_closed_ends_what_runs_in_it() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also where nohup runs the tests
    try:
        with stop_signals() as stopped:
            signal.raise_signal(signal.SIGHUP)
            assert stopped.is_set()
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_DFL
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
        with stop_signals() as stopped:
            signal.raise_signal(signal.SIGHUP)
            assert not stopped.is_set()
    finally:
        signal.signal(signal.SIGHUP, before)


class Scripted:
    """A device on the far side of ROS that is not busy, and tells places one after the other."""

    crtk_commands = ("hold", "measured_js")
    manifest: Mapping[str, Any] = {}

    def __init__(self, places: Iterable[float]) -> None:
        self._places = iter(enumerate(places, 1))

    def wait_for_busy(self, is_busy: bool, timeout: float) -> bool:
        return not is_busy

    def measured_js(self, extra: bool) -> tuple[JointState, float]:
        found = next(self._places, None)
        if found is None:
            raise DataTimeout("no value yet")
        return JointState(vector([found[1]])), float(found[0])


@pytest.mark.parametrize(
    ("places", "stands"),
    [
        (chain((0.1, 0.2), repeat(0.3)), True),
        (count(0.0, 0.1), False),
        (repeat(math.nan), False),
        ((0.1, 0.1, 0.1), False),
    ],
    ids=["it comes to stand", "it moves on", "it tells no place", "it falls silent"],
)
def test_what_was_told_to_hold_is_looked_at(places: Iterable[float], stands: bool) -> None:
    device: Any = Scripted(places)
    assert is_seen_to_stand(device, 30.0 if stands else 0.3) is stands


RUNNING = Health(
    connected=True,
    rate=498.0,
    rate_expected=500.0,
    late_cycles=3,
    stream="servo_jp",
    refusals={"servo_jp: not_finite": 2},
    last_refusal="servo_jp refused (not_finite): position[0] is nan",
)


def test_the_status_line_tells_what_matters() -> None:
    enabled = Status(OperatingState.ENABLED, is_homed=True)
    text = status_text("ur /ur5", enabled, RUNNING).plain
    assert text == (
        "ur /ur5  ENABLED  rate 498/500 Hz  late 3  stream servo_jp  "
        "2 refused, last: servo_jp refused (not_finite): position[0] is nan"
    )
    fault = Status(OperatingState.FAULT, is_homed=False, detail="protective stop")
    assert status_text("a", fault, RUNNING).plain.startswith("a  FAULT not homed  rate")
    assert status_text("a", fault, RUNNING).plain.endswith("protective stop")
    note = Note(Severity.WARNING, ANOTHER_DRIVER, "ur 10.0.0.2 is in /ur5 too")
    text = status_text("ur /ur5", enabled, replace(RUNNING, notes=(note,))).plain
    assert "late 3  stream servo_jp  ur 10.0.0.2 is in /ur5 too  2 refused" in text


def test_the_status_line_of_a_device_that_is_connecting_is_no_fault(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.INFO)
    begun = "connecting to 192.168.1.10:30004 since 12:00:03"
    status = Status(OperatingState.FAULT, True, detail=begun, connecting=True)
    assert status_text("ur /ur5", status, Health(rate_expected=500.0)).plain == f"ur /ur5  {begun}"
    console = Console(file=io.StringIO())
    with StatusLine(console, "ur /ur5", lambda: (status, Health()), live=False) as line:
        line.update()
    assert [record.getMessage() for record in caplog.records] == [f"ur /ur5  {begun}"]


def test_on_a_narrow_terminal_the_reason_is_what_is_kept() -> None:
    remedy = "Check the address, and that the controller has finished starting."
    cause = "RTDE: cannot connect: Connection refused"
    fault = Status(OperatingState.FAULT, True, False, f"{cause}. {remedy}", remedy)
    health = Health(rate_expected=500.0, reconnects=12)
    for width, figures in (
        (100, "  rate 0/500 Hz  late 0  reconnects 12"),
        (80, "  rate 0/500 Hz  late 0"),
        (78, "  rate 0/500 Hz"),
        (60, ""),
    ):
        shown = status_text("ur /ur5", fault, health, width).plain
        assert shown == f"ur /ur5  FAULT{figures}  {cause}"


def test_the_status_line_is_live_on_a_terminal() -> None:
    out = io.StringIO()
    console = Console(file=out, force_terminal=True, width=60)
    now = [0.0]
    status = [Status()]
    line = StatusLine(console, "arm", lambda: (status[0], RUNNING), live=True, clock=lambda: now[0])
    with line:
        line.update()
        status[0] = Status(OperatingState.ENABLED)
        line.update()
        assert "ENABLED" not in out.getvalue()
        now[0] = 1.0
        line.update()
        assert "ENABLED" in out.getvalue()
    assert "…" in out.getvalue()


def test_without_a_terminal_the_status_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    now = [0.0]
    status = [Status()]
    line = StatusLine(
        Console(file=io.StringIO()),
        "arm",
        lambda: (status[0], RUNNING),
        live=False,
        clock=lambda: now[0],
    )
    with line:
        for now[0] in (0.0, 1.0, 60.0, 3599.0):
            line.update()
        assert len(caplog.records) == 1
        status[0] = Status(OperatingState.ENABLED, is_homed=True, is_busy=True)
        line.update()
        status[0] = Status(OperatingState.ENABLED, is_homed=True)
        for now[0] in (3600.0, 7198.0, 7200.0, 10000.0):
            line.update()
        status[0] = Status(
            OperatingState.PAUSED, is_homed=True, detail="safeguard stop. Close the gate."
        )
        line.update()
        status[0] = Status(OperatingState.FAULT, is_homed=True, detail="told by the engine")
        line.update()
    assert [record.getMessage() for record in caplog.records] == [
        "arm  DISABLED not homed",
        "arm  ENABLED",
        "arm  ENABLED  rate 498/500 Hz  late 3  stream servo_jp  "
        "2 refused, last: servo_jp refused (not_finite): position[0] is nan",
        "arm  PAUSED  safeguard stop. Close the gate.",
    ]


@pytest.fixture
def root_logger() -> Iterator[None]:
    root = logging.getLogger()
    before = root.handlers[:], root.level
    yield
    root.handlers[:], _ = before
    root.setLevel(before[1])
    logging.captureWarnings(False)


@pytest.mark.usefixtures("root_logger")
def test_logs_as_json_are_one_object_a_line() -> None:
    out = io.StringIO()
    set_up_logging(Console(file=out, width=20), "info", LogFormat.JSON)
    try:
        raise ValueError("lost\nline")
    except ValueError:
        logging.getLogger("arm").exception("broken [bold]%s", "x" * 40, extra={"joint": 3})
    logging.getLogger("arm").debug("not shown")
    (line,) = out.getvalue().splitlines()
    entry = json.loads(line)
    assert (entry["level"], entry["logger"], entry["joint"]) == ("error", "arm", 3)
    assert entry["message"] == "broken [bold]" + "x" * 40
    assert "ValueError: lost" in entry["exception"]


@pytest.mark.usefixtures("root_logger")
def test_logs_as_text() -> None:
    out = io.StringIO()
    set_up_logging(Console(file=out, width=20), "warning", LogFormat.TEXT)
    logging.getLogger("arm").warning("no [markup] here, and no wrapping of a long line")
    logging.getLogger("arm").info("not shown")
    assert re.fullmatch(
        r"\d\d:\d\d:\d\d warning no \[markup\] here, and no wrapping of a long line\n",
        out.getvalue(),
    )


@pytest.fixture
def nobody_reads(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Standard error leads to a program that has ended: `crtk-driver ... 2>&1 | tee log`."""
    reading, writing = os.pipe()
    os.close(reading)
    file = os.fdopen(writing, "w")
    monkeypatch.setattr(ERR, "_file", file)
    monkeypatch.setattr(ERR, "quiet", False)
    yield
    with suppress(OSError):
        file.close()


@pytest.mark.usefixtures("root_logger", "nobody_reads")
def test_who_reads_the_log_no_more_ends_no_thread() -> None:
    """What tells of a fault may be the thread that talks to the device."""
    set_up_logging(ERR, "info", LogFormat.TEXT)
    for _ in range(2):
        logging.getLogger("arm").error("FAULT")


@pytest.mark.usefixtures("nobody_reads")
def test_the_bench_ends_as_by_ctrl_c_where_nobody_reads_what_it_tells() -> None:
    stop = StopRequest()
    with bench_runs._shown(stop) as show:
        show("arm", "T1", Verdict.PASS, "all is well")
        assert stop.is_set()
        show("arm", "T2", Verdict.PASS, "all is well")


class Opening:
    """A launch whose session is opened while rclpy is loaded."""

    def __init__(self, error: Exception | None = None) -> None:
        self.error = error
        self.is_closed = False

    def open(self) -> Any:
        if self.error is not None:
            raise self.error
        return self

    def close(self) -> None:
        self.is_closed = True


def test_an_interrupt_while_ros_is_loaded_closes_what_was_opened_beside_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(device_command, "import_module", interrupt)
    launch: Any = Opening()
    with pytest.raises(KeyboardInterrupt):
        device_command.opened(launch)
    assert launch.is_closed
    failing: Any = Opening(ConnectionFailed("in use"))
    with pytest.raises(KeyboardInterrupt):
        device_command.opened(failing)


def test_what_cannot_be_opened_beside_ros_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device_command, "import_module", lambda name: None)
    launch: Any = Opening(ConnectionFailed("in use"))
    with pytest.raises(ConnectionFailed, match="in use"):
        device_command.opened(launch)
