"""The page of the simulated controller: its server, its kinematics, and the page in a real browser."""

import contextlib
import http.client
import itertools
import json
import math
import random
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

from bench.browser import BROWSER, Browser
from crtk_sim_backends.control import token
from crtk_sim_backends.page import server
from crtk_sim_backends.process import SimStartError
from crtk_sim_backends.ur import SIM
from crtk_sim_backends.ur.models import MODELS
from crtk_sim_backends.ur.motion.calibration import calibrated, kinematics_of
from crtk_sim_backends.ur.motion.kinematics import to_pose, to_transform
from crtk_sim_backends.ur.views.scene import _joint, chain
from rigs.ur_clients import own_address
from rigs.waiting import LONG, eventually

PAGE = Path(server.__file__).with_name("files")
JSON = {"Content-Type": "application/json", "Authorization": f"Bearer {token()}"}


@pytest.fixture(scope="module")
def sim():
    with SIM.spawn(model="ur10e", web=True, web_port=0) as running:
        yield running


def ask(sim, path, body=None, **headers):
    """Return status and body of a request."""
    connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=LONG)
    with contextlib.closing(connection):
        method = "GET" if body is None else "POST"
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read()


def post(sim, path, request):
    return ask(sim, path, json.dumps(request), **JSON)


# --------------------------------------------------------------------------------------------- server


@pytest.mark.parametrize("path", ["/", "/arm.js", "/chain.js", "/solids.js", "/view.js"])
def test_the_files_of_the_page_are_served_and_load_nothing_from_elsewhere(sim, path):
    status, body = ask(sim, path)
    assert status == 200
    assert body == (PAGE / (path[1:] or "index.html")).read_bytes()
    assert b"http://" not in body
    assert b"https://" not in body


def test_the_arm_is_told_with_its_kinematic_chain(sim):
    status, body = ask(sim, "/scene.json")
    found = json.loads(body)
    assert status == 200
    assert found["title"] == "UR10e"
    assert found["chain"] == json.loads(json.dumps(chain(MODELS["ur10e"])))
    assert "Late: begun more than 1 ms after its time" in found["notes"]["periods"]


def test_what_is_unknown_is_refused(sim):
    assert ask(sim, "/../web.py")[0] == 404
    assert ask(sim, "/arm.py")[0] == 404
    assert post(sim, "/stop", {})[0] == 404


class Events:
    """The stream of pictures."""

    def __init__(self, sim):
        self.connection = http.client.HTTPConnection(sim.host, sim.ports["web"], timeout=LONG)
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
    assert first["q"] == sim.control.outputs("actual_q")["actual_q"]
    assert ["robot", "RUNNING", "good"] in first["sections"]["State"]
    assert second["sections"]["Simulator"] != first["sections"]["Simulator"], "time goes on"


def test_the_joints_come_with_their_limits_and_goals(sim):
    with Events(sim) as events:
        (joints,) = events.next()["gauges"]
    assert (joints["unit"], joints["rate"]) == ("deg", "deg/s")
    assert [each["name"] for each in joints["gauges"]][:2] == ["base", "shoulder"]
    q = sim.control.outputs("actual_q")["actual_q"]
    for each, angle in zip(joints["gauges"], q, strict=True):
        assert (each["low"], each["high"]) == pytest.approx((-360, 360))
        assert each["value"] == pytest.approx(math.degrees(angle))
        assert each["goal"] == pytest.approx(math.degrees(angle), abs=0.1)


def test_a_joint_without_limits_has_none():
    found = dict.fromkeys(("actual_q", "target_q", "actual_qd"), [0.0] * 6)
    assert [_joint(MODELS["ur3e"], found, index)["high"] for index in (4, 5)] == [360.0, None]


def test_what_is_not_finite_is_null_and_json_for_every_browser():
    found = {"q": [1.0, math.nan], "gauges": [{"value": -math.inf}], "name": "nan", "goal": None}
    text = server.json_of(found).decode()
    assert text == '{"q": [1.0, null], "gauges": [{"value": null}], "name": "nan", "goal": null}'


@pytest.mark.parametrize(
    "given", [None, "Bearer", "Bearer guess", f"Basic {token()}", "Bearer \xe4"]
)
@pytest.mark.parametrize("path", ["/inject", "/clear"])
def test_without_the_token_a_page_changes_nothing(sim, path, given):
    headers = {"Content-Type": "application/json"}
    if given is not None:
        headers["Authorization"] = given
    status, body = ask(sim, path, b'{"kind": "stall", "parameters": {}}', **headers)
    assert status == 401
    assert b"token" in body
    assert sim.control.status()["faults"] == []


