"""A lab as units of systemd: what systemd itself says of them, and what they would start."""

import configparser
import re
import shlex
import shutil
import subprocess
import sys

import pytest

from crtk_drivers.cli import main
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.units import units_of, write_units

LAB = """
name = "bench"
[devices.ft]
plugin = "ati-netft"
on = "arm"
settings = { host = "192.168.1.20" }
[devices.arm]
plugin = "ur"
settings = { host = "192.168.1.10", model = "ur5e" }
[devices.helper]
plugin = "dynamixel"
namespace = "/bench/helper"
settings = { port = "/dev/ttyUSB0", joints = { wrist = { id = 1, model = "xm430-w350" } } }
[devices.made_up]
plugin = "ur"
sim = true
sim_options = { model = "ur3e" }
settings = { model = "ur3e" }
[programs.teleop]
command = ["true"]
"""


@pytest.fixture
def lab(tmp_path):
    path = tmp_path / "my lab" / "lab.toml"
    path.parent.mkdir()
    path.write_text(LAB)
    return path


class Unit(configparser.RawConfigParser):
    """A unit, its keys as they are written; of one that comes more than once, the last."""

    def __init__(self, text):
        super().__init__(strict=False, interpolation=None, delimiters=("=",))
        self.optionxform = str
        self.read_string(text)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_finds_no_fault(lab, tmp_path, monkeypatch):
    monkeypatch.setenv("CYCLONEDDS_URI", '<Domain id="any">\n50%h, $HOME \\</Domain>')
    names = []
    for name, text in units_of(load_lab(lab), tmp_path).items():
        if not name.endswith(".yaml"):
            newer = re.compile("^(RestartSteps|RestartMaxDelaySec)=.*\n", re.MULTILINE)
            assert len(newer.findall(text)) == (2 if name.endswith("service") else 0)
            (tmp_path / name).write_text(newer.sub("", text))  # those of systemd 254
            names.append(str(tmp_path / name))
    assert len(names) == 5
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", *names],
        capture_output=True,
        text=True,
        timeout=50,
    )
    assert (done.returncode, done.stderr) == (0, "")


def test_order_and_belonging(lab):
    texts = units_of(load_lab(lab), lab.parent)
    target = Unit(texts["crtk-bench.target"])
    services = target["Unit"]["Wants"].split()
    assert sorted(services) == sorted(name for name in texts if name.endswith(".service"))
    ft = Unit(texts["crtk-bench-ft.service"])["Unit"]
    assert ft["PartOf"] == "crtk-bench.target"
    assert ft["After"].split() == ft["Wants"].split()
    assert ft["After"].split() == ["network-online.target", "crtk-bench-arm.service"]
    arm = Unit(texts["crtk-bench-arm.service"])["Unit"]
    assert arm["After"] == "network-online.target"


def test_units_are_those_of_a_machine(lab):
    text = lab.read_text().replace("[devices.arm]", '[devices.arm]\nmachine = "control"')
    lab.write_text('machine = "tracking"\n' + text)
    texts = units_of(load_lab(lab, machine="tracking"), lab.parent)
    assert Unit(texts["crtk-bench-ft.service"])["Unit"]["After"] == "network-online.target"
    services = Unit(texts["crtk-bench.target"])["Unit"]["Wants"].split()
    assert sorted(services) == sorted(name for name in texts if name.endswith(".service"))
    assert not any("arm" in name for name in texts)


def test_only_one_with_a_serial_line_reaches_it(lab):
    texts = units_of(load_lab(lab), lab.parent)
    with_groups = [name for name, text in texts.items() if "SupplementaryGroups=dialout" in text]
    assert with_groups == ["crtk-bench-helper.service"]
    for name in texts:
        if name.endswith(".service"):
            service = Unit(texts[name])["Service"]
            assert ("PrivateDevices" in service) is (name not in with_groups)
            assert service["KillSignal"] == "SIGTERM"
            assert service["NoNewPrivileges"] == service["DynamicUser"] == "yes"
            assert int(service["LimitRTPRIO"]) >= 10
            assert "RestrictRealtime" not in service


def test_the_command_is_that_of_the_supervisor_and_can_be_started(lab, tmp_path):
    folder = tmp_path / "units"
    write_units(load_lab(lab), folder)
    service = Unit((folder / "crtk-bench-made_up.service").read_text())["Service"]
    command = shlex.split(service["ExecStart"].replace("$$", "$").replace("%%", "%"))
    settings = folder / "crtk-bench-made_up.yaml"
    assert command == [
        *(sys.executable, "-m", "crtk_drivers.cli", "ur", "--ns", "/made_up"),
        *("--config", str(settings), "--sim", "--sim-set", "model=ur3e"),
    ]
    found = load_lab(lab).devices["made_up"]
    (tmp_path / "again.toml").write_text(
        f'[devices.x]\nplugin = "ur"\nsim = true\nconfig = "{settings}"\n'
    )
    assert load_lab(tmp_path / "again.toml").devices["x"].values == found.values


def test_percent_and_dollar_stay_as_they_are(lab, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setattr(sys, "executable", '/opt/a "b" %h $HOME\\n')
    text = units_of(load_lab(lab), tmp_path)["crtk-bench-arm.service"]
    assert 'ExecStart="/opt/a \\"b\\" %%h $$HOME\\\\n" "-m"' in text
    assert 'Environment="ROS_DOMAIN_ID=7"' in text
    assert 'Environment="HOME=%S/crtk-bench/arm"' in text


def test_what_is_not_ours_is_not_written_over(lab, tmp_path):
    folder = tmp_path / "units"
    first = write_units(load_lab(lab), folder)
    assert write_units(load_lab(lab), folder) == first
    (folder / "crtk-bench.target").write_text("[Unit]\n")
    (folder / "crtk-bench-arm.service").unlink()
    with pytest.raises(ConfigError, match=r"crtk-bench.target: is there already"):
        write_units(load_lab(lab), folder)
    assert not (folder / "crtk-bench-arm.service").exists()
    with pytest.raises(ConfigError, match="units cannot be written"):
        write_units(load_lab(lab), lab)


def test_on_the_command_line(lab, tmp_path, capsys):
    assert main(["up", str(lab), "arm", "--systemd", "-"]) == 0
    told = capsys.readouterr()
    assert "# ==> crtk-bench-arm.service\n" in told.out
    assert '"/etc/systemd/system/crtk-bench-arm.yaml"' in told.out
    assert "bench-ft" not in told.out
    assert main(["up", str(lab), "--systemd", str(tmp_path / "units")]) == 0
    told = capsys.readouterr()
    assert str(tmp_path / "units" / "crtk-bench.target") in told.out
    assert "Without a unit: teleop" in told.err
