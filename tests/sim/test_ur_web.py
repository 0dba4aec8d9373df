"""The page with the 3-D view: its server, its kinematics, and the page in a real browser."""

import contextlib
import http.client
import itertools
import json
import math
import os
import random
import shutil
import socket
import subprocess
from pathlib import Path

import pytest
from ur_clients import wait_until

from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.ur import SIM, web
from crtk_sim_backends.ur.kinematics import Kinematics, to_pose, to_transform
from crtk_sim_backends.ur.models import ALPHA, MODELS

PATIENCE = 20.0
PAGE = Path(web.__file__).with_name("page")
JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(model="ur10e", web=True, web_port=0) as running:
        yield running


def ask(sim, path, body=None, **headers):
    """Return status and body of a request."""
    connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=PATIENCE)
    with contextlib.closing(connection):
        method = "GET" if body is None else "POST"
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


def post(sim, path, request):
    return ask(sim, path, json.dumps(request), **JSON)


# --------------------------------------------------------------------------------------------- server


@pytest.mark.parametrize("path", ["/", "/arm.js", "/view.js"])
def test_the_files_of_the_page_are_served_and_load_nothing_from_elsewhere(sim, path):
    status, body = ask(sim, path)
    assert status == 200
    assert body == (PAGE / (path[1:] or "index.html")).read_bytes()
    assert b"http://" not in body
    assert b"https://" not in body


def test_the_arm_is_told_with_its_kinematic_table(sim):
    status, body = ask(sim, "/arm.json")
    found = json.loads(body)
    assert status == 200
    assert found["title"] == "UR10e"
    assert (found["a"], found["d"]) == (list(MODELS["ur10e"].a), list(MODELS["ur10e"].d))
    assert found["alpha"] == list(ALPHA)


def test_what_is_unknown_is_refused(sim):
    assert ask(sim, "/../web.py")[0] == 404
    assert ask(sim, "/arm.py")[0] == 404
    assert post(sim, "/stop", {})[0] == 404


class Events:
    """The stream of pictures."""

    def __init__(self, sim):
        self.connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=PATIENCE)
        self.connection.request("GET", "/events")
        self.answer = self.connection.getresponse()

    def next(self):
        line = self.answer.readline()
        assert line.startswith(b"data: "), line
        assert self.answer.readline() == b"\n"
        return json.loads(line[6:])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.answer.close()
        self.connection.close()


def test_pictures_come_one_after_the_other(sim):
    with Events(sim) as events:
        assert events.answer.status == 200
        assert events.answer.getheader("Content-Type") == "text/event-stream"
        first, second = events.next(), events.next()
    assert first["actual_q"] == sim.control.outputs("actual_q")["actual_q"]
    assert first["robot_mode"] == "RUNNING"
    assert second["time"] > first["time"]


def test_faults_begin_and_end_from_the_page(sim):
    assert post(sim, "/inject", {"kind": "safeguard_stop", "parameters": {}}) == (200, b"{}")
    assert sim.control.status()["safety_mode"] == "SAFEGUARD_STOP"
    assert post(sim, "/clear", {}) == (200, b"{}")
    assert sim.control.status()["safety_mode"] == "NORMAL"


@pytest.mark.parametrize(
    ("request_body", "headers", "status", "reason"),
    [
        (b'{"kind": "x", "parameters": {}}', JSON, 400, b"unknown kind of fault 'x'"),
        (b'{"kind": "stall", "parameters": {"a": 1}}', JSON, 400, b"unknown parameter of stall"),
        (b'{"what": 1}', JSON, 400, b"refused"),
        (b"[]", JSON, 400, b"expected a JSON object"),
        (b"{", JSON, 400, b"expected JSON"),
        (b"[" * 60_000, JSON, 400, b"expected JSON"),
        (b" " * 70_000, JSON, 400, b"expected JSON"),
        (b"{}", {"Content-Type": "text/plain"}, 415, b"expected application/json"),
        (b"{}", {**JSON, "Host": "evil.example"}, 421, b"another name"),
    ],
)
def test_a_wrong_request_is_refused_with_the_reason(sim, request_body, headers, status, reason):
    found, body = ask(sim, "/inject", request_body, **headers)
    assert found == status
    assert reason in body
    assert sim.control.status()["faults"] == []


def test_another_name_gets_no_pictures_either(sim):
    assert ask(sim, "/events", Host=f"localhost.evil.example:{sim.ports['web']}")[0] == 421


def test_a_ninth_browser_is_refused_and_a_place_becomes_free_again():
    with SIM.spawn(web=True, web_port=0) as own:
        with contextlib.ExitStack() as stack:
            for _ in range(web.WATCHERS):
                stack.enter_context(Events(own)).next()
            assert ask(own, "/events") == (503, b"8 browsers watch already")

        def free():
            with Events(own) as events:
                return events.answer.status == 200

        wait_until(free, PATIENCE)


def test_a_simulator_that_hangs_is_told_and_comes_back():
    with SIM.spawn(web=True, web_port=0) as own, Events(own) as events:
        assert events.next()
        own.suspend()
        try:
            while events.next() is not None:
                pass
        finally:
            own.resume()
        while events.next() is None:
            pass


