"""The scale: known lines, the contract of crtk-drivers, and what the contract cannot know."""

import socket
import threading
import time
from collections.abc import Iterator

import pytest
from crtk_driver_sartorius import PLUGIN, SartoriusConfig
from crtk_driver_sartorius.device import SartoriusDevice
from crtk_driver_sartorius.protocol import ASK, Weight, decoder
from crtk_sim_sartorius import SIM

from crtk_drivers.front import LocalDevice
from crtk_drivers.session import Session
from crtk_drivers.testing.contract import DeviceContract

LINES = b"+   123.45 g  \r\n-     0.50    \r\n     High     \r\n"
WEIGHTS = [Weight(123.45, "g"), Weight(-0.5, ""), Weight(None, "")]


@pytest.mark.parametrize("cut", range(0, len(LINES), 5))
def test_lines_cut_anywhere(cut: int) -> None:
    stream = decoder()
    assert stream.feed(LINES[:cut]) + stream.feed(LINES[cut:]) == WEIGHTS


@pytest.mark.parametrize("line", [b"", b"+ 1.0 g", b"+     nan g   ", b"+    1.00 lb  ", b"x\xff"])
def test_what_is_no_weight_is_left_out_and_counted(line: bytes) -> None:
    stream = decoder()
    assert stream.feed(LINES + line + b"\r\n" + LINES) == 2 * WEIGHTS
    assert stream.damage.total == 1


def test_a_tare_is_not_believed_by_a_weight_of_before() -> None:
    """What the scale shows already, and what it answers to a question from before the tare."""

    def answer() -> None:
        peer, _ = listener.accept()
        with peer:
            while data := peer.recv(100):
                peer.sendall(b"+     0.00 g  \r\n" * data.count(ASK))

    with socket.create_server(("127.0.0.1", 0)) as listener:
        host, port = listener.getsockname()
        scale = threading.Thread(target=answer)
        scale.start()
        device = SartoriusDevice(SartoriusConfig(port=f"socket://{host}:{port}"))
        device.open(time.monotonic() + 20.0)
        tare = device.services["tare"].run()
        for _ in range(2):
            next(tare)
            assert device.read(time.monotonic() + 20.0) is not None
        with pytest.raises(StopIteration, match="is zero"):
            next(tare)
        device.close()
        scale.join()


class TestScale(DeviceContract):
    """Everything that any device must do."""

    @pytest.fixture
    def session(self) -> Iterator[Session]:
        """A scale at its simulator, with 500 g on it; a busy machine is no fault."""
        with SIM.spawn(mass=500.0) as self.sim:
            yield Session(PLUGIN, PLUGIN.sim_config(SartoriusConfig(sample_timeout=1.0), self.sim))

    def break_link(self, session: Session) -> None:
        self.sim.control.inject("disconnect")

    def mend_link(self, session: Session) -> None:
        self.sim.control.clear("disconnect")

    def test_it_weighs_and_tares(self, arm: LocalDevice) -> None:
        assert arm.measured_cf().force == pytest.approx([0.0, 0.0, -4.903], abs=1e-3)
        assert arm.tare() == "the present weight is zero"
        assert arm.measured_cf().force[2] == 0.0

    @pytest.mark.parametrize(("kind", "said"), [("deaf", "old"), ("other_unit", "kg, not in g")])
    def test_what_ends_in_a_fault(self, arm: LocalDevice, kind: str, said: str) -> None:
        self.sim.control.inject(kind)
        assert arm.wait_for_operating_state("FAULT", self.timeout)
        assert said in arm.operating_state().detail

    def test_one_that_is_shaken_says_so(self, arm: LocalDevice) -> None:
        self.sim.control.inject("shaken")
        self.until(lambda: not arm.state.at_rest(), "say that it is not at rest")
