"""Simulated drives in a process of their own: options, the bus, and every fault at run time."""

import struct
import subprocess
import sys
import time
from pathlib import Path

import can
import pytest

from crtk_sim_backends.canopen import SIM, ConfigError, SimConfig, SimStartError
from crtk_sim_backends.canopen.config import drive_configs
from crtk_sim_backends.canopen.drive import Drive, DriveConfig, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.injection import ERRORS, KINDS
from crtk_sim_backends.control import ControlError
from rigs.waiting import LONG, eventually

pytestmark = pytest.mark.usefixtures("cold_start")


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(nodes=2, axes=2, terminals=0) as running:
        yield running


class Master:
    """A raw bus, with the few requests that the tests make."""

    def __init__(self, bus):
        self.bus = bus

    def send(self, identifier, data=b""):
        data = bytes.fromhex(data) if isinstance(data, str) else data
        self.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def wait(self, identifier, seconds=LONG):
        """Data of the next frame with an identifier, None when it does not come."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0:
            message = self.bus.recv(left)
            if message is not None and message.arbitration_id == identifier:
                return bytes(message.data)
        return None

    def sdo(self, node, request, seconds=LONG):
        self.send(0x600 + node, request)
        answer = self.wait(0x580 + node, seconds)
        return None if answer is None else answer.hex(" ")


@pytest.fixture
def master(sim):
    bus = can.Bus(interface="crtk", channel=sim.paths["crtk"])
    for node in (1, 2):
        bus.send(can.Message(arbitration_id=0, data=(0x81, node), is_extended_id=False))
    raw = Master(bus)
    for node in (1, 2):
        eventually(lambda node=node: raw.sdo(node, "4000100000000000", 0.1) is not None)
        raw.send(0x600 + node, "4018100400000000")
        eventually(
            lambda node=node: raw.wait(0x580 + node)[:4] == bytes.fromhex("43181004")
        )  # the last one
    yield raw
    sim.control.clear()
    bus.shutdown()


def axis(sim, node, number=0):
    return sim.control.status()["drives"][str(node)]["axes"][number]


def enable(master, node):
    for word in ("06", "07", "0f"):
        assert master.sdo(node, f"2b406000{word}000000").startswith("60")


def test_sync_is_acted_on_without_another_frame(sim, master):
    """The samples leave first, and nothing comes after this SYNC that would wake the drive."""
    assert master.sdo(1, "2f00140201000000") == "60 00 14 02 00 00 00 00"  # RPDO 1 with SYNC
    assert master.sdo(1, "2f00180201000000") == "60 00 18 02 00 00 00 00"  # TPDO 1 too
    master.send(0, "01 01")
    master.send(0x201, "06 00")
    master.send(0x80)
    assert master.wait(0x181) == b"\x50\x02"
    eventually(lambda: axis(sim, 1)["controlword"] == 6)
    assert axis(sim, 1)["statusword"] == 0x231


def test_both_drives_answer(master):
    for node in (1, 2):
        assert master.sdo(node, "4018100400000000") == f"43 18 10 04 {node:02x} 00 00 00"


@pytest.mark.parametrize("name", ["over_current", "following_error", "heartbeat", "vendor"])
def test_fault_of_each_class(sim, master, name):
    sim.control.inject("fault", node=1, axis=1, error=name, vendor="0102")
    code = struct.unpack_from("<H", master.wait(0x81))[0]
    assert code == ERRORS[name]
    assert axis(sim, 1, 1)["state"] == "fault"
    assert axis(sim, 1, 0)["state"] == "switch_on_disabled"
    assert axis(sim, 2, 1)["error"] == 0
    master.sdo(1, "2b40680080000000")
    assert axis(sim, 1, 1)["state"] == "switch_on_disabled"


def test_lasting_fault_cannot_be_reset_until_it_ends(sim, master):
    sim.control.inject("lasting_fault", node=1, error="drive_temperature")
    master.sdo(1, "2b40600080000000")
    assert axis(sim, 1)["state"] == "fault"
    sim.control.clear("lasting_fault")
    master.sdo(1, "2b40600000000000")
    master.sdo(1, "2b40600080000000")
    assert axis(sim, 1)["state"] == "switch_on_disabled"


def test_emcy_without_a_fault(sim, master):
    sim.control.inject("emcy", node=2, code=0x5530, vendor="aabbccddee")
    assert master.wait(0x82).hex(" ") == "30 55 01 aa bb cc dd ee"
    assert axis(sim, 2)["state"] == "switch_on_disabled"


def test_reset_by_itself(sim, master):
    enable(master, 1)
    sim.control.inject("reset", node=1)
    assert master.wait(0x701) == b"\0"
    assert axis(sim, 1)["state"] == "switch_on_disabled"


def test_silence(sim, master):
    sim.control.inject("silent", node=1)
    assert master.sdo(1, "4000100000000000", 0.1) is None
    assert master.sdo(2, "4000100000000000").startswith("43")
    sim.control.clear("silent")
    assert master.sdo(1, "4000100000000000").startswith("43")


def test_power_of_the_electronics(sim, master):
    sim.control.inject("power_off", node=1)
    assert master.sdo(1, "4000100000000000", 0.1) is None
    sim.control.clear("power_off")
    assert master.wait(0x701) == b"\0"


@pytest.mark.parametrize(("kind", "code"), [("supply_off", 0x3220), ("safe_torque_off", 0xFF01)])
def test_supply_and_safe_torque_off(sim, master, kind, code):
    enable(master, 1)
    sim.control.inject(kind, node=1)
    assert struct.unpack_from("<H", master.wait(0x81))[0] == code
    assert axis(sim, 1)["state"] == "fault"
    assert master.sdo(1, "4000100000000000").startswith("43")


def test_stuck_motor(sim, master):
    master.sdo(1, "2f60600001000000")
    enable(master, 1)
    sim.control.inject("stuck", node=1)
    master.sdo(1, "237a600000000a00")
    master.sdo(1, "2b4060001f000000")
    assert struct.unpack_from("<H", master.wait(0x81))[0] == 0x8611


def test_local_control(sim, master):
    sim.control.inject("local_control", node=1)
    assert master.sdo(1, "2b40600006000000") == "80 40 60 00 21 00 00 08"


def test_sdo_without_answer_and_late(sim, master):
    sim.control.inject("no_sdo", node=1)
    assert master.sdo(1, "4000100000000000", 0.1) is None
    sim.control.clear("no_sdo")
    sim.control.inject("slow_sdo", node=1, delay=0.15)
    start = time.monotonic()
    assert master.sdo(1, "4000100000000000").startswith("43")
    assert time.monotonic() - start >= 0.15


def test_sdo_abort(sim, master):
    sim.control.inject("sdo_abort", node=1, index=0x6064, code=0x06060000)
    assert master.sdo(1, "4064600000000000") == "80 64 60 00 00 00 06 06"
    assert master.sdo(1, "4041600000000000").startswith("4b")


def test_an_object_that_is_claimed_to_be_something_else(sim, master):
    sim.control.inject("claim", node=1, index=0x6041, data="ffee")
    assert master.sdo(1, "4041600000000000") == "4b 41 60 00 ff ee 00 00"
    master.send(0, "0101")
    assert master.wait(0x181) == b"\xff\xee"  # TPDO 1 as it is mapped after a reset
    sim.control.clear("claim")
    assert master.wait(0x181) == b"\x50\x02"


@pytest.mark.parametrize("index", [0x1017, 0x1016, 0x6007])
def test_ignored_writes(sim, master, index):
    sim.control.inject("ignored_writes", node=1, index=index)
    at = struct.pack("<H", index).hex() + ("01" if index == 0x1016 else "00")
    size = {0x1016: "23", 0x1017: "2b", 0x6007: "2b"}[index]
    assert master.sdo(1, f"{size}{at}01000000").startswith("60")
    assert master.sdo(1, f"40{at}00000000")[12:] == "00 00 00 00"


def test_heartbeats_that_stop(sim, master):
    master.sdo(1, "2b1710000a000000")
    assert master.wait(0x701) == b"\x7f"
    sim.control.inject("no_heartbeat", node=1)
    assert master.sdo(1, "4000100000000000") is not None  # which comes after those under way
    assert master.wait(0x701, 0.1) is None


def test_tpdos_that_are_late_or_stay_away(sim, master):
    master.send(0, b"\x01\x01")
    assert master.wait(0x181) == b"\x50\x02"
    sim.control.inject("late_tpdo", node=1, delay=0.1)
    start = time.monotonic()
    master.send(0x201, b"\x06\x00")
    assert master.wait(0x181) == b"\x31\x02"
    assert time.monotonic() - start >= 0.1
    sim.control.clear("late_tpdo")
    sim.control.inject("no_tpdo", node=1)
    master.send(0x201, b"\x00\x00")
    assert master.wait(0x181, 0.1) is None


def test_block_upload_does_not_delay_process_data():
    with SIM.spawn(nodes=1, terminals=0, bitrate=20_000) as sim:
        bus = can.Bus(interface="crtk", channel=sim.paths["crtk"])
        try:
            master = Master(bus)
            assert master.sdo(1, "2b0018050a000000").startswith("60")  # a TPDO every 10 ms
            master.send(0, b"\x01\x01")
            master.wait(0x181)
            assert master.sdo(1, "a02110007f000000").startswith("c2")
            master.send(0x601, "a300000000000000")  # 127 segments of 6 ms each
            segments = between = 0
            while segments < 127:
                identifier = bus.recv(LONG).arbitration_id
                segments += identifier == 0x581
                between += identifier == 0x181
            assert between >= 3
        finally:
            bus.shutdown()


def test_wrong_identity(sim, master):
    sim.control.inject("wrong_identity", node=1, serial=99, product=0x1234)
    assert master.sdo(1, "4018100200000000") == "43 18 10 02 34 12 00 00"
    assert master.sdo(1, "4018100400000000") == "43 18 10 04 63 00 00 00"
    assert master.sdo(1, "4018100100000000") == "43 18 10 01 01 1f 00 00"
    sim.control.clear("wrong_identity")
    assert master.sdo(1, "4018100400000000") == "43 18 10 04 01 00 00 00"


def test_bus_off_stops_the_drive_as_6007_says(sim, master):
    master.sdo(1, "2b07600002000000")
    enable(master, 1)
    sim.control.inject("bus_off", node="drive-1")
    eventually(lambda: axis(sim, 1)["state"] == "switch_on_disabled")
    assert master.sdo(1, "4000100000000000", 0.1) is None
    sim.control.clear("bus_off")
    assert struct.unpack_from("<H", master.wait(0x81))[0] == 0x8140


def test_error_passive_is_reported(sim, master):
    sim.control.inject("error_passive", node="drive-2")
    assert struct.unpack_from("<H", master.wait(0x82))[0] == 0x8120
    sim.control.clear("error_passive")
    assert master.wait(0x82) == bytes(8)


def test_every_kind_of_fault_is_tested_here():
    text = Path(__file__).read_text()
    assert [kind for kind in KINDS if f'"{kind}"' not in text] == []


@pytest.mark.parametrize(
    ("kind", "parameters", "message"),
    [
        ("stuk", {}, "did you mean 'stuck'"),
        ("stuck", {"node": 9}, "node-ID 9"),
        ("stuck", {"axis": 5}, "has 2 axes"),
        ("fault", {"error": "over_curent"}, "did you mean 'over_current'"),
        ("fault", {"vendor": "xyz"}, "hexadecimal"),
        ("sdo_abort", {"node": 1}, "index"),
        ("claim", {"node": 1, "index": 0x6041, "data": "x"}, "data must be bytes in hexadecimal"),
    ],
)
def test_wrong_faults_are_refused(sim, kind, parameters, message):
    with pytest.raises(ControlError, match=message):
        sim.control.inject(kind, **parameters)


def test_objects_can_be_read_and_written_past_the_bus(sim, master):
    assert sim.control.call("object", node=1, index=0x1018, sub=1) == 0x1F01
    sim.control.call("object", node=1, index=0x6065, value=5)
    assert master.sdo(1, "4065600000000000") == "43 65 60 00 05 00 00 00"
    with pytest.raises(ControlError, match="06020000"):
        sim.control.call("object", node=1, index=0x5000)
    assert sim.control.call("eds", node=2).count("ParameterName=Controlword") == 2


def test_faults_of_a_file_wait_for_events(tmp_path):
    file = tmp_path / "faults.yaml"
    file.write_text(
        "- {when: enabled, after: 0.05, kind: fault, node: 3, error: over_current}\n"
        "- {at: 0.0, kind: no_heartbeat, node: 3}\n"
    )
    with SIM.spawn(nodes=1, first_node=3, terminals=0, faults=str(file)) as sim:
        bus = can.Bus(interface="crtk", channel=sim.paths["crtk"])
        try:
            master = Master(bus)
            enable(master, 3)
            assert struct.unpack_from("<H", master.wait(0x83))[0] == 0x2310
        finally:
            bus.shutdown()


def test_drives_of_a_file(tmp_path):
    file = tmp_path / "drives.yaml"
    file.write_text(
        "2: {personality: plain, serial: 77, motors: [{start: 1.5}, {pendulum: 0.2, gear: 100}]}\n"
        "9: {}\n"
    )
    configs = drive_configs(SimConfig(nodes=2, drives=str(file)))
    assert list(configs) == [1, 2, 9]
    assert configs[2].personality.name == "plain"
    assert configs[2].serial == 77
    assert [motor.start for motor in configs[2].motors] == [1.5, 0.0]
    assert configs[1] == configs[9]


def test_drives_with_some_of_the_modes_and_more_pdos(tmp_path):
    file = tmp_path / "drives.yaml"
    file.write_text("2: {modes: [pp, hm]}\n")
    configs = drive_configs(SimConfig(nodes=2, drives=str(file), modes="PV, tq", pdos=6))
    assert configs[1].modes == {3, 4}
    assert configs[2].modes == {1, 6}
    drive = Drive(1, configs[1])
    assert drive.dictionary[0x6502, 0] == 0b1100
    for index, direction in ((0x1405, "R"), (0x1805, "T")):
        assert drive.dictionary[index, 1] & 0x8000_07FF == 0x8000_0000
        assert f"NrOf{direction}XPDO=6" in eds_of(configs[1])
    assert (0x1406, 1) not in drive.dictionary.variables


def test_a_mode_that_the_drive_does_not_have_is_refused():
    drive = Drive(1, DriveConfig(modes=frozenset({1})))
    drive.on_timer(0.0)
    for mode, answer in ((8, "80 60 60 00 30 00 09 06"), (1, "60 60 60 00 00 00 00 00")):
        request = bytes((0x2F, 0x60, 0x60, 0, mode, 0, 0, 0))
        frames = drive.on_frame(0x601, request, 0.01)
        assert [data.hex(" ") for identifier, data in frames if identifier == 0x581] == [answer]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1, 2]", "mapping of node-IDs"),
        ("200: {}", "node 200"),
        ("1: {personality: plane}", "did you mean 'plain'"),
        ("1: {motor: []}", "did you mean 'motors'"),
        ("1: {motors: []}", "list of 1 to 8"),
        ("1: {motors: [{inertia: 0}]}", "inertia must lie in"),
        ("1: {motors: [{inerta: 1}]}", "did you mean 'inertia'"),
        ("1: {motors: [{home: [1]}]}", "list of 2"),
        ("1: {serial: -1}", "serial"),
        ("1: {modes: pp}", "modes must be a list"),
        ("1: {modes: [ppp]}", "did you mean 'pp'"),
        ("1: [", "cannot read"),
    ],
)
def test_wrong_files_of_drives_are_refused(tmp_path, text, message):
    file = tmp_path / "drives.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=message):
        drive_configs(SimConfig(drives=str(file)))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"nodes": 128}, "beyond 127"),
        ({"first_node": 0}, "first_node"),
        ({"axes": 9}, "axes"),
        ({"modes": "pp,csb"}, "did you mean 'csv'|did you mean 'cst'|did you mean 'csp'"),
        ({"pdos": 17}, "pdos"),
        ({"personality": "standart"}, "did you mean 'standard'"),
        ({"drives": "/nowhere.yaml"}, "no file"),
        ({"noodes": 3}, "did you mean 'nodes'"),
        ({"bitrate": 5}, "bitrate"),
    ],
)
def test_wrong_options_are_refused(options, message):
    with pytest.raises(ConfigError, match=message):
        SimConfig().replace(**options)


def test_wrong_file_ends_the_process_with_the_reason(tmp_path):
    file = tmp_path / "drives.yaml"
    file.write_text("1: {personality: plane}")
    with pytest.raises(SimStartError, match="did you mean 'plain'"):
        SIM.spawn(drives=str(file))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- {at: 1, kind: stuck, node: 99}", "no drive with node-ID 99"),
        ("- {at: 1, kind: stuck, axis: 1}", "1 axes"),
        ("- {when: enabeld, kind: stuck}", "did you mean 'enabled'"),
    ],
)
def test_wrong_file_of_faults_ends_the_process_with_the_reason(tmp_path, text, message):
    file = tmp_path / "faults.yaml"
    file.write_text(text)
    with pytest.raises(SimStartError, match=message):
        SIM.spawn(faults=str(file))


def test_module_runs_alone_and_tells_how_to_connect(tmp_path):
    eds = tmp_path / "here.eds"
    arguments = ["--nodes=1", "--terminals=0", f"--eds={eds}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "crtk_sim_backends.canopen", *arguments],
        stdout=subprocess.PIPE,
        text=True,
    )
    lines = [process.stdout.readline() for _ in range(4)]
    process.terminate()
    process.communicate(timeout=LONG)
    assert process.returncode == 0
    assert "1 simulated CANopen drives" in lines[0]
    assert any("interface='crtk'" in line for line in lines)
    assert eds.read_text() == PUBLISHED.read_text()