def test_a_port_in_use_is_refused_and_everything_is_closed():
    (probe,) = [socket.create_server(("127.0.0.1", 0))]
    with probe:
        port = probe.getsockname()[1]
        with pytest.raises(SimStartError, match=rf"cannot bind the web port 127.0.0.1:{port}"):
            SIM.spawn(host="127.0.0.1", web=True, web_port=port)


@pytest.mark.parametrize("end", ["stop", "kill"])
def test_the_page_ends_with_the_simulator(end):
    with SIM.spawn(web=True, web_port=0) as own:
        assert own.hints == (f"3-D view: http://{own.host}:{own.ports['web']}/",)
        getattr(own, end)()

    def refused():
        try:
            socket.create_connection((own.host, own.ports["web"]), 1.0).close()
        except ConnectionRefusedError:
            return True
        return False

    wait_until(refused, PATIENCE)


# ----------------------------------------------------------------------------------------- kinematics

NODE = shutil.which("node")
CHECK = """
import {{ flange, compose, fromPose, frames, shape }} from "{path}";
import {{ readFileSync }} from "node:fs";
const found = JSON.parse(readFileSync(0)).map(({{ arm, q, tool }}) => ({{
  tip: compose(flange(arm, q), fromPose(tool)),
  shape: shape(arm, q, fromPose(tool)),
  frames: frames(arm, q),
}}));
console.log(JSON.stringify(found));
"""


@pytest.fixture(scope="module")
def computed(tmp_path_factory):
    """Postures of every arm, and what the page's own module makes of them."""
    if NODE is None:
        pytest.skip("needs node, which runs the page's kinematics")
    generator = random.Random(5)
    cases = []
    for model in MODELS.values():
        for _ in range(20):
            q = [generator.uniform(-2 * math.pi, 2 * math.pi) for _ in range(6)]
            tool = [generator.uniform(-0.3, 0.3) for _ in range(6)]
            cases.append(
                {
                    "model": model.name,
                    "arm": {"a": model.a, "d": model.d, "alpha": ALPHA},
                    "q": q,
                    "tool": tool if generator.random() > 0.2 else [0.0] * 6,
                }
            )
    folder = tmp_path_factory.mktemp("page")
    shutil.copy(PAGE / "arm.js", folder / "arm.mjs")
    script = folder / "check.mjs"
    script.write_text(CHECK.format(path="./arm.mjs"))
    done = subprocess.run(
        [NODE, str(script)],
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(zip(cases, json.loads(done.stdout), strict=True))


def test_the_pages_forward_kinematics_are_the_simulators(computed):
    for case, found in computed:
        kinematics = Kinematics(MODELS[case["model"]])
        expected = kinematics.forward(case["q"], to_transform(case["tool"]))
        t = found["tip"]
        rotation_and_place = [*t[0:3], *t[4:7], *t[8:11], t[3], t[7], t[11]]
        assert to_pose(tuple(rotation_and_place)) == pytest.approx(expected, abs=1e-9)


def test_the_links_are_one_chain_from_the_base_to_the_tcp(computed):
    for _, found in computed:
        links = [each for each in found["shape"] if each["part"] != "joint"]
        assert links[0]["from"] == [0, 0, 0]
        for before, after in itertools.pairwise(links):
            assert math.dist(before["to"], after["from"]) < 1e-3
        tip = [found["tip"][i] for i in (3, 7, 11)]
        assert math.dist(links[-1]["to"], tip) < 1e-3
        assert sum(each["part"] == "joint" for each in found["shape"]) == 6


# -------------------------------------------------------------------------------------------- browser

BROWSER = os.environ.get("CRTK_BROWSER") or next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))),
    None,
)


