"""RTDE outputs to a file and back: the format, what is refused, and what a listening client gets."""

import gzip
import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from crtk_sim_backends.control import ControlError
from crtk_sim_backends.ur import SIM, ConfigError, SimConfig, SimStartError
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.signals.recording import (
    Recorder,
    RecordingError,
    chosen_variables,
    columns_of,
    read_recording,
)
from crtk_sim_backends.ur.signals.variables import OUTPUTS, initial_image
from crtk_sim_backends.ur.views.replay import ReplayedController, load
from rigs.ur_clients import SIZES, DashboardClient, PrimaryClient, RtdeClient, TcpClient
from rigs.waiting import eventually

VERSION = (5, 12, 4, 0)

# As record.py of the vendor's RTDE client library writes it with its own record_configuration.xml
# (first rows; target_qdd, currents and moments left out).
VENDOR = """\
timestamp target_q_0 target_q_1 target_q_2 target_q_3 target_q_4 target_q_5 robot_mode \
actual_digital_input_bits runtime_state standard_analog_input0 output_bit_register_64
2364.55 0.1 -1.57 1.6 -1.5 -1.57 0.0 7 3 2 0.0042 True
2364.558 0.2 -1.57 1.6 -1.5 -1.57 0.0 7 3 2 0.0043 False
2364.566 0.3 -1.57 1.6 -1.5 -1.57 0.0 5 3 1 0.0044 False
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "recording.csv"


def written(path, text):
    path.write_text(text)
    return path


# ------------------------------------------------------------------------------------------- the format


def test_what_the_vendors_example_writes_is_read(path):
    recording = read_recording(written(path, VENDOR))
    assert recording.rows == 3
    assert recording.duration == pytest.approx(0.016)
    row = recording.row(0)
    assert row["target_q"] == (0.1, -1.57, 1.6, -1.5, -1.57, 0.0)
    assert (row["robot_mode"], row["actual_digital_input_bits"]) == (7, 3)
    assert isinstance(row["robot_mode"], int)
    assert row["output_bit_register_64"] is True
    assert list(recording.column("runtime_state")) == [2.0, 2.0, 1.0]


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_other_separators_line_ends_and_quotes_are_read_too(path, separator, end):
    text = VENDOR.replace(" ", separator).replace("\n", end).replace("timestamp", '"timestamp"')
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert read_recording(path).row(2)["target_q"][0] == 0.3


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("timestamp", "time"), "unknown output variable 'time'"),
        (("robot_mode", "robot_mod"), "did you mean 'robot_mode'"),
        (("timestamp ", ""), "the first column must be timestamp"),
        (("target_q_5 ", ""), "line 1: target_q needs the columns target_q_0 target_q_1"),
        (("0.0042", "x"), "line 2: 'x' is no number"),
        (("0.0042", "nan"), "line 2: 'nan' is not finite"),
        (("0.0042 ", ""), "line 2: 11 columns, not 12"),
        (("2364.558", "2364.5"), "line 3: the time goes back to 2364.5"),
        ((VENDOR, ""), "the first column must be timestamp, not none"),
        ((VENDOR[VENDOR.index("2364") :], ""), "has no rows"),
    ],
)
def test_a_wrong_recording_is_refused_with_its_place(path, change, complaint):
    with pytest.raises(RecordingError) as caught:
        read_recording(written(path, VENDOR.replace(*change)))
    assert complaint in str(caught.value)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"\x1f\x8b rubbish"])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    path = tmp_path / ("recording.gz" if content.startswith(b"\x1f") else "recording.csv")
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"cannot read .*recording"):
        read_recording(path)


def test_a_cut_compressed_recording_is_refused(tmp_path):
    path = tmp_path / "recording.csv.gz"
    path.write_bytes(gzip.compress(VENDOR.encode())[:-10])
    with pytest.raises(RecordingError, match=r"cannot read .*recording.csv.gz"):
        read_recording(path)


def test_a_last_line_that_was_cut_is_left_out(path, caplog):
    assert read_recording(written(path, VENDOR[:-7])).rows == 2
    assert "line 4, the last one, is not whole" in caplog.text


def test_a_mode_that_is_none_is_refused(path):
    with pytest.raises(RecordingError, match="robot_mode 42 is none"):
        load(written(path, VENDOR.replace("0.0 7 3", "0.0 42 3")))


def _values(variable):
    wire = SIZES[variable.type]
    numbers = {
        "d": st.floats(allow_nan=False, allow_infinity=False),
        "?": st.booleans(),
        "B": st.integers(0, 255),
        "I": st.integers(0, 2**32 - 1),
        "i": st.integers(-(2**31), 2**31 - 1),
        "Q": st.integers(0, 2**53),  # of these bits the controller uses 18
    }[wire[-1]]
    count = int(wire[:-1] or 1)
    return numbers if count == 1 else st.tuples(*[numbers] * count)


@given(st.data(), st.lists(st.sampled_from(sorted(OUTPUTS)), min_size=1, max_size=8))
def test_what_is_recorded_is_read_back_exactly(tmp_path_factory, data, names):
    variables = chosen_variables(names, (99, 0, 0, 0))
    images = []
    for number in range(3):
        drawn = {v.name: data.draw(_values(v)) for v in variables[1:]}
        images.append({**initial_image(OUTPUTS), **drawn, "timestamp": 0.002 * number})
    path = tmp_path_factory.mktemp("recordings") / "recording.csv.gz"
    recorder = Recorder(path, variables, every=1)
    recorder.start()
    for tick, image in enumerate(images):
        recorder.add(image, tick)
    recorder.close()
    recording = read_recording(path)
    assert list(recording.times) == [0.0, 0.002, 0.004]
    for number, image in enumerate(images):
        assert recording.row(number) == {v.name: image[v.name] for v in variables[1:]}


def test_every_variable_has_columns_that_name_it_and_no_other():
    names = [name for variable in OUTPUTS.values() for name in columns_of(variable)]
    assert len(set(names)) == len(names)


# -------------------------------------------------------------------------------------------- recording


def test_the_simulator_records_what_it_publishes_from_its_first_period_on(path):
    options = {"record": str(path), "record_variables": "actual_q, robot_mode", "speed": 10.0}
    with SIM.spawn(**options) as sim:
        eventually(lambda: sim.control.status()["record"]["rows"] > 1000)
    assert path.read_text().splitlines()[0] == (
        "timestamp actual_q_0 actual_q_1 actual_q_2 actual_q_3 actual_q_4 actual_q_5 robot_mode"
    )
    recording = read_recording(path)
    assert recording.rows > 1000
    assert list(recording.times[:3]) == pytest.approx([0.002, 0.004, 0.006])
    assert recording.row(5)["robot_mode"] == 7


def test_the_rate_is_the_controllers_and_faults_are_in_its_time(path, tmp_path):
    faults = tmp_path / "faults.yaml"
    faults.write_text("- {at: 5.0, kind: safeguard_stop}\n")
    options = {"record": str(path), "record_rate": 125.0, "speed": 10.0, "faults": str(faults)}
    with SIM.spawn(**options) as sim:
        eventually(lambda: sim.control.status()["time"] > 6.0)
    recording = read_recording(path)
    assert recording.times[1] - recording.times[0] == pytest.approx(0.008)
    modes = list(recording.column("safety_mode"))
    assert recording.times[modes.index(5.0)] == pytest.approx(5.0, abs=0.01)


def test_nothing_is_written_over(path):
    path.write_text("precious")
    with pytest.raises(SimStartError, match=r"recording.csv is there already"):
        SIM.spawn(record=str(path))
    assert path.read_text() == "precious"


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(SimStartError, match=r"cannot write .*No such file"):
        SIM.spawn(record=str(tmp_path / "nowhere" / "recording.csv"))


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a disk that is full")
def test_a_full_disk_ends_the_recording_and_is_told(path, caplog):
    variables = chosen_variables([], VERSION)
    recorder = Recorder(path, variables, every=1)
    recorder._file.close()
    recorder._file = open("/dev/full", "w")  # noqa: SIM115 - closed by the recorder
    recorder.start()
    recorder.add({"timestamp": 0.002}, 1)
    eventually(lambda: recorder.error)
    assert "No space left" in recorder.error
    recorder.add({"timestamp": 0.004}, 2)
    assert recorder.status["lost"] == 2
    recorder.close()
    assert "lacks at least 2 rows" in caplog.text


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (
            {"record_variables": "actual_qq"},
            "record_variables: unknown output variable 'actual_qq'",
        ),
        ({"record_variables": "ft_raw_wrench", "model": "ur5"}, "unknown output variable"),
        ({"record_rate": 501.0}, "record_rate must lie in [0, 500]"),
        ({"record_rate": -1.0}, "record_rate must lie in"),
        ({"replay": "/no/such/file"}, "replay: there is no file"),
        ({"replay": __file__, "modbus": True}, "replay: a recording has neither Modbus nor"),
    ],
)
def test_wrong_options_are_refused(options, complaint):
    with pytest.raises(ConfigError) as caught:
        SimConfig(**options)
    assert complaint in str(caught.value)


# ----------------------------------------------------------------------------------------------- replay


def listened(path, *, loop=False, begins=lambda: True):
    return ReplayedController(MODELS["ur5e"], VERSION, load(path), loop=loop, begins=begins)


def rows_of(controller, ticks):
    rows = []
    for _ in range(ticks):
        controller.tick()
        rows.append((controller.outputs["timestamp"], controller.outputs["target_q"][0]))
    return rows


def test_each_row_stays_until_the_next_is_due_and_the_last_one_for_good(path):
    controller = listened(written(path, VENDOR))
    rows = rows_of(controller, 12)
    assert [value for _, value in rows] == [0.1] * 4 + [0.2] * 4 + [0.3] * 4
    times = [stamp for stamp, _ in rows]
    assert times == pytest.approx([2364.55 + 0.002 * n for n in range(12)])
    assert controller.ended
    assert (controller.robot_mode.name, controller.runtime_state.name) == ("IDLE", "STOPPED")


def test_a_recording_that_begins_anew_has_a_time_that_goes_on(path):
    controller = listened(written(path, VENDOR), loop=True)
    rows = rows_of(controller, 20)
    assert [v for _, v in rows] == [0.1] * 4 + [0.2] * 4 + [0.3] + [0.1] * 4 + [0.2] * 4 + [0.3] + [
        0.1
    ] * 2
    assert rows[-1][0] == pytest.approx(2364.55 + 0.002 * 19)
    assert not controller.ended


def test_it_waits_for_the_first_client(path):
    heard = []
    controller = listened(written(path, VENDOR), begins=lambda: bool(heard))
    assert set(rows_of(controller, 50)) == {(2364.55, 0.1)}
    heard.append(1)
    assert rows_of(controller, 5)[-1] == (pytest.approx(2364.558), 0.2)


def test_what_was_not_recorded_is_that_of_an_arm_at_rest(path):
    controller = listened(written(path, "timestamp speed_scaling\n1.5 0.5\n"))
    controller.tick()
    assert controller.outputs["speed_scaling"] == 0.5
    assert controller.robot_mode.name == "RUNNING"
    assert controller.outputs["robot_mode"] == 7
    assert controller.safety_mode.name == "NORMAL"


def test_a_client_gets_the_very_packages_that_were_published(path):
    names = "timestamp,actual_q,robot_mode,joint_mode,actual_digital_output_bits"
    variables = names.replace("timestamp,", "")
    with SIM.spawn(record=str(path), record_variables=variables, speed=5.0) as sim:
        eventually(lambda: sim.control.status()["record"]["rows"] > 500)
    recording = read_recording(path)
    with SIM.spawn(replay=str(path), speed=2.0) as sim, RtdeClient(sim.host) as client:
        client.setup_outputs(names)
        assert client.start()
        packages = [client.data() for _ in range(200)]
        status = sim.control.status()
    for number, package in enumerate(packages):
        row = recording.row(number)
        assert package[0] == pytest.approx(recording.times[number], abs=1e-9)
        assert package[1:7] == row["actual_q"]
        assert package[7:14] == (row["robot_mode"], *row["joint_mode"])
    assert status["replay"]["rows"] == recording.rows
    assert status["replay"]["row"] >= 200


@pytest.fixture(scope="module")
def replaying(tmp_path_factory):
    path = written(tmp_path_factory.mktemp("replay") / "vendor.csv", VENDOR)
    with SIM.spawn(replay=str(path)) as sim:
        yield sim


def test_while_a_recording_is_replayed_nothing_can_be_commanded(replaying):
    with RtdeClient(replaying.host) as client:
        assert client.setup_inputs("speed_slider_mask,speed_slider_fraction") == (
            0,
            ["IN_USE", "IN_USE"],
        )
    with DashboardClient(replaying.host) as dashboard:
        assert dashboard.ask("is in remote control") == "false"
        assert "Remote Control" in dashboard.ask("power off")
        assert dashboard.ask("robotmode") == "Robotmode: RUNNING"
    for port, reason in (
        ("primary", b"this port is read-only"),  # as in local control
        ("realtime", b"a recording is replayed, and nothing can be commanded"),
    ):
        with PrimaryClient(replaying.host) as listener, TcpClient(replaying.host, port) as sender:
            sender.send(b"set_digital_out(1, True)\n")
            assert reason in listener.message(6)
    with pytest.raises(ControlError, match="protective_stop: a recording is replayed"):
        replaying.control.inject("protective_stop")


def test_a_cb3_recording_is_not_in_remote_control_either(path):
    text = VENDOR.replace(" output_bit_register_64", "").replace(" True", "").replace(" False", "")
    with (
        SIM.spawn(model="ur5", replay=str(written(path, text))) as sim,
        DashboardClient(sim.host) as dashboard,
    ):
        assert "Remote Control" in dashboard.ask("power off")


def test_the_wires_of_a_replay_can_have_faults(replaying):
    with RtdeClient(replaying.host) as client:
        client.setup_outputs("timestamp")
        assert client.start()
        replaying.control.inject("disconnect", port="rtde")
        assert client.closed_by_peer()


def test_a_wrong_recording_is_refused_at_the_start(path):
    with pytest.raises(SimStartError, match=r"line 2: 'x' is no number"):
        SIM.spawn(replay=str(written(path, VENDOR.replace("0.0042", "x"))))


def test_faults_of_the_robot_in_a_file_are_refused_at_the_start(path, tmp_path):
    faults = written(tmp_path / "faults.yaml", "- {at: 1, kind: power_loss}\n")
    with pytest.raises(SimStartError, match="power_loss: a recording is replayed"):
        SIM.spawn(replay=str(written(path, VENDOR)), faults=str(faults))
