"""Plugins come through real entry points of real distributions, hostile ones included (FAULTS I20)."""

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import main
from crtk_drivers.config import from_values
from crtk_drivers.errors import ConfigError, ConnectionFailed, MissingExtra, PluginError
from crtk_drivers.plugins.sim_plugin import start_sim

GOOD = """
from crtk_drivers.config import DeviceConfig
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
PLUGIN = DevicePlugin("{name}", "a good one", LoopbackConfig, LoopbackDevice)
"""

SIM = """
from dataclasses import dataclass, field
@dataclass
class Config:
    port: int = field(default=1, metadata={"help": "a port"})
class Sim:
    name = "toy"
    summary = "starts nothing"
    Config = Config
    def spawn(self, config):
        raise RuntimeError(f"port {config.port} is in use")
SIM = Sim()
"""


class Site:
    """A directory of installed distributions, in front of the others."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.modules: list[str] = []

    def install(
        self,
        name: str,
        modules: Mapping[str, str],
        devices: Mapping[str, str] | None = None,
        sims: Mapping[str, str] | None = None,
        pages: Mapping[str, str] | None = None,
        requires: str = "",
    ) -> None:
        for module, text in modules.items():
            (self.path / f"{module}.py").write_text(text)
            self.modules.append(module)
        info = self.path / f"{name.replace('-', '_')}-1.2.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.2\n{requires}"
        )
        groups = {
            plugins.DEVICES: devices or {},
            plugins.SIMS: sims or {},
            plugins.PAGES: pages or {},
        }
        (info / "entry_points.txt").write_text(
            "".join(
                f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in entries.items())
                for group, entries in groups.items()
            )
        )


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delenv(plugins.ONLY, raising=False)
    made = Site(tmp_path)
    yield made
    for module in made.modules:
        sys.modules.pop(module, None)


def test_a_strangers_device_is_found_and_made(site: Site) -> None:
    site.install("acme-arm", {"acme": GOOD.format(name="acme")}, {"acme": "acme:PLUGIN"})
    entry = plugins.devices()["acme"]
    assert (entry.distribution, entry.version, entry.error) == ("acme-arm", "1.2", None)
    plugin = plugins.device("acme")
    config = plugin.load_config({"rate": 50}, {"address": "here"})
    assert plugin.create(config).address == "here"
    assert plugins.commands_of("acme")["servo_jp"].units == "rad or m"


def test_finding_imports_nothing(site: Site) -> None:
    site.install("acme-arm", {"acme": GOOD.format(name="acme")}, {"acme": "acme:PLUGIN"})
    assert "acme" in plugins.devices()
    assert "acme" not in sys.modules
    assert plugins.devices()["acme"].error is None
    assert "acme" in sys.modules


HOSTILE = {
    "raises": ("raise ZeroDivisionError('at import')", "ZeroDivisionError: at import"),
    "exits": ("raise SystemExit(3)", "SystemExit: 3"),
    "syntax": ("def broken(:", "SyntaxError"),
    "nothing": ("", "has no attribute 'PLUGIN'"),
    "number": ("PLUGIN = 5", "a DevicePlugin is needed, not int"),
    "options": (
        "from crtk_drivers.plugins import Tool\n"
        "from crtk_sim_backends.kit import Options\n"
        "Tool('info', 'shows it', print, Options)",
        "tool 'info': the options Options must be a class derived from Settings",
    ),
    "liar": (GOOD.format(name="honest"), "it calls itself 'honest'"),
    "config": (
        GOOD.format(name="config") + "object.__setattr__(PLUGIN, 'config', dict)",
        "no subclass of DeviceConfig",
    ),
    "base": ("class Odd(BaseException): pass\nraise Odd('odd')", "Odd: odd"),
}


def test_hostile_plugins_are_broken_and_harm_nobody(site: Site) -> None:
    texts = {f"hostile_{name}": text for name, (text, _) in HOSTILE.items()}
    points = {name: f"hostile_{name}:PLUGIN" for name in HOSTILE}
    site.install("hostile", texts, points)
    site.install("acme-arm", {"acme": GOOD.format(name="acme")}, {"acme": "acme:PLUGIN"})
    found = plugins.devices()
    for name, (_, message) in HOSTILE.items():
        assert message in found[name].traceback, name
        assert "Traceback" in found[name].traceback or name == "syntax"
        with pytest.raises(PluginError, match=f"the plugin '{name}' of hostile cannot be loaded"):
            plugins.device(name)
        assert plugins.commands_of(name) == {}
    assert plugins.device("acme").summary == "a good one"


BROKEN_INSIDE = """
from crtk_drivers.config import DeviceConfig
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
class Odd(LoopbackDevice):
    @property
    def {part}(self):
        raise ZeroDivisionError("at [/red] {part}")
PLUGIN = DevicePlugin("{name}", "made, and broken", LoopbackConfig, Odd)
"""


@pytest.mark.parametrize("part", ["capabilities", "children", "services", "inputs", "readings"])
def test_a_device_that_is_broken_inside_harms_nobody(
    site: Site, part: str, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"odd_{part}"
    site.install(
        "odd", {name: BROKEN_INSIDE.format(name=name, part=part)}, {name: f"{name}:PLUGIN"}
    )
    site.install("acme-arm", {"acme": GOOD.format(name="acme")}, {"acme": "acme:PLUGIN"})
    assert "servo_jp" in plugins.commands_of("acme")
    plugins.commands_of(name)  # which raises nothing
    assert main(["list"]) == 0
    capsys.readouterr()
    assert main(["list", name]) == 1
    shown = capsys.readouterr()
    told = f"{name}: what it offers cannot be shown: ZeroDivisionError: at [/red] {part}"
    assert told in shown.out
    assert "Traceback" not in shown.out + shown.err
    assert main(["list", "acme"]) == 0


WITH_BRACKETS = """
from crtk_drivers.config import DeviceConfig
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.commands import Payload
from crtk_drivers.device import Reading, Service
from crtk_drivers.testing.loopback import LoopbackConfig, LoopbackDevice
class Bracketed(LoopbackDevice):
    @property
    def services(self):
        return {"zero": Service("zero it [/red] now", lambda: None)}
    @property
    def readings(self):
        return {"gap": Reading("how wide it is [mm]", Payload.NUMBER, lambda: 0.0)}
