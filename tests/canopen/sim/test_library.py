"""The unmodified canopen library as master of simulated drives, over python-can's virtual bus."""

import struct
import threading
import time
import uuid

import can
import canopen
import pytest
from canopen.sdo import SdoAbortedError

from crtk_sim_backends.canopen.drive import Drive, DriveConfig, eds_of
from crtk_sim_backends.canopen.eds import PUBLISHED
from crtk_sim_backends.canopen.plant import MotorConfig
from rigs.waiting import LONG, eventually

NODE = 3


class Adapter:
    """A thread between a drive and a bus of python-can."""

    def __init__(self, drive, channel):
        self.drive = drive
        self.lock = threading.Lock()
        self._bus = can.Bus(interface="virtual", channel=channel)
        self._ends = False
        self._thread = threading.Thread(target=self._run)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._ends = True
        self._thread.join()
        self._bus.shutdown()

    def _run(self):
        while not self._ends:
            wait = min(0.005, max(0.0, self.drive.next_timer - time.monotonic()))
            message = self._bus.recv(wait)
            with self.lock:
                now = time.monotonic()
                frames = []
                if message is not None:
                    frames += self.drive.on_frame(message.arbitration_id, bytes(message.data), now)
                if self.drive.next_timer <= now:
                    frames += self.drive.on_timer(now)
            for identifier, data in frames:
                self._bus.send(
                    can.Message(arbitration_id=identifier, data=data, is_extended_id=False)
                )


@pytest.fixture
def network():
    channel = str(uuid.uuid4())
    net = canopen.Network()
    net.NOTIFIER_CYCLE = 0.02  # s that it takes to end
    net.connect(interface="virtual", channel=channel)
    net.channel = channel
    yield net
    net.disconnect()


@pytest.fixture
def adapter(network):
    with Adapter(Drive(NODE), network.channel) as running:
        yield running


@pytest.fixture
def node(network, adapter):
    remote = network.add_node(NODE, str(PUBLISHED))
    remote.sdo.RESPONSE_TIMEOUT = LONG
    remote.nmt.state = "PRE-OPERATIONAL"
    return remote


def test_expedited_by_name(node):
    node.sdo["Producer heartbeat time"].raw = 0
    node.sdo["Home offset"].raw = -123456
    assert node.sdo["Home offset"].raw == -123456
    assert node.sdo["Identity object"]["Vendor-ID"].raw == 0x1F01
    assert node.sdo[0x6502].raw == 0b11_1110_1101


def test_segmented(node):
    assert node.sdo[0x1008].raw == "CRTK simulated drive"
    data = bytes(range(256)) * 4
    node.sdo[0x2000].raw = data
    assert node.sdo[0x2000].raw == data


@pytest.mark.parametrize("crc", [True, False])
@pytest.mark.parametrize("size", [1, 8, 889, 1500])
def test_block(node, size, crc):
    data = bytes(n * 31 & 0xFF for n in range(size))
    with node.sdo[0x2000].open(
        "wb", size=size, block_transfer=True, request_crc_support=crc
    ) as file:
        file.write(data)
    with node.sdo[0x2000].open("rb", block_transfer=True, request_crc_support=crc) as file:
        assert file.read() == data


def test_eds_is_read_from_the_node(node):
    with node.sdo[0x1021].open("r", encoding="ascii", block_transfer=True) as file:
        assert file.read() == PUBLISHED.read_text()


@pytest.mark.parametrize(
    ("index", "sub", "data", "code"),
    [
        (0x6041, 0, b"\0\0", 0x06010002),
        (0x6060, 0, b"\x02", 0x06090030),
        (0x5000, 0, b"\0", 0x06020000),
        (0x1018, 7, b"\0", 0x06090011),
        (0x6065, 0, b"\0", 0x06070013),
    ],
)
def test_aborts(node, index, sub, data, code):
    with pytest.raises(SdoAbortedError) as aborted:
        node.sdo.download(index, sub, data)
    assert aborted.value.code == code


