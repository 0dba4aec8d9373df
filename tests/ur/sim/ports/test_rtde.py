"""RTDE, both protocol versions, over the wire and as the manual says."""

import struct
from itertools import pairwise

import pytest

from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.signals.variables import INPUTS, OUTPUTS
from rigs.ur_clients import SIZES, RtdeClient, TcpClient
from rigs.waiting import eventually


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn() as running:
        yield running


@pytest.fixture
def client(sim):
    with RtdeClient(sim.host) as connected:
        yield connected


@pytest.mark.parametrize(
    ("payload", "accepted"),
    [
        (b"\x00\x01", 1),
        (b"\x00\x02", 1),
        (b"\x00\x00", 0),
        (b"\x00\x03", 0),
        (b"\x01\x02", 0),
        (b"", 0),
        (b"\x02", 0),
    ],
)
def test_protocol_versions_1_and_2_are_accepted(client, payload, accepted):
    assert client.request("V", payload) == bytes([accepted])


def test_the_software_version_is_told(client):
    assert struct.unpack(">4I", client.request("v")) == (5, 12, 4, 0)


def test_output_setup_names_the_types_and_takes_a_trailing_comma(client):
    number, types = client.setup_outputs("timestamp,actual_q,joint_mode,robot_mode,")
    assert number == 1
    assert types == ["DOUBLE", "VECTOR6D", "VECTOR6INT32", "INT32"]


def test_an_unknown_output_makes_the_recipe_invalid(client):
    number, types = client.setup_outputs("timestamp,actual_qq,robot_mode")
    assert (number, types) == (0, ["DOUBLE", "NOT_FOUND", "INT32"])
    assert not client.start()


@pytest.mark.parametrize("payload", [b"", b"\x00" * 7, struct.pack(">d", 500), b"\xff" * 40])
def test_a_malformed_output_setup_is_refused(client, payload):
    assert client.request("O", payload)[0] == 0
    assert not client.start()


@pytest.mark.parametrize(
    ("model", "version"),
    [
        ("ur5", "3.12"),
        ("ur5", "3.15.8"),
        ("ur5e", "5.9.4"),
        ("ur5e", "5.12.4"),
        ("ur20", "5.26"),
        ("ur5e", "10.15"),
    ],
)
def test_every_output_can_be_read_at_once(model, version):
    """UR's own client library subscribes to all of them, far more than the guide's 2048 bytes."""
    software = (*map(int, version.split(".")), 0, 0)[:4]
    names = [name for name, variable in OUTPUTS.items() if variable.since.reached_by(software)]
    assert len(",".join(names)) > 2048
    with SIM.spawn(model=model, version=version) as own, RtdeClient(own.host) as client:
        number, types = client.setup_outputs(",".join(names))
        assert number == 1
        assert types == [OUTPUTS[name].type for name in names]
        assert client.start()
        assert len(client.data()) >= len(names)


def test_variables_come_with_the_software_version(client):
    assert client.setup_outputs("actual_current_as_torque")[1] == ["NOT_FOUND"]
    with SIM.spawn(version="5.23.0") as newer, RtdeClient(newer.host) as other:
        assert other.setup_outputs("actual_current_as_torque") == (1, ["VECTOR6D"])
    with SIM.spawn(model="ur5") as cb3, RtdeClient(cb3.host) as other:
        number, types = other.setup_outputs("ft_raw_wrench,payload_inertia")
        assert (number, types) == (0, ["NOT_FOUND", "VECTOR6D"])


def test_a_cb3_controller_tells_its_tool():
    """UR's C++ client library, and so its ROS driver, subscribes to it and gives up without."""
    with SIM.spawn(model="ur5") as cb3, RtdeClient(cb3.host) as client:
        assert client.setup_outputs("timestamp,tcp_offset")[1] == ["DOUBLE", "VECTOR6D"]


@pytest.mark.parametrize(
    ("name", "versions"),
    [
        ("target_gravity", {"5.25": False, "5.26": True, "10.11": False, "10.12": True}),
        ("control_step", {"5.26": True, "10.12": False, "10.13": True}),
        ("target_base_wrench", {"5.25": False, "10.13": False, "10.14": True}),
        ("tool_output_voltage_2", {"5.26": False, "10.14": False, "10.15": True}),
        ("actual_current_as_torque", {"10.10": False, "10.11": True}),
        ("tcp_offset", {"3.11": False, "3.12": True, "5.5": False, "5.5.1": True, "10.7": True}),
        ("payload_inertia", {"3.15": True, "3.14": False, "5.10": False, "10.10": True}),
        ("input_int_register_24", {"3.8": False, "3.9": True, "5.2": False, "5.3": True}),
    ],
)
def test_the_first_software_of_a_variable(name, versions):
    exists = {
        version: OUTPUTS[name].since.reached_by((*map(int, version.split(".")), 0, 0)[:4])
        for version in versions
    }
    assert exists == versions


