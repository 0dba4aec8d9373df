"""A lab on several machines: who starts what, as the lab file says."""

import pytest

from crtk_drivers.client.view.watcher import wanted
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.lab_outline import load_outline
from crtk_drivers.labs.machines import is_called
from rigs.lab_files import PAIR

TWO = f"""{PAIR}
[programs.teleop]
command = ["true"]

[programs.logger]
command = ["true"]
machine = "tracking"
"""


@pytest.fixture
def written(tmp_path):
    def write(text):
        path = tmp_path / "lab.toml"
        path.write_text(text)
        return path

    return write


def test_a_machine_starts_its_share(written):
    lab = load_lab(written(TWO), machine="control")
    assert (tuple(lab.devices), tuple(lab.programs)) == (("arm",), ("teleop",))
    assert lab.programs["teleop"].after == ("arm", "camera")
    there = lab.elsewhere["camera"]
    assert (there.namespace, there.machine) == ("/camera", "tracking")
    assert (lab.machine, lab.machines) == ("control", ("control", "tracking"))


def test_this_machine_goes_by_its_host_name(written, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "CONTROL.lab.example")
    assert load_lab(written(TWO), machine="").machine == "control"
    monkeypatch.setattr("socket.gethostname", lambda: "laptop")
    with pytest.raises(ConfigError, match=r"called 'laptop'.*control, tracking.*--machine control"):
        load_lab(written(TWO), machine="")


def test_a_machine_may_be_written_long_and_typed_short(written):
    long = written(TWO.replace('"control"', '"Control.lab.example"'))
    assert load_lab(long, machine="control").machine == "Control.lab.example"


def test_a_host_name_may_have_an_underscore(written, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "lab_pc")
    assert load_lab(written(TWO.replace('"control"', '"lab_pc"')), machine="").machine == "lab_pc"


def test_a_short_name_of_two_machines_is_refused(written, monkeypatch):
    two = TWO.replace('"control"', '"pc.left"').replace('"tracking"', '"pc.right"')
    monkeypatch.setattr("socket.gethostname", lambda: "pc")
    with pytest.raises(ConfigError, match=r"pc\.left.*pc\.right.*--machine pc\.left"):
        load_lab(written(two), machine="")
    monkeypatch.setattr("socket.gethostname", lambda: "pc.left")
    assert load_lab(written(two), machine="").machine == "pc.left"


def test_all_machines_are_typed_in_any_case(written):
    lab = load_lab(written(TWO.replace("of-tracking", "loopback")), machine="ALL")
    assert tuple(lab.devices) == ("arm", "camera")


CYCLE = """
[devices.arm]
plugin = "loopback"
machine = "control"
after = ["camera"]

[devices.camera]
plugin = "of-tracking"
machine = "tracking"
after = ["arm"]
"""


def test_machines_that_wait_for_each_other_are_refused(written):
    with pytest.raises(ConfigError, match=r"each waits for the next: .*arm"):
        load_lab(written(CYCLE), machine="control")
    with pytest.raises(ConfigError, match="there is no device 'hand'"):
        load_lab(written(CYCLE.replace('["arm"]', '["hand"]')), machine="control")


def test_the_whole_lab_needs_every_plugin(written):
    with pytest.raises(ConfigError, match="of-tracking"):
        load_lab(written(TWO))
    assert not load_lab(written(TWO.replace("of-tracking", "ndi")), sim=True).elsewhere


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ('machine = "control"\n', "", "nobody says which machine starts arm"),
        ('"tracking"', '"control.lab.example"', "are one machine by their names"),
        ('"tracking"', '"-tracking"', "is no host name"),
        ('"tracking"', '"All"', "is no machine"),
        (
            'plugin = "of-tracking',
            'namespace = "/arm"\nplugin = "of-tracking',
            "have one namespace: /arm",
        ),
    ],
)
def test_what_cannot_be_is_refused(written, old, new, why):
    with pytest.raises(ConfigError, match=why):
        load_lab(written(TWO.replace(old, new)), machine="control")


@pytest.mark.parametrize(
    ("machine", "why"),
    [("laptop", "no machine 'laptop'.*control, tracking"), ("tracking", "of-tracking")],
)
def test_a_machine_that_was_typed(written, machine, why):
    with pytest.raises(ConfigError, match=why):
        load_lab(written(TWO), machine=machine)


def test_a_device_of_another_machine_is_not_started_here(written):
    with pytest.raises(
        ConfigError, match="camera is started by tracking, and this machine is cont"
    ):
        load_lab(written(TWO), machine="control", only=("camera",))


def test_a_lab_without_machines_has_none(written):
    plain = '[devices.arm]\nplugin = "loopback"\n'
    lab = load_lab(written(plain), machine="")
    assert (lab.machine, lab.machines, dict(lab.elsewhere)) == ("", (), {})
    with pytest.raises(ConfigError, match="names no machine"):
        load_lab(written(plain), machine="control")


def test_a_serial_port_is_one_of_each_machine(written):
    both = "\n".join(
        f'[devices.{name}]\nplugin = "robotiq"\nmachine = "{machine}"\nsettings.port = "/dev/ttyUSB0"'
        for name, machine in (("left", "one"), ("right", "two"))
    )
    assert len(load_lab(written(both)).devices) == 2
    with pytest.raises(ConfigError, match="have one address"):
        load_lab(written(both.replace('"two"', '"one"')))


def test_an_address_of_the_network_is_one_of_all_machines(written, tmp_path):
    both = "\n".join(
        f'[devices.{name}]\nplugin = "ati-netft"\nmachine = "{machine}"\nsettings.host = "192.168.1.1"'
        for name, machine in (("left", "one"), ("right", "two"))
    )
    with pytest.raises(ConfigError, match="left and right have one address"):
        load_lab(written(both), machine="one")
    assert load_lab(written(both), machine="one", sim=True).elsewhere
    there = both + '\nconfig = "only-there.toml"'
    assert load_lab(written(there), machine="one").elsewhere, "its settings are checked there"


@pytest.mark.parametrize(
    ("host", "name", "same"),
    [
        ("control", "control", True),
        ("control.lab.example", "control", True),
        ("Control", "control", True),
        ("control2", "control", False),
        ("control", "control.lab.example", False),
    ],
)
def test_a_long_host_name_is_its_first_part(host, name, same):
    assert is_called(host, name) is same


def test_clients_need_no_drivers(written):
    outline = load_outline(written(TWO))
    assert outline.namespaces() == {"arm": "/arm", "camera": "/camera"}
    assert outline.namespaces(("camera",)) == {"camera": "/camera"}
    with pytest.raises(ConfigError, match="there is no device 'ft'"):
        outline.namespaces(("ft",))


def test_a_client_is_not_given_two_devices_of_one_name(written):
    both = TWO.replace('plugin = "of-', 'namespace = "/arm"\nplugin = "of-')
    with pytest.raises(ConfigError, match="have one namespace: /arm"):
        load_outline(written(both)).namespaces()


def test_a_page_shows_devices_of_all_machines(written):
    lab = TWO.replace('machine = "tracking"', 'machine = "tracking"\non = "arm"', 1)
    found = wanted([str(written(lab))])
    assert found.namespaces == ("/arm", "/camera")
    assert found.mounted["/camera"][0] == "/arm"