PLUGIN = DevicePlugin("brackets", "one", LoopbackConfig, Bracketed)
"""


def test_texts_of_a_device_are_no_markup(site: Site, capsys: pytest.CaptureFixture[str]) -> None:
    site.install("brackets", {"brackets": WITH_BRACKETS}, {"brackets": "brackets:PLUGIN"})
    assert main(["list", "brackets"]) == 0
    shown = capsys.readouterr().out
    assert "zero it [/red] now" in shown
    assert "how wide it is [mm]" in shown


def test_an_interrupt_while_loading_stays_an_interrupt(site: Site) -> None:
    site.install("slow", {"slow": "raise KeyboardInterrupt"}, {"slow": "slow:PLUGIN"})
    entry = plugins.devices()["slow"]
    with pytest.raises(KeyboardInterrupt):
        _ = entry.error


def test_nobody_gets_a_name_that_two_strangers_claim(site: Site) -> None:
    for owner in ("one", "two"):
        site.install(f"{owner}-arm", {owner: GOOD.format(name="arm")}, {"arm": f"{owner}:PLUGIN"})
    found = plugins.devices()
    assert {"arm", "arm@one-arm", "arm@two-arm"} <= set(found)
    with pytest.raises(PluginError, match="one-arm and two-arm both bring a plugin named 'arm'"):
        plugins.device("arm")
    assert "one" not in sys.modules


def test_a_stranger_cannot_take_a_name_of_ours(site: Site) -> None:
    site.install("crtk-drivers", {"ours": GOOD.format(name="arm")}, {"arm": "ours:PLUGIN"})
    site.install("alien", {"alien": "raise SystemExit"}, {"arm": "alien:PLUGIN"})
    found = plugins.devices()
    assert found["arm"].distribution == "crtk-drivers"
    assert found["arm"].error is None
    assert "both bring" in str(found["arm@alien"].error)
    assert "arm@crtk-drivers" not in found
    assert "alien" not in sys.modules


def test_the_allow_list(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {name: GOOD.format(name=name) for name in ("aa", "bb")}
    site.install("both", texts, {"aa": "aa:PLUGIN", "bb": "bb:PLUGIN"})
    monkeypatch.setenv(plugins.ONLY, "aa, cc")
    assert set(plugins.devices()) == {"aa"}
    with pytest.raises(PluginError, match="CRTK_DRIVERS_ONLY allows no others"):
        plugins.device("bb")


def test_an_unknown_name_brings_a_suggestion(site: Site) -> None:
    site.install("acme-arm", {"acme": GOOD.format(name="acme")}, {"acme": "acme:PLUGIN"})
    with pytest.raises(PluginError, match=r"no device 'acmee'.* Did you mean 'acme'\?"):
        plugins.device("acmee")
    with pytest.raises(PluginError, match="no simulator 'acme'"):
        plugins.simulator("acme")


def test_a_missing_library_of_an_extra_gives_the_command(site: Site) -> None:
    requires = "Provides-Extra: arm\nRequires-Dist: no-such-library>=1; extra == 'arm'\n"
    site.install(
        "acme-arm", {"acme": "import no_such_library"}, {"acme": "acme:PLUGIN"}, requires=requires
    )
    with pytest.raises(MissingExtra) as caught:
        plugins.device("acme")
    assert caught.value.remedy == "Install it with: pip install 'acme-arm[arm]'"


def test_libraries_that_are_imported_late_are_known_to_be_missing(site: Site) -> None:
    requires = "Provides-Extra: arm\nRequires-Dist: no-such-library ; extra == 'arm'\n"
    text = GOOD.format(name="acme") + "object.__setattr__(PLUGIN, 'extra', 'arm')"
    site.install("acme-arm", {"acme": text}, {"acme": "acme:PLUGIN"}, requires=requires)
    entry = plugins.devices()["acme"]
    assert entry.error is None
    assert entry.missing is not None
    assert entry.missing.remedy == "Install it with: pip install 'acme-arm[arm]'"


def test_a_simulator_that_does_not_start(site: Site) -> None:
    site.install("toys", {"toys": SIM}, sims={"toy": "toys:SIM"})
    plugin = plugins.simulator("toy")
    with pytest.raises(ConnectionFailed, match="did not start: port 7 is in use"):
        start_sim(plugin, from_values({"port": 7}))
    with pytest.raises(ConfigError, match="prot: unknown key"):
        start_sim(plugin, from_values({"prot": 7}))


def test_what_is_no_simulator(site: Site) -> None:
    site.install("toys", {"toys": "class SIM:\n    name = 'toy'"}, sims={"toy": "toys:SIM"})
    with pytest.raises(PluginError, match="it lacks summary, Config, spawn"):
        plugins.simulator("toy")


def test_what_is_no_page(site: Site) -> None:
    site.install("toys", {"toys": "class PAGE:\n    name = 'toy'"}, pages={"toy": "toys:PAGE"})
    assert "it lacks summary, serve" in str(plugins.pages()["toy"].error)
    assert plugins.page().name == "web", "which is ours, and sound"


def test_a_former_name_of_a_simulator_finds_it() -> None:
    assert plugins.simulator("netft").name == "ati-netft"