PROPERTIES = "v1.software.version,v1.control_box.type,v1.robot_arm.tool_flange.type"


@pytest.mark.parametrize(
    ("version", "wire"),
    [("5.26.3", "0005001a00030000"), ("10.15.1", "000a000f00010000")],
)
def test_properties_are_read_by_name(version, wire):
    """Universal_Robots_Client_Library, test of the RTDE parser: version, CB5.2, flange revision 4."""
    with SIM.spawn(version=version) as newer, RtdeClient(newer.host) as client:
        expected = b"\x00\x14UINT64,UINT32,UINT32" + bytes.fromhex(wire + "05020000" + "01040000")
        assert client.request("R", PROPERTIES.encode()) == expected
        assert client.request("R", b"v1.control_box.type") == b"\x00\x06UINT32\x05\x02\x00\x00"
        one_unknown = client.request("R", b"v1.software.version,v1.not.a.property,")
        assert one_unknown == b"\x00\x1aUINT64,NOT_FOUND,NOT_FOUND"  # and no value at all
        client.write("R", b"," * 30000)
        assert client.closed_by_peer()
        assert newer.control.status()["statistics"]["defects"] == 0


@pytest.mark.parametrize("version", ["5.26.2", "10.14"])
def test_software_without_properties_does_not_answer(version):
    with SIM.spawn(version=version) as older, RtdeClient(older.host) as client:
        client.write("R", PROPERTIES.encode())
        assert client.request("V", b"\x00\x02") == b"\x01"
        (connection,) = older.control.status()["connections"]["rtde"]
        assert connection["packages_bad"] == 1


def test_a_recipe_larger_than_a_package_is_refused(client):
    names = ",".join(["actual_q"] * 1366)
    number, types = client.setup_outputs(names)
    assert (number, len(types)) == (0, 1366)
    assert not client.start()
    assert client.setup_outputs(names.removesuffix(",actual_q"))[0] == 1
    assert client.start()
    assert len(client.data()) == 6 * 1365


@pytest.mark.parametrize("kind", ["O", "I"])
def test_a_request_whose_answer_fits_no_package_ends_the_connection(sim, kind):
    with RtdeClient(sim.host) as client:
        client.write(kind, bytes(8) + b"a," * 30000)
        assert client.closed_by_peer()
    assert sim.control.status()["statistics"]["defects"] == 0


@pytest.mark.parametrize(
    ("frequency", "ticks"), [(500, 1), (125, 4), (100, 5), (180, 2), (1, 500), (0.1, 500)]
)
def test_packages_come_every_nth_period(client, frequency, ticks):
    assert client.setup_outputs("timestamp", frequency)[0] == 1
    assert client.start()
    count = 2 if ticks > 100 else 20
    times = [client.data()[0] for _ in range(count)]
    steps = [b - a for a, b in pairwise(times)]
    assert steps == pytest.approx([ticks * 0.002] * len(steps), abs=1e-6)


def test_protocol_1_has_no_recipe_number_and_the_full_rate(sim):
    with RtdeClient(sim.host, protocol=1) as client:
        assert client.setup_outputs("timestamp,robot_mode") == (None, ["DOUBLE", "INT32"])
        assert client.start()
        first, second = client.data(), client.data()
        assert second[0] - first[0] == pytest.approx(0.002, abs=1e-6)
        assert second[1] == 7


def test_start_needs_an_output_recipe_and_pause_stops_the_stream(client):
    assert not client.start()
    client.setup_outputs("timestamp")
    assert client.start()
    client.data()
    assert client.pause()
    assert client.silent_for(0.05)
    assert client.start()
    client.data()


