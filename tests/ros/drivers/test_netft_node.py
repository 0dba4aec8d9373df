"""``crtk-driver ati-netft --sim``: the whole node from the command line, with no hardware."""

from __future__ import annotations

import signal
import subprocess

import pytest

from rigs.netft_bench import LONG
from rigs.programs import COMMAND, Start

pytest.importorskip("rclpy")


@pytest.mark.real_time  # what a program prints
@pytest.mark.ros
@pytest.mark.parametrize("profile", ["netbox", "axia", "onrobot"])
def test_the_node_comes_up_at_a_simulator_and_ends_at_a_signal(start: Start, profile: str) -> None:
    arguments = ["ati-netft", "--sim", "--ns", "/ft_with_sim", "--profile", profile]
    pipe = subprocess.PIPE
    with start(COMMAND, *arguments, stdout=pipe, stderr=pipe) as child:
        try:
            assert child.stderr is not None
            told = ""
            while "connected" not in told:
                line = child.stderr.readline()
                assert line, told
                told += line
            child.send_signal(signal.SIGINT)
            _, rest = child.communicate(timeout=LONG)
            assert child.returncode == 0, told + rest
            assert "Traceback" not in told + rest
        finally:
            child.kill()
