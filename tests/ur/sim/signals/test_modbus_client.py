"""URScript's Modbus client: programs of the simulated controller against a unit written by hand."""

import contextlib
import socket
import struct
import threading

import pytest

from crtk_sim_backends.ur import SIM
from rigs.ur_clients import PrimaryClient, TcpClient
from rigs.waiting import LONG, eventually

READS, WRITES = (1, 2, 3, 4), (5, 6, 15, 16, 23)
COUNTER = "output_int_register_9"


class Unit:
    """A Modbus TCP unit with the same 200 addresses for everything, that tells what it was asked."""

    def __init__(self, host="127.0.0.1", port=0):
        self._listener = socket.create_server((host, port))
        self.port = self._listener.getsockname()[1]
        self.words = [0] * 200
        self.requests = []  # (unit, function, data)
        self.exception = 0
        self.mute = False
        self._peers = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        with contextlib.suppress(OSError):
            while True:
                peer, _ = self._listener.accept()
                self._peers.append(peer)
                threading.Thread(target=self._serve, args=(peer,), daemon=True).start()

    def _serve(self, peer):
        with contextlib.suppress(OSError), peer, peer.makefile("rb") as stream:
            while head := stream.read(8):
                number, _, size, unit, function = struct.unpack(">HHHBB", head)
                data = stream.read(size - 2)
                self.requests.append((unit, function, data))
                if self.mute:
                    continue
                body = self._answer(function, data)
                peer.sendall(struct.pack(">HHHB", number, 0, len(body) + 1, unit) + body)

    def _answer(self, function, data):
        if self.exception:
            return bytes([function | 0x80, self.exception])
        if function not in READS + WRITES:
            return bytes([function | 0x80, 1])
        first, count = struct.unpack_from(">HH", data)
        if function in (1, 2):
            bits = sum(bool(x) << i for i, x in enumerate(self.words[first : first + count]))
            content = bits.to_bytes((count + 7) // 8, "little")
            return bytes([function, len(content)]) + content
        if function in (3, 4):
            words = self.words[first : first + count]
            return bytes([function, 2 * count]) + struct.pack(f">{count}H", *words)
        if function == 23:
            into, number = struct.unpack_from(">HH", data, 4)
            self.words[into : into + number] = struct.unpack_from(f">{number}H", data, 9)
            return self._answer(3, data[:4]).replace(b"\x03", b"\x17", 1)
        if function == 6:
            self.words[first] = count
        elif function == 15:
            for i in range(count):
                self.words[first + i] = data[5 + i // 8] >> i % 8 & 1
        else:
            self.words[first : first + count] = struct.unpack_from(f">{count}H", data, 5)
        return bytes([function]) + data[:4]

    def asked(self, function):
        return any(request[1] == function for request in self.requests)

    def close(self):
        for sock in (self._listener, *self._peers):
            with contextlib.suppress(OSError):
                sock.shutdown(socket.SHUT_RDWR)
            sock.close()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(modbus=True, modbus_port=0) as running:
        yield running


@pytest.fixture
def unit():
    with Unit() as running:
        yield running


def output(sim, name):
    return sim.control.outputs(name)[name]


def run(sim, body):
    """Run a secondary program to its end."""
    before = output(sim, COUNTER)
    with TcpClient(sim.host, "secondary", LONG) as port:
        port.send(
            f"sec modbus():\n{body}\nwrite_output_integer_register(9, {before + 1})\nend\n".encode()
        )
        eventually(lambda: output(sim, COUNTER) == before + 1)


def add(unit, name, kind, address=5, count=1):
    where = f"127.0.0.1:{unit.port}"
    return f'modbus_add_signal("{where}", 7, {address}, {kind}, "{name}", False, {count})\n'


def test_register_inputs_are_read_all_the_time(sim, unit):
    unit.words[5:8] = [65535, 2, 3]
    read = "write_output_integer_register({}, modbus_get_signal_status({!r}, False))\n"
    listed = 'a = modbus_get_signal_status("three")\nwrite_output_integer_register(1, a[2])\n'
    run(
        sim,
        add(unit, "one", 2)
        + add(unit, "three", 2, count=3)
        + (read.format(0, "one") + listed).replace("'", '"'),
    )
    assert (output(sim, "output_int_register_0"), output(sim, "output_int_register_1")) == (
        65535,
        3,
    )
    assert unit.requests[0] == (7, 4, struct.pack(">HH", 5, 1))
    unit.words[5] = 77
    seen = len(unit.requests)
    eventually(lambda: len(unit.requests) > seen + 4)
    run(sim, read.format(0, "one").replace("'", '"'))
    assert output(sim, "output_int_register_0") == 77


def test_digital_inputs_are_booleans(sim, unit):
    unit.words[5] = 1
    run(
        sim,
        add(unit, "switch", 0)
        + 'write_output_boolean_register(3, modbus_get_signal_status("switch") == True)\n',
    )
    assert output(sim, "output_bit_registers0_to_31") >> 3 & 1
    assert unit.asked(2)


@pytest.mark.parametrize(
    ("kind", "function", "setting", "words"),
    [
        (1, 15, 'modbus_set_output_signal("out", True, False)', [1]),
        (3, 6, 'modbus_set_output_register("out", 300, False)', [300]),
        (16, 16, 'modbus_set_output_register("out", 301)', [301]),
        (15, 15, 'modbus_set_output_signal("out", True)', [1]),
    ],
)
def test_outputs_are_read_until_they_are_set(sim, unit, kind, function, setting, words):
    run(sim, add(unit, "out", kind) + 'x = modbus_get_signal_status("out")')
    assert not any(unit.asked(write) for write in WRITES)
    run(sim, setting)
    eventually(lambda: unit.words[5:6] == words)
    assert unit.asked(function)


def test_a_short_list_leaves_the_other_registers(sim, unit):
    unit.words[10:13] = [1, 2, 3]
    run(
        sim,
        add(unit, "list", 16, address=10, count=3)
        + 'x = modbus_get_signal_status("list")\n'
        + 'modbus_set_output_register("list", [8, 9])',
    )
    eventually(lambda: unit.words[10:13] == [8, 9, 3])


def test_a_signal_that_reads_and_writes(sim, unit):
    unit.words[5:8] = [1, 2, 3]
    where = f'"127.0.0.1:{unit.port}", 7'
    tell = "write_output_integer_register({}, a[{}])\n"
    read = 'a = modbus_get_signal_status("both")\n' + "".join(tell.format(i, i) for i in range(3))
    run(sim, f'modbus_add_rw_signal({where}, 5, 3, 7, 2, "both")\n' + read)
    assert [output(sim, f"output_int_register_{i}") for i in range(3)] == [1, 2, 3]
    assert {function for _, function, _ in unit.requests} == {3}
    run(sim, 'modbus_set_output_register("both", [30])')
    eventually(lambda: unit.words[5:9] == [1, 2, 30, 0])  # the ranges overlap
    run(sim, 'modbus_set_output_register("both", [31, 32])')
    eventually(lambda: unit.words[7:9] == [31, 32])
    run(sim, f"{read}while a[2] != 31:\n  sync()\n  {read}end")
    assert unit.requests[-1] == (7, 23, struct.pack(">HHHHBHH", 5, 3, 7, 2, 4, 31, 32))


def test_a_signal_without_frequency_is_read_on_demand(sim, unit):
    run(
        sim,
        add(unit, "demand", 2)
        + 'modbus_set_signal_update_frequency("demand", 0)\n'
        + 'x = modbus_get_signal_status("demand")',
    )
    asked = len(unit.requests)
    unit.words[5] = 9
    run(sim, 'write_output_integer_register(0, modbus_get_signal_status("demand"))')
    assert output(sim, "output_int_register_0") == 9
    assert len(unit.requests) == asked + 1


def test_a_deleted_signal_is_asked_for_no_more(sim, unit):
    run(sim, add(unit, "gone", 2) + 'x = modbus_get_signal_status("gone")')
    run(sim, 'modbus_delete_signal("gone")\nmodbus_delete_signal("gone")')
    with Unit() as other:
        run(sim, add(other, "here", 2) + 'x = modbus_get_signal_status("here")')
        asked = len(unit.requests)
        seen = len(other.requests)
        eventually(lambda: len(other.requests) > seen + 3)
        assert len(unit.requests) <= asked + 1  # one may have been under way


def test_a_custom_command_goes_out_as_it_is(sim, unit):
    run(sim, f'modbus_send_custom_command("127.0.0.1:{unit.port}", 103, 6, [0, 32, 2, 88])')
    eventually(lambda: unit.words[32] == 600)
    assert unit.requests == [(103, 6, bytes([0, 32, 2, 88]))]


def test_errors_of_device_and_connection_are_reported(sim, unit):
    def error(source=0):
        run(sim, f'write_output_integer_register(0, modbus_get_error("sick", {source}))')
        return output(sim, "output_int_register_0")

    run(sim, add(unit, "sick", 2) + 'x = modbus_get_signal_status("sick")')
    assert error() == 0
    unit.exception = 4
    eventually(lambda: error() == 4)
    run(sim, 'write_output_float_register(0, modbus_get_time_since_signal_invalid("sick"))')
    assert output(sim, "output_double_register_0") > 0.0
    unit.exception, unit.mute = 0, True
    eventually(lambda: error(2) == 110)  # ETIMEDOUT
    unit.close()
    eventually(lambda: error() == -2 << 16)
    with Unit(port=unit.port):
        eventually(lambda: error() == 0)


def test_a_signal_that_stays_invalid_ends_the_program(sim, unit):
    unit.exception = 2
    with (
        PrimaryClient(sim.host, timeout=LONG) as primary,
        TcpClient(sim.host, "secondary", LONG) as port,
    ):
        text = add(unit, "wrong", 2) + 'modbus_set_signal_watchdog("wrong", 0.3)\n'
        text += 'x = modbus_get_signal_status("wrong")\n'
        port.send(f"sec waits():\n{text}end\n".encode())
        assert b"no valid answer for wrong in 0.3 s (device error 2" in primary.message(7, LONG)


def test_the_last_value_holds_until_the_watchdog(sim, unit):
    unit.words[5] = 5
    run(
        sim,
        add(unit, "held", 2)
        + 'modbus_set_signal_watchdog("held", 300)\nx = modbus_get_signal_status("held")',
    )
    unit.exception = 4
    seen = len(unit.requests)
    eventually(lambda: len(unit.requests) > seen + 2)
    run(sim, 'write_output_integer_register(0, modbus_get_signal_status("held"))')
    assert output(sim, "output_int_register_0") == 5


def test_a_connection_can_be_reset(sim, unit):
    run(sim, add(unit, "reset", 2) + 'x = modbus_get_signal_status("reset")')
    assert len(unit._peers) == 1
    run(sim, f'modbus_reset_connection("127.0.0.1:{unit.port}")')
    eventually(lambda: len(unit._peers) == 2)


def test_an_output_follows_the_program(sim, unit):
    run(
        sim,
        add(unit, "lamp", 1)
        + 'x = modbus_get_signal_status("lamp")\nmodbus_set_runstate_dependent_choice("lamp", 3)',
    )
    with TcpClient(sim.host, "primary", LONG) as port:
        port.send(b"def runs():\n  while True:\n    sync()\n  end\nend\n")
        eventually(lambda: unit.words[5] == 1)
        port.send(b"stop program\n")
        eventually(lambda: unit.words[5] == 0)


def test_a_digital_input_switches_freedrive_on(sim, unit):
    run(sim, add(unit, "pedal", 0) + 'modbus_set_digital_input_action("pedal", "freedrive")')

    sim.control.inject("external_force", wrench=[0.0, 0.0, -50.0, 0.0, 0.0, 0.0])
    assert not any(output(sim, "actual_qd"))
    unit.words[5] = 1
    eventually(lambda: any(output(sim, "actual_qd")))
    unit.words[5] = 0
    eventually(lambda: not any(output(sim, "actual_qd")))
    sim.control.clear("external_force")


def test_a_signal_of_the_same_name_replaces_the_first(sim, unit):
    with Unit() as other:
        other.words[6] = 66
        run(sim, add(unit, "same", 2) + 'x = modbus_get_signal_status("same")')
        run(
            sim,
            add(other, "same", 2, address=6)
            + 'write_output_integer_register(0, modbus_get_signal_status("same"))',
        )
        assert output(sim, "output_int_register_0") == 66


def test_it_can_talk_to_its_own_server(sim):
    run(
        sim,
        'modbus_add_signal("127.0.0.1", 255, 200, 3, "own")\n'
        'modbus_set_output_register("own", 4711)\n'
        "while read_port_register(200) != 4711:\n  sync()\nend",
    )


@pytest.mark.parametrize(
    "call",
    [
        'modbus_add_signal("gripper", 255, 0, 0, "x")',
        'modbus_add_signal("127.0.0.1", 256, 0, 0, "x")',
        'modbus_add_signal("127.0.0.1", 255, -1, 0, "x")',
        'modbus_add_signal("127.0.0.1", 255, 0, 4, "x")',
        'modbus_add_signal("127.0.0.1", 255, 0, 0, "")',
        'modbus_add_signal("127.0.0.1", 255, 0, 0, "a name with more than 20 letters")',
        'modbus_add_signal("127.0.0.1", 255, 0, 0, "x", False, 124)',
        'modbus_add_signal("127.0.0.1", 255, 0, 23, "x")',
        'modbus_add_rw_signal("127.0.0.1", 255, 0, 124, 0, 1, "x")',
        'modbus_add_rw_signal("127.0.0.1", 255, 0, 1, 0, 122, "x")',
        'modbus_add_rw_signal("127.0.0.1", 255, 0, 1, 70000, 1, "x")',
        'modbus_get_signal_status("nobody")',
        'modbus_set_output_register("input", 1)',
        'modbus_set_output_signal("register", True)',
        'modbus_set_output_register("register", 65536)',
        'modbus_set_output_register("register", [1, 2])',
        'modbus_set_signal_update_frequency("register", 501)',
        'modbus_set_digital_input_action("register", "freedrive")',
        'modbus_set_runstate_dependent_choice("input", 1)',
        'modbus_send_custom_command("127.0.0.1", 255, 6, [256])',
        'modbus_reset_connection("127.0.0.9")',
    ],
)
def test_what_cannot_be_ends_the_program(sim, unit, call):
    with (
        PrimaryClient(sim.host, timeout=LONG) as primary,
        TcpClient(sim.host, "secondary", LONG) as port,
    ):
        signals = add(unit, "input", 0) + add(unit, "register", 3)
        port.send(f"sec wrong():\n{signals}{call}\nend\n".encode())
        assert call.partition("(")[0].encode() in primary.message(7, LONG)


def test_there_is_an_end_to_the_units():
    with (
        SIM.spawn() as sim,
        PrimaryClient(sim.host, timeout=LONG) as primary,
        TcpClient(sim.host, "secondary", LONG) as port,
    ):
        send = 'modbus_send_custom_command(str_cat("127.0.0.", i), 1, 6, [0, 0, 0, 0])'
        port.send(
            f"sec all():\n  i = 1\n  while i < 50:\n    {send}\n    i = i + 1\n  end\nend\n".encode()
        )
        assert b"more than 32 Modbus units" in primary.message(7, LONG)