def test_inputs_are_claimed_and_freed_at_disconnect(sim):
    with RtdeClient(sim.host) as first, RtdeClient(sim.host) as second:
        assert first.setup_inputs("input_int_register_3,input_double_register_3,") == (
            1,
            ["INT32", "DOUBLE"],
        )
        assert first.setup_inputs("input_int_register_3") == (2, ["INT32"])
        assert second.setup_inputs("input_int_register_3,input_int_register_4") == (
            0,
            ["IN_USE", "INT32"],
        )
        assert second.setup_inputs("input_int_register_4") == (1, ["INT32"])
        assert second.setup_inputs("no_such_input") == (0, ["NOT_FOUND"])
        first.close()
        eventually(lambda: second.setup_inputs("input_int_register_3")[0])


def test_every_input_can_be_claimed(client):
    for name, variable in INPUTS.items():
        number, types = client.setup_inputs(name)
        assert number > 0
        assert types == [variable.type]


def test_at_most_255_input_recipes(client):
    for number in range(1, 256):
        assert client.setup_inputs("input_int_register_5")[0] == number
    assert client.setup_inputs("input_int_register_5")[0] == 0


def test_inputs_are_taken_without_start_and_can_be_read_back(client):
    recipe, _ = client.setup_inputs(
        "input_int_register_7,input_double_register_7,input_bit_register_70"
    )
    client.write_data(recipe, "id?", -123456, 2.5, True)
    client.setup_outputs("input_int_register_7,input_double_register_7,input_bit_register_70")
    client.start()
    assert client.wait_for(lambda values: values[0] != 0) == (-123456, 2.5, True)


def test_input_values_outlive_their_client(sim):
    with RtdeClient(sim.host) as client:
        recipe, _ = client.setup_inputs("input_int_register_8")
        client.write_data(recipe, "i", 77)
        client.setup_outputs("input_int_register_8")
        client.start()
        client.wait_for(lambda values: values == (77,))
    with RtdeClient(sim.host) as client:
        client.setup_outputs("input_int_register_8")
        client.start()
        assert client.data() == (77,)


def test_input_packages_that_fit_no_recipe_are_ignored(sim, client):
    recipe, _ = client.setup_inputs("input_int_register_9")
    client.write_data(recipe, "ii", 5, 5)
    client.write_data(recipe + 1, "i", 5)
    client.write("U")
    client.write_data(recipe, "i", 6)
    client.setup_outputs("input_int_register_9")
    client.start()
    assert client.wait_for(lambda values: values[0] != 0) == (6,)
    (connection,) = sim.control.status()["connections"]["rtde"]
    assert (connection["packages_in"], connection["packages_bad"]) == (1, 3)


def test_requests_may_be_split_and_joined_anywhere(sim):
    names = b"timestamp,robot_mode"
    stream = (
        struct.pack(">HBH", 5, ord("V"), 2)
        + struct.pack(">HB", 3, ord("v"))
        + struct.pack(">HBd", 11 + len(names), ord("O"), 125.0)
        + names
        + struct.pack(">HB", 3, ord("S"))
    )
    expected = (
        struct.pack(">HBB", 4, ord("V"), 1)
        + struct.pack(">HB4I", 19, ord("v"), 5, 12, 4, 0)
        + struct.pack(">HBB", 16, ord("O"), 1)
        + b"DOUBLE,INT32"
        + struct.pack(">HBB", 4, ord("S"), 1)
    )
    with TcpClient(sim.host, "rtde") as joined:
        joined.send(stream)
        assert joined.read(len(expected)) == expected
    with TcpClient(sim.host, "rtde") as split:
        for byte in stream:
            split.send(bytes([byte]))
        assert split.read(len(expected)) == expected


def test_a_client_that_does_not_read_loses_packages_and_disturbs_nobody(sim):
    names = ",".join(f"output_double_register_{n}" for n in range(48)) + ",timestamp"
    with RtdeClient(sim.host) as lazy, RtdeClient(sim.host) as other:
        assert lazy.setup_outputs(names)[0] == 1
        assert lazy.start()
        other.setup_outputs("timestamp")
        other.start()
        eventually(lambda: sim.control.status()["statistics"]["rtde_dropped"] > 10)
        times = [other.data()[0] for _ in range(50)]
        assert times == sorted(set(times))
        behind = [lazy.data()[-1] for _ in range(1000)]
        assert behind == sorted(set(behind))  # whole packages only, some left out