def test_network_management_and_heartbeat(node):
    node.sdo[0x1017].raw = 20
    for state in ("OPERATIONAL", "STOPPED", "PRE-OPERATIONAL"):
        node.nmt.state = state
        eventually(lambda state=state: node.nmt.wait_for_heartbeat(LONG) == state)


def test_reset_boots(node):
    states: list[int] = []
    node.nmt.add_heartbeat_callback(states.append)
    node.nmt.state = "RESET"
    eventually(lambda: 0 in states)
    eventually(lambda: node.nmt.state in ("PRE-OPERATIONAL", "INITIALISING"))
    assert node.sdo[0x1017].raw == 0


def test_emergency(node, adapter):
    with adapter.lock:
        adapter.drive.axes[0].fault(0x2310, b"\1\2\3\4\5")
        adapter.drive.next_timer = 0.0
    eventually(lambda: node.emcy.log)
    (emergency,) = node.emcy.log
    assert emergency.code == 0x2310
    assert (emergency.register, emergency.data) == (3, b"\1\2\3\4\5")
    assert node.sdo[0x1003][1].raw == 0x02012310
    node.sdo[0x6040].raw = 0x80
    eventually(lambda: len(node.emcy.active) == 0)


def configure(node, kind=1):
    """Two PDOs as a driver has them: controlword and target, statusword and position."""
    node.rpdo.read()
    node.tpdo.read()
    for pdo, names in (
        (node.rpdo[1], ("Controlword", "Modes of operation", "Target position")),
        (node.tpdo[1], ("Statusword", "Position actual value")),
    ):
        pdo.clear()
        for name in names:
            pdo.add_variable(name)
        pdo.trans_type = kind
        pdo.enabled = True
        pdo.save()


def test_pdo_configuration_is_written_and_read_back(node):
    configure(node)
    node.tpdo.read()
    node.rpdo.read()
    assert [v.name for v in node.tpdo[1]] == ["Statusword", "Position actual value"]
    assert [v.name for v in node.rpdo[1]] == [
        "Controlword",
        "Modes of operation",
        "Target position",
    ]
    assert node.tpdo[1].trans_type == node.rpdo[1].trans_type == 1
    assert node.tpdo[1].cob_id == 0x180 + NODE


def test_drive_turns_with_synchronous_pdos(node, network):
    configure(node)
    node.sdo[0x60C2][1].raw = 10
    node.nmt.state = "OPERATIONAL"
    received = threading.Event()
    node.tpdo[1].add_callback(lambda _: received.set())

    def cycle(word, target):
        received.clear()
        node.rpdo[1]["Controlword"].raw = word
        node.rpdo[1]["Modes of operation"].raw = 8
        node.rpdo[1]["Target position"].raw = target
        node.rpdo[1].transmit()
        network.sync.transmit()
        assert received.wait(LONG)
        return struct.unpack("<Hi", bytes(node.tpdo[1].data))

    position = cycle(0, 0)[1]
    for controlword, mask, value in ((6, 0x6F, 0x21), (7, 0x6F, 0x23), (15, 0x6F, 0x27)):
        cycle(controlword, position)
        eventually(lambda c=controlword, m=mask, v=value: cycle(c, position)[0] & m == v)
    for target in range(0, 20_000, 100):
        cycle(15, target)
        time.sleep(0.002)
    eventually(lambda: abs(cycle(15, 20_000)[1] - 20_000) < 50)
    assert cycle(15, 20_000)[0] & 0x106F == 0x1027


def test_drive_of_several_axes_by_its_eds(network, tmp_path):
    config = DriveConfig(motors=(MotorConfig(), MotorConfig(start=1.0)))
    sheet = tmp_path / "two.eds"
    sheet.write_text(eds_of(config))
    with Adapter(Drive(9, config), network.channel):
        node = network.add_node(9, str(sheet))
        assert node.sdo[0x6064].raw == 0
        assert node.sdo[0x6864].raw == 65536
        assert node.sdo[0x6864].od.name == "Position actual value"
