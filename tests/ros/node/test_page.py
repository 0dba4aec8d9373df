"""`crtk-driver <device> --web`: the page is told, served while the driver runs, and ends with it."""

import http.client
import json
import signal
import subprocess

import pytest

from rigs.programs import COMMAND, Start
from rigs.waiting import LONG

pytest.importorskip("rclpy")
pytestmark = pytest.mark.ros


def test_the_page_of_a_driver_is_told_and_ends_with_it(start: Start) -> None:
    words = ("loopback", "--ns", "/paged", "--web", "--web-port", "0", "--log-format", "json")
    with start(COMMAND, *words, stderr=subprocess.PIPE) as it:
        try:
            assert it.stderr is not None
            records = []
            address = ""
            for line in it.stderr:
                records.append(json.loads(line)["message"])
                if "page: http://" in records[-1]:
                    address = records[-1].partition("page: http://")[2].rstrip("/")
                if "in another terminal" in records[-1]:
                    break
            assert address, records
            page = http.client.HTTPConnection(address, timeout=LONG)
            page.request("GET", "/scene.json")
            assert json.loads(page.getresponse().read())["title"] == "loopback · /paged"
            page.close()
            it.send_signal(signal.SIGINT)
            assert it.wait(LONG) == 0
            with pytest.raises(ConnectionRefusedError):
                page.request("GET", "/")
        finally:
            it.kill()
