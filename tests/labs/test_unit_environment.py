"""Whose environment the processes of a lab get: of units, of `up`, and of those that `sudo` starts."""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from crtk_drivers.cli import main
from crtk_drivers.config.variables import (
    DECIDING,
    SEARCH_PATHS,
    as_said,
    carried,
    elevated_by,
)
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import device_command, load_lab
from crtk_drivers.labs.lab_commands import require_commands
from crtk_drivers.labs.lab_outline import load_teleop
from crtk_drivers.labs.unit_environment import (
    closed_to_others,
    doubts,
    hidden,
    origin,
    unit_environment,
)
from crtk_drivers.labs.units import units_of, write_units
from crtk_drivers.ros import environment
from rigs.waiting import LONG

LAB = """
name = "bench"
[devices.one]
plugin = "loopback"
"""
TELEOP = """
[teleop]
leader = "one"
follower = "/two"
clutch = { topic = "/pedals/clutch" }
"""
SAID = "environment = {{ {} }}\n"
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


@pytest.fixture(autouse=True)
def _shell(monkeypatch):
    """A shell in which nothing was said of ROS 2."""
    for name in carried(os.environ):
        monkeypatch.delenv(name)


@pytest.fixture
def lab(tmp_path):
    def written(said: str = "", more: str = "") -> str:
        path = tmp_path / "lab.toml"
        path.write_text((SAID.format(said) if said else "") + LAB + more)
        return str(path)

    return written


def variables_of(text: str) -> dict[str, str]:
    """What systemd makes of the lines of a unit, but for its specifiers."""
    words = [shlex.split(line)[0] for line in re.findall("^Environment=(.*)$", text, re.MULTILINE)]
    told = (re.sub(r"\\x([0-9a-f]{2})", lambda at: chr(int(at[1], 16)), word) for word in words)
    found = (word.replace("%%", "%").partition("=") for word in told)
    return {name: value for name, _, value in found}


def unit(lab: str, tmp_path, **given) -> dict[str, str]:
    return variables_of(units_of(load_lab(lab, **given), tmp_path)["crtk-bench-one.service"])


# --------------------------------------------------------------------------------------- who gets in


def test_a_unit_stays_on_this_machine(lab, tmp_path):
    found = unit(lab(), tmp_path)
    assert (found["ROS_DOMAIN_ID"], found[RANGE]) == ("0", "LOCALHOST")


@pytest.mark.parametrize("said", [f'{RANGE} = "SUBNET"', 'ROS_STATIC_PEERS = "192.0.2.7"'])
def test_only_the_lab_file_opens_the_network(lab, tmp_path, monkeypatch, said):
    name, value = said.replace('"', "").split(" = ")
    assert unit(lab(said), tmp_path)[name] == value
    with pytest.raises(
        ConfigError, match=rf"{name}={value} would let other machines .*{re.escape(said)}"
    ):
        unit(lab(), tmp_path, environment={name: value})
    monkeypatch.setenv(name, value)
    with pytest.raises(ConfigError, match="would let other machines"):
        unit(lab(), tmp_path)
    assert (
        unit(lab(f'{RANGE} = "LOCALHOST", ROS_STATIC_PEERS = ""'), tmp_path)[RANGE] == "LOCALHOST"
    )


@pytest.mark.parametrize(
    ("said", "typed"),
    [
        (f'{RANGE} = "LOCALHOST"', {RANGE: "SUBNET"}),
        ('ROS_STATIC_PEERS = ""', {"ROS_STATIC_PEERS": "192.0.2.7"}),
        ('ROS_STATIC_PEERS = "192.0.2.1"', {"ROS_STATIC_PEERS": "192.0.2.1;192.0.2.7"}),
    ],
)
def test_a_closed_lab_file_is_not_opened_elsewhere(lab, tmp_path, said, typed):
    with pytest.raises(ConfigError, match="would let other machines"):
        unit(lab(said), tmp_path, environment=typed)