def test_faults_begin_and_end_from_the_page(sim):
    assert post(sim, "/inject", {"kind": "safeguard_stop", "parameters": {}}) == (200, b"{}")
    assert sim.control.status()["safety_mode"] == "SAFEGUARD_STOP"
    assert post(sim, "/clear", {"kind": "reduced_mode"}) == (200, b"{}")
    assert sim.control.status()["safety_mode"] == "SAFEGUARD_STOP"
    assert post(sim, "/clear", {"kind": "safeguard"})[0] == 400
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
        (b"{}", {**JSON, "Content-Type": "text/plain"}, 415, b"expected application/json"),
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
            for _ in range(server.WATCHERS):
                stack.enter_context(Events(own)).next()
            assert ask(own, "/events") == (503, b"8 browsers watch already")

        def free():
            with Events(own) as events:
                return events.answer.status == 200

        eventually(free)


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
    host = own_address()
    with socket.create_server((host, 0)) as probe:
        port = probe.getsockname()[1]
        with pytest.raises(SimStartError, match=rf"cannot bind the web port {host}:{port}"):
            SIM.spawn(host=host, web=True, web_port=port)


@pytest.mark.parametrize("end", ["stop", "kill"])
def test_the_page_ends_with_the_simulator(end):
    with SIM.spawn(web=True, web_port=0) as own:
        assert own.hints == (f"page: http://{own.host}:{own.ports['web']}/#{token()}",)
        getattr(own, end)()

    def refused():
        try:
            socket.create_connection((own.host, own.ports["web"]), 1.0).close()
        except ConnectionRefusedError:
            return True
        return False

    eventually(refused)


# ----------------------------------------------------------------------------------------- kinematics

