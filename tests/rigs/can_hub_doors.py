"""What the tests of the CAN hub share: buses at each of its doors, and waiting without sleeping."""

import can

from rigs.waiting import LONG, eventually

DOORS = ("crtk", "socketcand", "slcan")
NODES = {"crtk": "native", "socketcand": "socketcand", "slcan": "slcan"}


def listening(sim, door):
    """How many clients of a door have opened their channel."""
    nodes = sim.control.status()["nodes"]
    return sum(nodes[name]["listening"] for name in nodes if name.startswith(NODES[door]))


def open_bus(sim, door, **options):
    """Open a python-can bus at a door of the simulator `sim`."""
    where = {
        "crtk": {"channel": sim.paths["crtk"]},
        "socketcand": {"host": sim.host, "port": sim.ports["socketcand"], "channel": "can0"},
        "slcan": {"channel": _terminal(sim), "bitrate": 1_000_000, "sleep_after_open": 0},
    }
    before = listening(sim, door)
    bus = can.Bus(interface=door, **where[door], **options)
    eventually(lambda: listening(sim, door) > before)
    return bus


def _terminal(sim):
    """The first slcan terminal that nobody uses."""
    nodes = sim.control.status()["nodes"]
    return next((tty for name, tty in sim.ttys.items() if not nodes[name]["listening"]), None)


def frame(can_id=0x123, data=b"\x01\x02", **options):
    """Build a message, extended when its identifier needs it."""
    options.setdefault("is_extended_id", can_id > 0x7FF)
    return can.Message(arbitration_id=can_id, data=data, **options)


def receive(bus, count=1):
    """The next `count` messages."""
    messages = [bus.recv(LONG) for _ in range(count)]
    assert None not in messages, messages
    return messages


def ids(messages):
    """Their identifiers."""
    return [message.arbitration_id for message in messages]


def drain(bus, marker=0x7EF):
    """Messages before the one that the caller has sent last, which has the identifier `marker`."""
    messages = []
    while (message := receive(bus)[0]).arbitration_id != marker:
        messages.append(message)
    return messages