def test_what_we_make_of_localhost_stays_localhost(lab, tmp_path, monkeypatch):
    monkeypatch.setenv(RANGE, "LOCALHOST")
    for name in environment.PROFILES:
        monkeypatch.setenv(name, "")
    environment.share_no_memory()
    assert os.environ[RANGE] == "SYSTEM_DEFAULT"
    found = unit(lab(), tmp_path)
    assert found[RANGE] == "LOCALHOST"
    assert not found.keys() & set(environment.PROFILES)


# ------------------------------------------------------------------------------------ what is carried


def test_what_an_installed_ros_needs_is_carried(lab, tmp_path, monkeypatch):
    needed = {name: f"/opt/{name}" for name in (*DECIDING, *SEARCH_PATHS)}
    needed |= {"ROS_DOMAIN_ID": "7", RANGE: "LOCALHOST", "ROS_SECURITY_ENABLE": "true"}
    del needed["ROS_STATIC_PEERS"]
    needed["CYCLONEDDS_URI"] = '<Domain id="any">\r\n\t50%, $HOME \\ é</Domain>'
    needed |= {"RMW_FASTRTPS_PUBLICATION_MODE": "ASYNCHRONOUS", "CRTK_DRIVERS_ONLY": "loopback"}
    for name, value in needed.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("ROS_LOG_DIR", "/of/the/shell")
    found = unit(lab(), tmp_path)
    assert {name: found[name] for name in needed} == needed
    assert found["ROS_LOG_DIR"] == "%L/crtk-bench/one"


