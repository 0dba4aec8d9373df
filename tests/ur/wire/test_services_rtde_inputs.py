"""The connection that sets outputs: against the simulated controller, and peers that misbehave."""

import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress

import pytest

from crtk_driver_ur.rtde import inputs
from crtk_driver_ur.rtde.inputs import RtdeInputs
from crtk_drivers.errors import ConnectionFailed, ConnectionLost
from crtk_sim_backends.ur import SIM
from rigs.waiting import eventually

LONG = 30.0
SLIDER = {"speed_slider_mask": 1, "speed_slider_fraction": 0.5}
OUTPUT = {"standard_digital_output_mask": 1, "standard_digital_output": 1}
ACCEPTED = b"\x00\x04V\x01"


def reply(types: bytes, recipe: int = 1) -> bytes:
    return struct.pack(">HBB", 4 + len(types), ord("I"), recipe) + types


@contextmanager
def peer(*answers: bytes) -> Iterator[RtdeInputs]:
    """Answer the requests in turn, then close; None answers."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        done = threading.Event()

        def serve() -> None:
            connection, _ = listener.accept()
            with connection, suppress(ConnectionError):  # of a client that has given up
                for answer in answers:
                    connection.recv(4096)
                    connection.sendall(answer)
                if answers and answers[-1] == b"":
                    done.wait(LONG)

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            with closing(RtdeInputs("127.0.0.1", listener.getsockname()[1])) as client:
                yield client
        finally:
            done.set()
            thread.join(LONG)


def test_two_recipes_on_one_connection():
    with SIM.spawn(model="ur5e") as sim, closing(RtdeInputs(sim.host)) as client:
        for _ in range(3):
            client.write(SLIDER)
            client.write(OUTPUT)
        wanted = {"target_speed_fraction": 0.5, "actual_digital_output_bits": 1}
        eventually(lambda: sim.control.outputs(*wanted) == wanted, "they are set")


def test_a_connection_that_was_cut_is_made_anew():
    with SIM.spawn(model="ur5e") as sim, closing(RtdeInputs(sim.host)) as client:
        client.write(SLIDER)
        wanted = {"target_speed_fraction": 0.25}
        cut = client._socket
        sim.control.inject("disconnect", port="rtde")

        def taken() -> bool:
            client.write({**SLIDER, "speed_slider_fraction": 0.25})
            return client._socket is not cut and sim.control.outputs(*wanted) == wanted

        eventually(taken, "it is set by another connection")


def test_variables_are_free_again_after_close():
    with SIM.spawn(model="ur5e") as sim, closing(RtdeInputs(sim.host)) as second:
        with closing(RtdeInputs(sim.host)) as first:
            first.write(SLIDER)
            with pytest.raises(ConnectionFailed, match="IN_USE"):
                second.write(SLIDER)
            second.write(OUTPUT)

        def is_free() -> bool:
            with suppress(ConnectionFailed):  # as long as the controller has not seen the end
                second.write(SLIDER)
                return True
            return False

        eventually(is_free, "the other has closed")


@pytest.mark.parametrize(
    ("answers", "error", "words"),
    [
        ((b"",), ConnectionLost, "timed out"),
        ((ACCEPTED, b""), ConnectionLost, "timed out"),
        ((), ConnectionLost, "could not be sent"),
        ((b"\x00\x04V\x00",), ConnectionFailed, "version 2"),
        ((ACCEPTED, reply(b"UINT32,NOT_FOUND", 0)), ConnectionFailed, "NOT_FOUND"),
        ((ACCEPTED, reply(b"UINT32,IN_USE", 0)), ConnectionFailed, "Close the other client"),
        ((ACCEPTED, reply(b"UINT32")), ConnectionFailed, "refuses"),
        ((ACCEPTED, reply(b"UINT32,DOUBLE", 0)), ConnectionFailed, "refuses"),
        ((b"\x00\x01V",), ConnectionLost, "claims 1 bytes"),
    ],
)
def test_a_peer_that_misbehaves_is_an_error_with_its_address(monkeypatch, answers, error, words):
    if words == "timed out":
        monkeypatch.setattr(inputs, "TIMEOUT", 0.2)
    with peer(*answers) as client, pytest.raises(error) as caught:
        client.write(SLIDER)
    assert words in str(caught.value)
    assert "127.0.0.1:" in str(caught.value)


def test_values_that_do_not_fit_are_not_sent():
    with SIM.spawn(model="ur5e") as sim, closing(RtdeInputs(sim.host)) as client:
        with pytest.raises(ValueError, match="do not fit"):
            client.write({**OUTPUT, "standard_digital_output": 256})
        assert sim.control.status()["input_packages"] == 0