NODE = shutil.which("node")
CHECK = """
import {{ IDENTITY, flange, compose, fromPose, shape }} from "{path}";
import {{ readFileSync }} from "node:fs";
const found = JSON.parse(readFileSync(0)).map(({{ chain, q, tool }}) => ({{
  tip: compose(flange(chain, q), fromPose(tool)),
  shape: shape(chain, q, IDENTITY, compose(flange(chain, q), fromPose(tool))),
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
    arms = []
    own = calibrated(MODELS["ur5e"], 3.0, 7)
    for model in [*MODELS.values(), own]:
        for _ in range(20):
            q = [generator.uniform(-2 * math.pi, 2 * math.pi) for _ in range(6)]
            tool = [generator.uniform(-0.3, 0.3) for _ in range(6)]
            arms.append(model)
            cases.append(
                {
                    "chain": chain(model),
                    "q": q,
                    "tool": tool if generator.random() > 0.2 else [0.0] * 6,
                }
            )
    folder = tmp_path_factory.mktemp("page")
    shutil.copy(PAGE / "chain.js", folder / "chain.mjs")
    script = folder / "check.mjs"
    script.write_text(CHECK.format(path="./chain.mjs"))
    done = subprocess.run(
        [NODE, str(script)],
        input=json.dumps(cases),
        capture_output=True,
        text=True,
        timeout=LONG,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(zip(arms, cases, json.loads(done.stdout), strict=True))


def test_the_pages_forward_kinematics_are_the_simulators(computed):
    for model, case, found in computed:
        expected = kinematics_of(model).forward(case["q"], to_transform(case["tool"]))
        t = found["tip"]
        rotation_and_place = [*t[0:3], *t[4:7], *t[8:11], t[3], t[7], t[11]]
        assert to_pose(tuple(rotation_and_place)) == pytest.approx(expected, abs=1e-9)


def test_the_links_are_one_chain_from_the_base_to_the_tcp(computed):
    for _, _, found in computed:
        links = [each for each in found["shape"] if each["part"] in ("link", "tool")]
        assert links[0]["from"] == [0, 0, 0]
        for before, after in itertools.pairwise(links):
            assert math.dist(before["to"], after["from"]) < 1e-3
        tip = [found["tip"][i] for i in (3, 7, 11)]
        assert math.dist(links[-1]["to"], tip) < 1e-3
        assert sum(each["part"] == "joint" for each in found["shape"]) == 6
        assert sum(each["part"] == "base" for each in found["shape"]) == 1


# -------------------------------------------------------------------------------------------- browser


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
    (page,) = sim.hints
    browser.open(page.removeprefix("page: "))
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
    assert text(shown, "title") == "UR10e"
    assert text(shown, "detail") == f"simulated, software 5.12.4, at {sim.host}"
    shown.until("document.getElementById('row-robot')?.textContent === 'RUNNING'")
    assert text(shown, "gauge-0-1-value") == "-89.95"
    assert (text(shown, "gauge-0-1-low"), text(shown, "gauge-0-1-high")) == ("-360", "360")
    assert text(shown, "row-safety") == "NORMAL"
    ink, _ = shown.until(f"(() => {{ const found = {INK}; return found[0] > 5000 && found; }})()")
    assert ink > 5000, "pixels that are drawn on"
    assert shown.run("location.hash") == "", "the token does not stay in the address"


def test_the_browsers_kinematics_meet_the_controllers_pose(shown, sim):
    outputs = sim.control.outputs("actual_q", "actual_TCP_pose")
    t = shown.run(
        "Promise.all([import('/chain.js'), fetch('/scene.json').then(r => r.json())])"
        f".then(([m, {{ chain }}]) => m.flange(chain, {outputs['actual_q']}))"
    )
    assert [t[3], t[7], t[11]] == pytest.approx(outputs["actual_TCP_pose"][:3], abs=1e-9)


def test_the_picture_moves_with_the_arm_and_with_the_mouse(shown, sim):
    shown.until(f"{INK}[0] > 5000")
    _, before = shown.run(INK)
    with socket.create_connection((sim.host, 30001)) as script:
        script.sendall(b"movej([0.8, -1.2, 1.2, -1.5, -1.5, 0.5], a=5, v=2)\n")
        shown.until("Number(document.getElementById('gauge-0-0-value').textContent) > 45")
    shown.until("Math.abs(Number(document.getElementById('gauge-0-0-rate').textContent)) < 0.01")
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
    eventually(lambda: shown.run(INK)[1] != after)


WITHIN = """[...document.querySelectorAll("#buttons button")].every((each) => {
  const { top, bottom, left, right } = each.getBoundingClientRect();
  return top >= 0 && left >= 0 && bottom <= innerHeight && right <= innerWidth;
})"""


PLACE = """(async () => {
  const [{ ArmPicture }, { IDENTITY, compose, flange, fromPose, reach, shape }] = await Promise.all([
    import("/arm.js"), import("/chain.js"),
  ]);
  const { chain } = await (await fetch("/scene.json")).json();
  const canvas = document.getElementById("picture");
  const picture = new ArmPicture(canvas, reach(chain));
  const q = [0, -1.57, 1.57, -1.57, -1.57, 0];
  const solids = shape(chain, q, IDENTITY, compose(flange(chain, q), fromPose([0, 0, 0.1, 0, 0, 0])));
  picture.hold(solids);
  const { project } = picture.view();
  const ends = solids.flatMap(({ from, to }) => [project(from), project(to)]);
  const [xs, ys] = [0, 1].map((k) => ends.map((end) => end[k] / [canvas.width, canvas.height][k]));
  return [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
})()"""


@pytest.mark.parametrize(("width", "height"), [(800, 600), (1280, 800), (390, 844)])
def test_the_buttons_and_the_whole_arm_are_in_sight(shown, width, height):
    shown.resize(width, height)
    try:
        assert shown.run("innerWidth") == width, "as wide as the screen, phones too"
        shown.until(WITHIN)
        assert shown.run("document.documentElement.scrollWidth") <= width
        shown.until(
            "document.getElementById('picture').width === document.getElementById('picture').clientWidth"
        )
        left, right, top, bottom = shown.run(PLACE)
        assert 0.0 < left < right < 1.0
        assert 0.0 < top < bottom < 1.0
        assert max(right - left, bottom - top) > 0.6, "it fills the picture"
        assert (left + right) / 2 == pytest.approx(0.5, abs=0.1)
        assert (top + bottom) / 2 == pytest.approx(0.5, abs=0.1)
    finally:
        shown.resize(960, 600)


PRESS = "[...document.querySelectorAll('button')].find(b => b.textContent === '{}').click()"


def test_a_button_lets_a_fault_begin_and_again_ends_it_and_another_ends_them_all(shown, sim):
    for end in ("safeguard stop", "end all faults"):
        shown.run(PRESS.format("safeguard stop"))
        shown.until("document.getElementById('row-safety').textContent === 'SAFEGUARD_STOP'")
        assert sim.control.status()["safety_mode"] == "SAFEGUARD_STOP"
        shown.until("document.querySelector('[data-kind=safeguard_stop]').ariaPressed === 'true'")
        shown.run(PRESS.format(end))
        shown.until("document.getElementById('row-safety').textContent === 'NORMAL'")
        shown.until("document.querySelector('[data-kind=safeguard_stop]').ariaPressed === 'false'")


def test_a_page_that_was_opened_without_the_token_only_looks(browser, sim):
    browser.run("location.protocol === 'http:' && sessionStorage.clear()")
    browser.open(f"http://{sim.host}:{sim.ports['web']}/")
    browser.until("document.querySelectorAll('button').length > 3")
    assert browser.run("[...document.querySelectorAll('button')].every((each) => each.disabled)")
    assert "by the address that the simulator told" in text(browser, "answer")


def test_the_page_says_when_the_simulator_has_ended(browser):
    with SIM.spawn(web=True, web_port=0) as own:
        browser.open(f"http://{own.host}:{own.ports['web']}/")
    browser.until("document.getElementById('link').textContent === 'no connection'")
