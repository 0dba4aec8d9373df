"""A simulated drive in the hands of a test: frames typed by hand, and a clock that it sets."""

import struct

from crtk_sim_backends.canopen.drive import Drive, DriveConfig
from crtk_sim_backends.canopen.plant import MotorConfig

NODE = 5
COUNTS = 65536
VALID_BIT = 1 << 31

PP, PV, TQ, HM, IP, CSP, CSV, CST = 1, 3, 4, 6, 7, 8, 9, 10

SIZES = {"b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4}


class Aborted(Exception):
    """The drive has refused an SDO; the argument is the abort code."""


class Bench:
    """One drive, alone on its bus. Frames that it sends by itself are kept in `sent`."""

    def __init__(self, *motors, node=NODE, step=0.002, **config):
        motors = motors or (MotorConfig(),)
        self.drive = Drive(node, DriveConfig(motors=motors, **config))
        self.node = node
        self.step = step
        self.now = 1000.0
        self.sent = []
        self.sync_period = None
        self.next_sync = 0.0
        self.run(0.0)

    @property
    def axis(self):
        return self.drive.axes[0]

    # Frames

    def frame(self, identifier, data=b""):
        """Give it a frame (bytes or hexadecimal) and return its answers as (identifier, hex)."""
        data = bytes.fromhex(data) if isinstance(data, str) else data
        frames = self.drive.on_frame(identifier, data, self.now) + self.drive.act(self.now)
        return [(i, d.hex(" ")) for i, d in frames]

    def ask(self, request):
        """One SDO request in hexadecimal; its only answer in hexadecimal."""
        answers = self.frame(0x600 + self.node, request)
        answers = [data for identifier, data in answers if identifier == 0x580 + self.node]
        assert len(answers) == 1, answers
        return answers[0]

    def read(self, index, sub=0, layout="I"):
        answer = bytes.fromhex(self.ask(struct.pack("<BHB4x", 0x40, index, sub)))
        if answer[0] == 0x80:
            raise Aborted(int.from_bytes(answer[4:8], "little"))
        return struct.unpack_from("<" + layout, answer, 4)[0]

    def write(self, index, sub, value, layout="I"):
        data = struct.pack("<" + layout, value)
        head = 0x23 | (4 - len(data)) << 2
        request = struct.pack("<BHB", head, index, sub) + data.ljust(4, b"\0")
        answer = bytes.fromhex(self.ask(request))
        if answer[0] == 0x80:
            raise Aborted(int.from_bytes(answer[4:8], "little"))
        assert answer[0] == 0x60

    def abort_of(self, action, *arguments):
        """The abort code with which an access is refused, 0 when it is not."""
        try:
            action(*arguments)
        except Aborted as refusal:
            return refusal.args[0]
        return 0

    def start(self):
        self.frame(0, bytes((1, self.node)))

    def map(self, base, number, entries, kind, identifier=None):
        """Map a PDO as CiA 301 wants it; `entries` are (index, sub, bits)."""
        parameter, mapping = base + number, base + 0x200 + number
        if identifier is None:
            identifier = (0x180 if base == 0x1800 else 0x200) + 0x100 * number + self.node
        self.write(parameter, 1, VALID_BIT | identifier)
        self.write(mapping, 0, 0, "B")
        for place, (index, sub, bits) in enumerate(entries, 1):
            self.write(mapping, place, index << 16 | sub << 8 | bits)
        self.write(mapping, 0, len(entries), "B")
        self.write(parameter, 2, kind, "B")
        self.write(parameter, 1, identifier)

    # Time

    def run(self, seconds):
        """Let time pass; SYNC comes every `sync_period` when that is set."""
        end = self.now + seconds
        self.sent += self.drive.on_timer(self.now)
        while self.now < end:
            self.now = min(end, self.now + self.step, max(self.now, self.drive.next_timer))
            if self.sync_period and self.now >= self.next_sync:
                self.next_sync = self.now + self.sync_period
                self.sent += self.drive.on_frame(0x80, b"", self.now)
                self.sent += self.drive.act(self.now)
            if self.drive.next_timer <= self.now:
                self.sent += self.drive.on_timer(self.now)

    def until(self, condition, seconds=10.0):
        """Let time pass until a condition holds."""
        end = self.now + seconds
        while not condition():
            assert self.now < end, f"not within {seconds} s; statusword {self.statusword:04X}"
            self.run(self.step)

    def take(self, identifier):
        """Frames with an identifier that it has sent by itself; they are forgotten."""
        found = [data for i, data in self.sent if i == identifier]
        self.sent = [(i, data) for i, data in self.sent if i != identifier]
        return found

    def emergencies(self):
        """Codes of the emergency messages since the last call."""
        return [int.from_bytes(data[:2], "little") for data in self.take(0x80 + self.node)]

    # CiA 402

    @property
    def statusword(self):
        return self.axis.statusword()

    def control(self, word):
        self.write(0x6040, 0, word, "H")

    def mode(self, mode):
        self.write(0x6060, 0, mode, "b")

    def enable(self, mode=None):
        """Bring it to OPERATION ENABLED."""
        if mode is not None:
            self.mode(mode)
        for word in (0x06, 0x07, 0x0F):
            self.control(word)
        assert self.statusword & 0x6F == 0x27, hex(self.statusword)

    def position(self):
        return self.read(0x6064, 0, "i")

    def velocity(self):
        return self.read(0x606C, 0, "i")