@pytest.mark.slow  # one that does not read for a while is its quick brother
def test_a_client_that_never_reads_is_closed():
    """The controller gives up on a reader that takes nothing for some seconds."""
    names = ",".join(f"output_double_register_{n}" for n in range(48))
    with SIM.spawn() as own, RtdeClient(own.host) as lazy:
        lazy.setup_outputs(names)
        lazy.start()
        eventually(lambda: not own.control.status()["connections"]["rtde"], timeout=20)
        assert lazy.closed_by_peer()


@pytest.mark.parametrize(
    ("protocol", "expected"),
    [
        (1, b"\x01input package of 2 bytes fits no recipe"),
        (2, b"\x27input package of 2 bytes fits no recipe\x04RTDE\x01"),
    ],
)
def test_a_bad_input_package_is_told_in_a_text_message(sim, protocol, expected):
    with RtdeClient(sim.host, protocol) as client:
        client.setup_outputs("timestamp", 1.0)
        client.start()
        client.write("U", b"\x07\x00")
        kind, payload = client.package()
        while kind == "U":
            kind, payload = client.package()
        assert (kind, payload) == ("M", expected)


def test_an_input_that_another_client_has_is_in_use_until_that_one_is_gone(sim):
    with RtdeClient(sim.host) as second:
        with RtdeClient(sim.host) as first:
            assert first.setup_inputs("input_int_register_30")[0] == 1
            assert first.setup_inputs("input_int_register_30")[0] == 2  # its own, once more
            number, types = second.setup_inputs("input_int_register_30,input_int_register_31")
            assert (number, types) == (0, ["IN_USE", "INT32"])
        eventually(
            lambda: second.setup_inputs("input_int_register_30,input_int_register_31")[0] == 1
        )


def test_a_fieldbus_has_the_lower_registers_to_itself():
    with SIM.spawn(fieldbus=True) as own, RtdeClient(own.host) as client:
        lower = "input_int_register_0,input_double_register_23,input_bit_registers32_to_63"
        assert client.setup_inputs(lower) == (0, ["IN_USE"] * 3)
        upper = "input_int_register_24,input_double_register_47,input_bit_register_64"
        assert client.setup_inputs(upper) == (1, ["INT32", "DOUBLE", "BOOL"])
        for name, value, seen in (
            ("input_int_register_0", -5.0, -5),
            ("input_double_register_23", 0.5, 0.5),
            ("input_bit_registers32_to_63", 2.0**32 - 1, 0xFFFFFFFF),
        ):
            own.control.inject("fieldbus_input", register=name, value=value)
            eventually(lambda name=name, seen=seen: own.control.outputs(name)[name] == seen)


def test_configurable_inputs_have_bits_of_their_own(sim, client):
    sim.control.inject("digital_inputs", bits=0b11_10100000_00000001)
    client.setup_outputs("actual_configurable_digital_input_bits,control_step")
    number, types = client.setup_outputs("actual_configurable_digital_input_bits")
    assert (number, types) == (1, ["UINT64"])
    client.start()
    client.wait_for(lambda values: values == (0b10100000,))
    sim.control.clear("digital_inputs")


@pytest.mark.parametrize("kind", ["X", "\x00", "\xff"])
def test_packages_of_unknown_type_are_ignored(client, kind):
    client.write(kind, b"whatever")
    assert client.request("V", b"\x00\x02") == b"\x01"


def test_a_size_below_its_header_ends_the_connection(sim):
    with TcpClient(sim.host, "rtde") as client:
        client.send(b"\x00\x02\x56")
        assert client.closed_by_peer()


def test_a_text_message_of_a_client_is_taken_without_reply(client):
    client.write("M", b"\x05hello\x04test\x03")
    assert client.request("V", b"\x00\x02") == b"\x01"


def test_the_trace_tells_when_which_input_package_arrived(sim, client):
    recipe, _ = client.setup_inputs("input_int_register_10")
    before = sim.control.status()["input_packages"]
    for value in (1, 2, 2, 3):
        client.write_data(recipe, "i", value)
    trace = eventually(lambda: [*sim.control.trace(before)][3:] and sim.control.trace(before))
    assert [entry["values"] for entry in trace] == [
        {"input_int_register_10": value} for value in (1, 2, 2, 3)
    ]
    times = [entry["time_ns"] for entry in trace]
    assert times == sorted(times)
    assert {entry["recipe"] for entry in trace} == {recipe}


def test_the_test_client_knows_every_type():
    assert {variable.type for variable in (*OUTPUTS.values(), *INPUTS.values())} <= set(SIZES)
