"""What `crtk-driver lab check` says of what it has seen of the machines of a lab."""

from dataclasses import replace

import pytest

from crtk_drivers.client.lab_findings import View, findings
from crtk_drivers.client.lab_look import Looked
from crtk_drivers.client.other_domains import Announced
from crtk_drivers.labs import load_lab
from crtk_drivers.labs.seen import Seen
from crtk_drivers.ros.presence import Word
from rigs.lab_files import PAIR

pytestmark = pytest.mark.ros

LAB = f"""{PAIR}
[devices.hand]
plugin = "loopback"
machine = "tracking"
"""


def word(host, key="a"):
    return Word(key, (False, 0, key), "loopback", "1", host, True)


def looked(name, host, offset=0.0, uncertainty=0.001, version="1.0"):
    seen = Seen(name, True, "DISABLED", host=host, offset=offset, uncertainty=uncertainty)
    return Looked(seen, (word(host),), version, "1.3.0")


IN_ORDER = {
    "arm": looked("arm", "control"),
    "camera": looked("camera", "tracking"),
    "hand": looked("hand", "Tracking.lab.example"),
}
GONE = {name: Looked(Seen(name, False)) for name in IN_ORDER}


@pytest.fixture
def judge(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    lab = load_lab(path, machine="control")

    def found(driver_version="1.0", *, other_domains=None, announced=(), **changed):
        view = View(IN_ORDER | changed, 42, driver_version, "1.3.0", other_domains or {}, announced)
        return [(each.is_wrong, each.text, each.remedy) for each in findings(lab, view)]

    return found


def test_nothing_is_wrong_with_a_lab_in_order(judge):
    assert judge() == []


def test_a_device_on_another_host_is_wrong(judge):
    [(wrong, text, remedy)] = judge(camera=looked("camera", "control"))
    assert wrong
    assert text == "camera runs on control, and the lab file gives it to tracking"
    assert 'machine = "control"' in remedy


def test_hosts_outside_the_lab_file_are_a_note(judge):
    [(wrong, text, remedy)] = judge(
        camera=looked("camera", "laptop"), hand=looked("hand", "laptop")
    )
    assert not wrong
    assert text == "laptop, which the lab file does not name, runs camera, hand of tracking"
    assert "--machine tracking" in remedy
    assert 'machine = "laptop"' in remedy


def test_this_machine_may_be_called_otherwise(judge, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "pc7")
    assert judge(arm=looked("arm", "pc7")) == []


def test_a_clock_of_an_unnamed_host_is_its_machines(judge):
    [(_, text, _)] = judge(camera=looked("camera", "", 0.5, 0.0001))
    assert text.startswith("the clock of tracking is off by")


def test_two_drivers_in_one_namespace_are_wrong(judge):
    two = replace(IN_ORDER["camera"], drivers=(word("laptop"), word("tracking", "b")))
    [(wrong, text, _)] = judge(camera=two)
    assert wrong
    assert "2 drivers are in /camera" in text
    assert "(process 1 on laptop)" in text
    assert "(process 1 on tracking)" in text


def test_another_version_is_wrong_once_a_machine(judge):
    other = {name: looked(name, "tracking", version="0.9") for name in ("camera", "hand")}
    [(wrong, text, _)] = judge(**other)
    assert wrong
    assert text == "camera, hand on tracking: version 0.9 of crtk-drivers, and 1.0 is here"


@pytest.mark.parametrize(("here", "there"), [("unknown", "1.0"), ("1.0", "unknown"), ("1.0", "")])
def test_a_version_that_is_not_known_is_not_judged(judge, here, there):
    every = {name: looked(name, "tracking", version=there) for name in ("camera", "hand")}
    assert judge(here, arm=looked("arm", "control", version=here), **every) == []


def test_a_clock_is_wrong_only_beyond_doubt(judge):
    [(wrong, text, remedy)] = judge(camera=looked("camera", "tracking", -0.0125, 0.0004))
    assert wrong
    assert "tracking is off by -12.5 ms (± 0.4 ms)" in text
    assert "5 ms" in text
    assert "chrony" in remedy
    assert judge(camera=looked("camera", "tracking", 0.0125, 0.008)) == []


def test_a_clock_is_told_once_a_machine_as_it_is_known_best(judge):
    vague = looked("camera", "tracking", 3600.001, 0.002)
    [(_, text, _)] = judge(camera=vague, hand=looked("hand", "tracking", 3600.0, 0.0001))
    assert "off by +3600.0 s (± 0.1 ms)" in text


def test_a_machine_that_is_not_up_is_a_note(judge):
    [(wrong, text, remedy)] = judge(camera=GONE["camera"], hand=GONE["hand"])
    assert not wrong
    assert text.startswith("nothing of tracking is seen in domain 42: camera, hand.")
    assert "Nothing of DDS on another machine is heard here" in text
    assert "crtk-driver up" in remedy
    assert "7400" in remedy


def test_who_announces_itself_is_told(judge):
    here = Announced(42, "10.0.0.2", "Cyclone DDS")
    [(_, text, _)] = judge(camera=GONE["camera"], announced=(here, Announced(7, "10.0.0.3", "")))
    assert "In this domain 10.0.0.2 (Cyclone DDS) announces itself" in text
    [(_, text, _)] = judge(camera=GONE["camera"], announced=(Announced(7, "10.0.0.3", ""),))
    assert "In other domains: 7: 10.0.0.3." in text


@pytest.mark.parametrize(("domain", "said"), [(7, "is 7"), (0, "is not set, or 0")])
def test_a_device_in_another_domain_is_wrong(judge, domain, said):
    there = {domain: {"camera": looked("camera", "tracking")}}
    [(wrong, text, remedy)] = judge(camera=GONE["camera"], other_domains=there)
    assert wrong
    assert f"but in domain {domain} on tracking: there ROS_DOMAIN_ID {said}" in text
    assert "environment = { ROS_DOMAIN_ID = 42 }" in remedy
