"""The lab file: what it says is checked completely, and what is wrong is told with its line."""

import pytest

from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab

ARM = '[devices.arm]\nplugin = "ur"\nsettings = { host = "192.168.1.10" }\n'
FT = '[devices.ft]\nplugin = "ati-netft"\non = "arm"\nsettings = { host = "192.168.1.20" }\n'


@pytest.fixture
def lab(tmp_path):
    def written(text: str):
        path = tmp_path / "lab.toml"
        path.write_text(text)
        return path

    return written


def test_what_it_says(lab):
    found = load_lab(lab(f'name = "bench"\n{FT}{ARM}[programs.p]\ncommand = ["true"]\n'))
    assert found.name == "bench"
    assert list(found.devices) == ["arm", "ft"], "what carries others comes first"
    arm, ft = found.devices.values()
    assert (arm.namespace, arm.address, arm.sim, arm.after) == ("/arm", "192.168.1.10", False, ())
    assert ft.after == ("arm",)
    assert found.programs["p"].command == ("true",)
    assert set(found.programs["p"].after) == {"arm", "ft"}


def test_all_are_simulated_that_can_be(lab):
    found = load_lab(
        lab(f'{ARM}[devices.dummy]\nplugin = "loopback"\nnamespace = "/a/b"\n'), sim=True
    )
    assert [device.sim for device in found.devices.values()] == [True, False]
    assert found.devices["arm"].address == ""
    assert found.devices["dummy"].namespace == "/a/b"


def test_only_some(lab):
    found = load_lab(lab(f'{ARM}{FT}[programs.p]\ncommand = ["true"]\n'), only=("ft",))
    assert list(found.devices) == ["ft"]
    assert not found.programs


def test_settings_of_a_file_beside_it(lab, tmp_path):
    (tmp_path / "arm.yaml").write_text("host: 192.168.1.11\nmodel: ur10e\n")
    path = lab('[devices.arm]\nplugin = "ur"\nconfig = "arm.yaml"\nsettings = { model = "ur3e" }\n')
    found = load_lab(path).devices["arm"]
    assert found.values == {"host": "192.168.1.11", "model": "ur3e"}
    assert found.address == "192.168.1.11"


def test_a_table_of_the_lab_file_goes_over_that_of_the_file_key_by_key(lab, tmp_path):
    (tmp_path / "arm.yaml").write_text("host: 192.168.1.11\nservo: {gain: 400, lookahead: 0.2}\n")
    path = lab(
        '[devices.arm]\nplugin = "ur"\nconfig = "arm.yaml"\nsettings = { servo = { gain = 500 } }\n'
    )
    found = load_lab(path).devices["arm"]
    assert found.values["servo"] == {"gain": 500, "lookahead": 0.2}
    assert (found.config.servo.gain, found.config.servo.lookahead) == (500, 0.2)


@pytest.mark.parametrize(
    ("text", "line", "told"),
    [
        ("", "", "devices: is required"),
        (f"{ARM}colour = 1\n", ":4", "colour"),
        (ARM.replace("plugin", "pluggin"), ":2", "Did you mean 'devices.arm.plugin'"),
        (ARM.replace('"ur"', '"ut"'), ":2", "Did you mean 'ur'"),
        (ARM.replace("host", "hots"), ":3", "Did you mean 'host'"),
        (ARM.replace("settings", "sim_options"), ":1", "host: is required for real hardware"),
        (f"{ARM}after = ['tf']\n", ":1", "there is no device 'tf'"),
        (f'{ARM}namespace = "ur 5"\n', ":4", "is not a namespace"),
        (ARM.replace("devices.arm", 'devices."5"'), ":1", "is no name"),
        (f"{ARM}{ARM.replace('arm', 'b')}", ":4", "arm and b have one address"),
        (
            f"{ARM}{ARM.replace('arm', 'b').replace('10', '11')}namespace = '/arm'\n",
            ":4",
            "arm and b have one namespace: /arm",
        ),
        (f"{ARM}on = 'ft'\n{FT}", "", "each waits for the next"),
        (f"{ARM}[programs.p]\ncommand = []\n", ":5", "command"),
        (f"{ARM}[programs.p]\ncommand = ['']\n", ":5", "names no program"),
        (f"{ARM}[programs.p]\ncommand = ['a', '']\n", ":5", "has an empty argument"),
        (f"{ARM}power_off = ['']\n", ":4", "devices.arm.power_off: names no program"),
        (f'{ARM}power_off = ["a\\u0000b"]\n', ":4", "has a NUL character"),
        (f"{ARM}[programs.p]\ncommand = ['a']\nafter = ['x']\n", ":6", "there is no device 'x'"),
        ('[devices.d]\nplugin = "loopback"\nsim = true\n', ":2", "has no simulator"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(lab, text, line, told):
    path = lab(text)
    with pytest.raises(ConfigError) as caught:
        load_lab(path)
    assert f"{path}{line}" in str(caught.value)
    assert told in str(caught.value)


def test_options_of_a_simulator_are_checked_where_there_is_one(lab):
    path = lab(f"{ARM}[devices.arm.sim_options]\nmodell = 'ur3e'\n")
    load_lab(path)
    with pytest.raises(ConfigError, match="Did you mean 'model'") as caught:
        load_lab(path, sim=True)
    assert f"{path}:5" in str(caught.value)


def test_a_device_that_is_not_there_cannot_be_chosen(lab):
    with pytest.raises(ConfigError, match="there is no device 'amr'"):
        load_lab(lab(ARM), only=("amr",))