class Browser:
    """Chromium without a window, over the two pipes of its DevTools protocol."""

    def __init__(self, profile):
        to_browser, self._requests = os.pipe()
        self._answers, from_browser = os.pipe()
        flags = [
            "--headless=new",
            "--remote-debugging-pipe",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--disable-background-networking",
            "--no-first-run",
            f"--user-data-dir={profile}",
            "about:blank",
        ]
        # The protocol is on the file descriptors 3 and 4.
        command = f'exec "$0" "$@" 3<&{to_browser} 4>&{from_browser}'
        self._log = open(Path(profile) / "browser.log", "w+")  # noqa: SIM115 - closed below
        self._process = subprocess.Popen(
            ["bash", "-c", command, BROWSER, *flags],
            pass_fds=(to_browser, from_browser),
            stdout=self._log,
            stderr=self._log,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._count = 0
        self._session = None
        self.problems = []
        (target,) = (
            each for each in self.call("Target.getTargets")["targetInfos"] if each["type"] == "page"
        )
        attached = self.call("Target.attachToTarget", targetId=target["targetId"], flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=960,
            height=600,
            deviceScaleFactor=1,
            mobile=False,
        )

    def call(self, method, **parameters):
        """Do a request of the protocol and return its result."""
        self._count += 1
        request = {"id": self._count, "method": method, "params": parameters}
        if self._session:
            request["sessionId"] = self._session
        os.write(self._requests, json.dumps(request).encode() + b"\0")
        while True:
            message = self._read()
            if message.get("id") == self._count:
                assert "error" not in message, message
                return message["result"]
            self._note(message)

    def _read(self):
        while b"\0" not in self._buffer:
            piece = os.read(self._answers, 1 << 16)
            assert piece, f"the browser has ended: {Path(self._log.name).read_text()[-2000:]}"
            self._buffer += piece
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)

    def _note(self, message):
        parameters = message.get("params", {})
        match message["method"]:
            case "Runtime.exceptionThrown":
                self.problems.append(parameters["exceptionDetails"])
            case "Log.entryAdded" if parameters["entry"]["level"] == "error":
                self.problems.append(parameters["entry"])

    def run(self, script):
        """Return the value of a JavaScript expression, awaited."""
        found = self.call(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def until(self, script):
        """Wait until an expression is true, and return its value."""
        return wait_until(lambda: self.run(script), PATIENCE, 0.05)

    def close(self):
        with contextlib.suppress(OSError):
            self.call("Browser.close")
        for fd in (self._requests, self._answers):
            os.close(fd)
        try:
            self._process.wait(PATIENCE)
        finally:
            self._process.kill()
            self._process.wait()
            self._log.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    if BROWSER is None:
        pytest.skip("needs chromium (or CRTK_BROWSER, the path of one)")
    opened = Browser(tmp_path_factory.mktemp("browser"))
    yield opened
    opened.close()


@pytest.fixture
def shown(browser, sim):
    browser.problems.clear()
    browser.call("Page.navigate", url=f"http://{sim.host}:{sim.ports['web']}/")
    browser.until("document.getElementById('link')?.textContent === 'live'")
    yield browser
    assert browser.problems == []


def text(browser, name):
    return browser.run(f"document.getElementById('{name}').textContent")


INK = """(() => {
  const canvas = document.getElementById("picture");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let sum = 0, ink = 0;
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3]) { ink += 1; sum = (sum * 31 + data[i] + 7 * data[i + 1] + 13 * data[i + 2]) % 1e9; }
  }
  return [ink, sum];
})()"""


def test_the_page_shows_the_arm_and_its_state_in_a_browser(shown, sim):
    assert text(shown, "title") == f"UR10e 5.12.4 at {sim.host}"
    shown.until("document.getElementById('robot_mode').textContent === 'RUNNING'")
    assert text(shown, "q1") == "-89.95"
    assert text(shown, "safety_mode") == "NORMAL"
    ink, _ = shown.until(f"(() => {{ const found = {INK}; return found[0] > 5000 && found; }})()")
    assert ink > 5000, "pixels that are drawn on"


def test_the_browsers_kinematics_meet_the_controllers_pose(shown, sim):
    outputs = sim.control.outputs("actual_q", "actual_TCP_pose")
    t = shown.run(
        "Promise.all([import('/arm.js'), fetch('/arm.json').then(r => r.json())])"
        f".then(([m, arm]) => m.flange(arm, {outputs['actual_q']}))"
    )
    assert [t[3], t[7], t[11]] == pytest.approx(outputs["actual_TCP_pose"][:3], abs=1e-9)


def test_the_picture_moves_with_the_arm_and_with_the_mouse(shown, sim):
    _, before = shown.run(INK)
    with socket.create_connection((sim.host, 30001)) as script:
        script.sendall(b"movej([0.8, -1.2, 1.2, -1.5, -1.5, 0.5], a=5, v=2)\n")
        shown.until("Number(document.getElementById('q0').textContent) > 45")
    shown.until("Math.abs(Number(document.getElementById('qd0').textContent)) < 0.01")
    _, after = shown.run(INK)
    assert after != before
    for kind, x in (("mousePressed", 200), ("mouseMoved", 320), ("mouseReleased", 320)):
        shown.call(
            "Input.dispatchMouseEvent",
            type=kind,
            x=x,
            y=200,
            button="left",
            buttons=1,
            clickCount=1,
        )
    wait_until(lambda: shown.run(INK)[1] != after, PATIENCE)


def test_a_button_lets_a_fault_begin_and_another_ends_it(shown, sim):
    press = "[...document.querySelectorAll('button')].find(b => b.textContent === '{}').click()"
    shown.run(press.format("safeguard stop"))
    shown.until("document.getElementById('safety_mode').textContent === 'SAFEGUARD_STOP'")
    assert sim.control.status()["safety_mode"] == "SAFEGUARD_STOP"
    shown.run(press.format("end all faults"))
    shown.until("document.getElementById('safety_mode').textContent === 'NORMAL'")


def test_the_page_says_when_the_simulator_has_ended(browser):
    with SIM.spawn(web=True, web_port=0) as own:
        browser.call("Page.navigate", url=f"http://{own.host}:{own.ports['web']}/")
        browser.until("document.getElementById('link')?.textContent === 'live'")
    browser.until("document.getElementById('link').textContent === 'no connection'")