def test_relative_paths_count_from_where_they_were_said(lab, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", "build:/opt/ros:")
    monkeypatch.setenv(environment.PROFILES[0], "mine.xml")
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///etc/a.xml,b.xml")
    found = unit(lab(), tmp_path)
    assert found["PYTHONPATH"] == f"{tmp_path}/build:/opt/ros"
    assert found[environment.PROFILES[0]] == f"{tmp_path}/mine.xml"
    assert found["CYCLONEDDS_URI"] == f"file:///etc/a.xml,{tmp_path}/b.xml"


def test_paths_of_a_lab_file_count_from_it(lab, tmp_path, monkeypatch):
    path = lab('ROS_SECURITY_KEYSTORE = "keys", CYCLONEDDS_URI = "c.xml"')
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    found = unit(path, tmp_path, environment={"PYTHONPATH": "typed"})
    assert found["ROS_SECURITY_KEYSTORE"] == f"{tmp_path}/keys"
    assert found["CYCLONEDDS_URI"] == f"{tmp_path}/c.xml"
    assert found["PYTHONPATH"] == f"{tmp_path}/elsewhere/typed"
    assert origin(load_lab(path), "ROS_SECURITY_KEYSTORE") == "of the lab file"
    environment_of_teleop = load_teleop(lab('PYTHONPATH = "src"', TELEOP)).environment
    assert environment_of_teleop == {"PYTHONPATH": f"{tmp_path}/src"}


def test_bytes_that_are_no_text_are_refused_whole(lab, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PYTHONPATH", os.fsdecode(b"/opt/\xff"))
    units = tmp_path / "units"
    assert main(["up", lab(), "--systemd", str(units)]) == 2
    assert "PYTHONPATH: '/opt/\\udcff' is not UTF-8" in capsys.readouterr().err
    assert not units.exists()


def test_every_user_may_read_what_is_written(lab, tmp_path):
    before = os.umask(0o077)
    try:
        write_units(load_lab(lab()), tmp_path / "units")
    finally:
        os.umask(before)
    assert {path.stat().st_mode & 0o777 for path in (tmp_path / "units").iterdir()} == {0o644}


def test_what_a_unit_cannot_read_is_named(lab, tmp_path):
    with tempfile.TemporaryDirectory() as folder:  # below no closed one, as pytest's are
        private = Path(folder)
        private.chmod(0o755)
        key = private / "keys/enclaves/one/crtk_driver/key.pem"
        key.parent.mkdir(parents=True)
        key.touch(0o600)
        link = tmp_path / "link"
        link.symlink_to(private / "keys")
        found = load_lab(lab(f'ROS_SECURITY_ENABLE = true, ROS_SECURITY_KEYSTORE = "{link}"'))
        assert key in closed_to_others(found, found.environment)
        private.chmod(0o700)
        assert closed_to_others(found, found.environment)[private] == link
        assert link in hidden(found, found.environment)  # below /tmp


def test_what_the_wheels_add_themselves_is_left_out(lab, tmp_path, monkeypatch):
    own = f"{sys.prefix}/lib:{sys.prefix}/lib/python3/site-packages/ros_rcl.libs"
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{own}:/opt/vendor")
    assert unit(lab(), tmp_path)["LD_LIBRARY_PATH"] == "/opt/vendor"
    monkeypatch.setenv("LD_LIBRARY_PATH", own)
    assert "LD_LIBRARY_PATH" not in unit(lab(), tmp_path)


def test_the_environment_is_shown(lab, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", "file:///nowhere.xml")
    path = lab("ROS_DOMAIN_ID = 42")
    typed = ["--env", "MY_LIBRARY=/opt/it", "--systemd", str(tmp_path / "units")]
    assert main(["up", path, *typed]) == 0
    told = capsys.readouterr().err
    assert "ROS_DOMAIN_ID=42  (of the lab file)" in told
    assert f"{RANGE}=LOCALHOST  (nothing was said)" in told
    assert "MY_LIBRARY=/opt/it  (of --env)" in told
    assert "CYCLONEDDS_URI: there is no /nowhere.xml" in told
    assert "CYCLONEDDS_URI decides beside" in told


def test_units_may_be_written_for_another_folder(lab, tmp_path, capsys):
    assert (
        main(["up", lab(), "--systemd", str(tmp_path / "u"), "--for", "/etc/systemd/system"]) == 0
    )
    text = (tmp_path / "u" / "crtk-bench-one.service").read_text()
    assert '"--config" "/etc/systemd/system/crtk-bench-one.yaml"' in text
    assert (tmp_path / "u" / "crtk-bench-one.yaml").exists()
    assert main(["up", lab(), "--for", "/etc"]) == 2


def test_a_unit_that_cannot_start_is_told_as_it_is_written(lab, tmp_path, capsys):
    path = lab('RMW_IMPLEMENTATION = "rmw_of_nobody"')
    assert main(["up", path, "--systemd", str(tmp_path / "units")]) == 1
    assert re.search("units cannot start as they are: .*rmw_of_nobody", capsys.readouterr().err)


# ----------------------------------------------------------------------------------- what sudo drops

SUDO = """#!/bin/sh
env -i PATH="$PATH" SUDO_USER=somebody SUDO_UID=1000 SUDO_COMMAND="$*" "$@"
"""


def as_root(tmp_path, *words: str, **shell: str) -> subprocess.CompletedProcess[str]:
    """What `sudo crtk-driver` does in a shell that has some variables."""
    sudo = tmp_path / "sudo"
    sudo.write_text(SUDO)
    sudo.chmod(0o755)
    return subprocess.run(
        [str(sudo), sys.executable, "-m", "crtk_drivers.cli", *words],
        env={"PATH": os.environ["PATH"], **shell},
        capture_output=True,
        text=True,
        timeout=LONG,
    )


def test_what_sudo_drops_is_refused_by_name(lab, tmp_path):
    units = tmp_path / "units"
    words = ("up", lab(), "--systemd", str(units))
    shell = {"ROS_DOMAIN_ID": "42", "ROS_SECURITY_KEYSTORE": "/keys", RANGE: "LOCALHOST"}
    done = as_root(tmp_path, *words, **shell)
    assert done.returncode == 2
    assert "sudo has dropped" in done.stderr
    assert "ROS_DOMAIN_ID=42 ROS_SECURITY_KEYSTORE=/keys" in done.stderr
    assert not units.exists()
    typed = ("--env", "ROS_SECURITY_KEYSTORE=")
    done = as_root(tmp_path, "up", lab("ROS_DOMAIN_ID = 42"), *words[2:], *typed, **shell)
    assert done.returncode == 0, done.stderr
    found = variables_of((units / "crtk-bench-one.service").read_text())
    assert (found["ROS_DOMAIN_ID"], found[RANGE]) == ("42", "LOCALHOST")


@pytest.mark.parametrize("words", [["up"], ["loopback", "--ns", "/here"], ["state"]])
def test_nobody_runs_in_another_domain_because_of_sudo(lab, tmp_path, words):
    given = [*words, lab()] if words == ["up"] else words
    done = as_root(tmp_path, *given, ROS_DOMAIN_ID="42")
    assert done.returncode == 2
    assert "sudo has dropped ROS_DOMAIN_ID=42" in done.stderr


@pytest.mark.parametrize("marker", ["SUDO_COMMAND", "SUDO_USER", "DOAS_USER", "PKEXEC_UID"])
def test_a_domain_is_asked_for_where_nobody_knows(lab, tmp_path, monkeypatch, marker):
    monkeypatch.setenv(marker, "1000")
    assert elevated_by(os.environ)
    with pytest.raises(ConfigError, match="nobody says in which domain"):
        unit(lab(), tmp_path)
    assert unit(lab(), tmp_path, environment={"ROS_DOMAIN_ID": "3"})["ROS_DOMAIN_ID"] == "3"
    monkeypatch.setenv("ROS_DOMAIN_ID", "4")  # as with `sudo --preserve-env`
    assert unit(lab(), tmp_path)["ROS_DOMAIN_ID"] == "4"


@pytest.mark.parametrize(
    "said",
    [
        "ROS_DOMAIN_ID=0",
        "ROS_LOCALHOST_ONLY=0",
        f"{RANGE}=SUBNET",
        "RMW_IMPLEMENTATION=rmw_fastrtps_cpp",
        "ROS_SECURITY_ENABLE=false",
        "FASTDDS_BUILTIN_TRANSPORTS=UDPv4",
    ],
)
def test_what_changes_nothing_may_be_dropped(monkeypatch, said):
    name, _, value = said.partition("=")
    monkeypatch.setenv("SUDO_USER", "somebody")
    monkeypatch.setattr("crtk_drivers.config.variables.before", lambda program: {name: value})
    environment.check()


def test_what_was_dropped_is_told_as_said(monkeypatch):
    made = dict.fromkeys(environment.PROFILES, str(environment.LOOPBACK))
    made[RANGE] = "SYSTEM_DEFAULT"
    monkeypatch.setenv("SUDO_USER", "somebody")
    monkeypatch.setattr("crtk_drivers.config.variables.before", lambda program: made)
    with pytest.raises(ConfigError, match=f"sudo has dropped {RANGE}=LOCALHOST[.]"):
        environment.check()


# --------------------------------------------------------------------------------- what may be said


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("ROS_DOMAIN_ID = 300", "not a ROS domain"),
        (f'{RANGE} = "localhost"', "none of LOCALHOST"),
        ("ROS_DOMAINID = 4", "Did you mean 'ROS_DOMAIN_ID'"),
        ("ROS_SECURITY_ENABLE = 1", "'1' is none of false, true"),
        ('ROS_SECURITY_STRATEGY = "enforce"', "'enforce' is none of Permissive, Enforce"),
        ('ROS_LOCALHOST_ONLY = "true"', "'true' is none of 0, 1"),
        ('"A B" = "c"', "no name of a variable"),
        ('A = "b\\nc"', "more than one line"),
    ],
)
def test_a_variable_that_cannot_be_right_is_refused(lab, capsys, said, why):
    with pytest.raises(ConfigError, match=why):
        load_lab(lab(said))


def test_yes_and_no_are_as_ros_reads_them(lab):
    said = f"ROS_LOCALHOST_ONLY = true, ROS_SECURITY_ENABLE = false, {RANGE} = false"
    found = load_lab(lab(said)).environment
    assert (found["ROS_LOCALHOST_ONLY"], found["ROS_SECURITY_ENABLE"]) == ("1", "false")
    assert found[RANGE] == "OFF"  # as YAML reads OFF
    assert load_lab(lab("OTHER_ROS_DOMAIN_ID = 3")).environment["OTHER_ROS_DOMAIN_ID"] == "3"


def test_two_that_contradict_are_told(lab):
    found = load_lab(lab(f'ROS_LOCALHOST_ONLY = 1, {RANGE} = "SUBNET"'))
    assert "ROS_LOCALHOST_ONLY=1 goes over" in " ".join(doubts(unit_environment(found)))


def test_programs_are_found_in_the_path_of_the_lab(lab, tmp_path):
    tool = tmp_path / "bin" / "mine"
    tool.parent.mkdir()
    tool.write_text("#!/bin/sh\n")
    tool.chmod(0o755)
    program = '[programs.p]\ncommand = ["mine"]\n'
    require_commands(load_lab(lab(f'PATH = "{tool.parent}"', program)))
    with pytest.raises(ConfigError, match="no program 'mine' in PATH"):
        require_commands(load_lab(lab(more=program)))


def test_ros_without_a_home_says_so(monkeypatch):
    error = RuntimeError("failed to initialize logging: Failed to get logging directory, at x")
    assert "neither ROS_LOG_DIR nor HOME is set" in str(environment.not_started(error, ()))


def test_a_variable_is_typed_with_its_value(lab, capsys):
    assert main(["up", lab(), "--systemd", "-", "--env", "ROS_DOMAIN_ID"]) == 2
    assert main(["up", lab(), "--systemd", "-", "--env", "ROS_DOMAIN_ID=x"]) == 2
    assert "--env ROS_DOMAIN_ID=VALUE" in capsys.readouterr().err


# ------------------------------------------------------------------------------------------ SROS2


def test_a_device_runs_in_its_enclave(lab, tmp_path, monkeypatch):
    def command(path: str) -> list[str]:
        return list(device_command(load_lab(path).devices["one"], tmp_path / "one.yaml"))

    assert "--ros-args" not in command(lab())
    assert command(lab(more='enclave = "/mine"\n'))[-3:] == ["--ros-args", "--enclave", "/mine"]
    assert command(lab("ROS_SECURITY_ENABLE = true"))[-1] == "/one/crtk_driver"
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    assert command(lab())[-1] == "/one/crtk_driver"
    with pytest.raises(ConfigError, match="is no enclave"):
        load_lab(lab(more='enclave = "mine"\n'))
    text = units_of(load_lab(lab(more='enclave = "/mine"\n')), tmp_path)["crtk-bench-one.service"]
    assert '"--ros-args" "--enclave" "/mine"\n' in text


# -------------------------------------------------------------------------------- hardware in units


@pytest.mark.parametrize(
    ("device", "rights"),
    [
        ('plugin = "inputs"\nsettings = { path = "/dev/input/by-id/pedal" }', "char-input"),
        ('plugin = "force-dimension"', "char-usb_device"),
    ],
)
def test_a_unit_may_use_its_hardware(lab, tmp_path, device, rights):
    found = units_of(load_lab(lab(more=f"[devices.two]\n{device}\n")), tmp_path)
    text = found["crtk-bench-two.service"]
    assert f"DeviceAllow={rights} rw" in text
    assert "PrivateDevices" not in text
    assert "PrivateDevices=yes" in found["crtk-bench-one.service"]


def test_as_said_changes_nothing_that_a_user_said():
    said = {RANGE: "SUBNET", environment.PROFILES[0]: "/etc/mine.xml"}
    assert as_said(said) == said
