"""Settings of the sensor, written and read back, at a web server that does with them what sensors do."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
import pytest

from crtk_driver_ati_netft import settings
from crtk_driver_ati_netft.profiles import AXIA, NETBOX
from crtk_driver_ati_netft.settings import SensorSettings
from crtk_driver_ati_netft.web import WebPages
from crtk_drivers.errors import ProtocolError
from crtk_drivers.samples import vector
from rigs.waiting import LONG


class Box(HTTPServer):
    """Holds the settings of a sensor."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.paths: list[str] = []
        self.ignores: set[str] = set()
        self.tags: dict[str, str] = {
            "prodname": "ATI Net F/T", "cfgcpf": "1000000", "cfgcpt": "1000000",
            "scfgfu": "N", "scfgtu": "Nm", "runrate": "7000", "setcfgsel": "0",
            "setuserfilter": "0", "comrdtrate": "7000", "comrdtbsiz": "40",
            "setbias": "1;-2;3;4;5;6", "cfgtfx": "0;0;0;0;0;0", "cfgtdu": "1", "scfgtdu": "in",
            "cfgtau": "1", "scfgtau": "degrees",
        }  # fmt: skip

    def set(self, name: str, text: str) -> None:
        """Take a value, clamped and rounded without a word."""
        if name in self.ignores:
            return
        if name == "comrdtrate":
            rate, internal = int(text), int(self.tags["runrate"])
            text = str(internal // (internal // max(1, min(rate, internal))))
        elif name == "setuserfilter":
            text = str(min(int(text), 8))
        elif name == "setadcrate":
            self.tags["runrate"] = {"7812": "7912", "976": "989"}[text]
            return
        elif name.startswith("setbias"):
            bias = self.tags["setbias"].split(";")
            bias[int(name[-1])] = text
            name, text = "setbias", ";".join(bias)
        elif name.startswith("cfgtfx"):
            transform = self.tags["cfgtfx"].split(";")
            transform[int(name[-1])] = text
            name, text = "cfgtfx", ";".join(transform)
        elif name == "cfgtdu":
            self.tags["scfgtdu"] = ["", "in", "ft", "mm", "cm", "m"][int(text)]
        self.tags[name] = text


class Handler(BaseHTTPRequestHandler):
    server: Box

    def do_GET(self) -> None:
        self.server.paths.append(self.path)
        parts = urlsplit(self.path)
        body = "<html>ok</html>"
        if parts.path == "/netftapi2.xml":
            tags = "".join(f"<{name}>{text}</{name}>" for name, text in self.server.tags.items())
            body = f"<netft>{tags}</netft>"
        for name, text in parse_qsl(parts.query):
            self.server.set(name, text)
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body.encode())

    def log_message(self, *_: Any) -> None:
        pass


@pytest.fixture
def box() -> Iterator[Box]:
    with Box() as box:
        thread = threading.Thread(target=lambda: box.serve_forever(poll_interval=0.01))
        thread.start()
        yield box
        box.shutdown()
        thread.join()


@pytest.fixture
def web(box) -> WebPages:
    return WebPages("127.0.0.1", box.server_address[1], timeout=LONG)


def written(box: Box) -> list[str]:
    return [path for path in box.paths if ".cgi" in path]


def test_what_is_given_is_written_and_read_back(box, web) -> None:
    wanted = SensorSettings(configuration=3, rdt_rate=1500, filter_code=5, buffer_size=16)
    found = settings.apply(web, web.read(), NETBOX, wanted)
    assert (found.active_configuration, found.rdt_rate) == (3, 1750)
    assert (found.filter_code, found.buffer_size) == (5, 16)
    assert written(box) == [
        "/setting.cgi?setcfgsel=3",
        "/comm.cgi?comrdtrate=1500",
        "/setting.cgi?setuserfilter=5",
        "/comm.cgi?comrdtbsiz=16",
    ]


def test_what_is_so_already_is_not_written(box, web) -> None:
    wanted = SensorSettings(rdt_rate=6000, filter_code=0, tool_transform=vector(np.zeros(6)))
    found = settings.apply(web, web.read(), NETBOX, wanted)
    assert found.rdt_rate == 7000
    assert written(box) == []
    assert settings.apply(web, found, NETBOX, SensorSettings()) is found


def test_what_is_clamped_is_told(box, web) -> None:
    with pytest.raises(ProtocolError, match="filter_code was set to 12, and the sensor has 8"):
        settings.apply(web, web.read(), NETBOX, SensorSettings(filter_code=12))


def test_what_is_ignored_is_told(box, web) -> None:
    box.ignores.add("comrdtrate")
    with pytest.raises(ProtocolError, match="rdt_rate was set to 1000"):
        settings.apply(web, web.read(), NETBOX, SensorSettings(rdt_rate=1000))


def test_what_the_sensor_does_not_tell_counts_as_not_taken(box, web) -> None:
    del box.tags["comrdtbsiz"]
    box.ignores.add("comrdtbsiz")
    with pytest.raises(ProtocolError, match="the sensor has None"):
        settings.apply(web, web.read(), NETBOX, SensorSettings(buffer_size=10))


def test_an_axia_takes_nominal_rates_for_its_real_ones(box, web) -> None:
    found = settings.apply(web, web.read(), AXIA, SensorSettings(internal_rate=989, rdt_rate=300))
    assert (found.internal_rate, found.rdt_rate) == (989, 329)
    assert written(box)[0] == "/setting.cgi?setadcrate=976"


def test_a_tool_transform_is_written_in_millimetres_and_degrees(box, web) -> None:
    transform = vector([0.001, -0.02, 0.1327, 0, np.pi / 2, -np.pi])
    found = settings.apply(web, web.read(), NETBOX, SensorSettings(tool_transform=transform))
    assert found.transform == pytest.approx(transform, abs=1e-6)
    assert box.tags["cfgtfx"] == "1;-20;132.7;0;90;-180"
    (path,) = written(box)
    assert path.startswith("/config.cgi?cfgid=0&cfgtdu=3&cfgtau=1&cfgtfx0=1&")


def test_the_bias_is_removed_in_one_request(box, web) -> None:
    assert web.read().bias == (1, -2, 3, 4, 5, 6)
    assert settings.remove_bias(web).bias == (0,) * 6
    assert len(written(box)) == 1


def test_a_bias_that_stays_is_told(box, web) -> None:
    box.ignores.add("setbias3")
    with pytest.raises(ProtocolError, match="after it was set to zero"):
        settings.remove_bias(web)
