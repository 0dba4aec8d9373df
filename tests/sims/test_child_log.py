"""What the process of a simulator writes to standard error: log records of who started it."""

import logging
import os

import pytest

from crtk_sim_backends.child_log import ChildLog


def test_records_keep_level_and_logger(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    read, write = os.pipe()
    said = ChildLog("arm simulator", read)
    os.write(write, b"WARNING sim.pace: it is late: by 3\nINFO sim: heard\nTraceback \xff\n\nlast")
    os.close(write)
    said.join()
    assert caplog.record_tuples == [
        ("sim.pace", logging.WARNING, "arm simulator: it is late: by 3"),
        ("sim", logging.INFO, "arm simulator: heard"),
        ("crtk_sim_backends.child_log", logging.WARNING, "arm simulator: Traceback \ufffd"),
        ("crtk_sim_backends.child_log", logging.WARNING, "arm simulator: last"),
    ]
    assert said.last == "last"
