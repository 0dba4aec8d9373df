"""Configuration: what is merged, and how every mistake is told (FAULTS I17, I19)."""

import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from crtk_drivers.cli.config_reference import rows, table_of
from crtk_drivers.config import (
    DeviceConfig,
    Interval,
    LimitsConfig,
    NodeConfig,
    Settings,
    from_assignments,
    from_file,
    from_values,
    load,
    with_node,
)
from crtk_drivers.config.file import MAX_SIZE, parse_toml, parse_yaml
from crtk_drivers.errors import ConfigError
from crtk_drivers.options import LimitPolicy
from rigs.examples import examples

Write = Callable[..., Path]


class ArmConfig(DeviceConfig):
    """A device with every kind of key."""

    host: str = Field(default="", description="Address of the arm.")
    rate: float = Field(default=125.0, gt=0.0, le=500.0, description="Of the cycle, in Hz.")
    axes: dict[str, Interval] = Field(default={}, description="Limits by name.")
    steps: tuple[Interval, ...] = Field(default=(), description="Limits by position.")


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def write_file(text: str | bytes, name: str = "arm.yaml") -> Path:
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write_file


def refusal(path: Path, *assignments: str, model: type = ArmConfig) -> str:
    with pytest.raises(ConfigError) as caught:
        load(model, from_file(path), from_assignments(model, assignments))
    return str(caught.value).replace(f"{path.parent}{os.sep}", "")


@pytest.mark.parametrize("key", ["open_timeout", "limits.max_step", "axes.a.lower"])
def test_a_flag_is_no_number(key: str) -> None:
    given = from_assignments(ArmConfig, [f"{key}=true", "axes.a.upper=1.0"])
    with pytest.raises(ConfigError, match=rf"{key}: must be a number, not true or false"):
        load(ArmConfig, given)


def test_a_flag_in_a_list_is_no_number() -> None:
    steps = from_values({"steps": [{"lower": 0.0, "upper": True}]})
    with pytest.raises(ConfigError, match=r"steps\[0\].upper: must be a number"):
        load(ArmConfig, steps)


def test_later_layers_override_earlier_ones(write: Write) -> None:
    path = write("host: from-file\nrate: 100\nlimits:\n  max_step: 0.2\n  clamp_servo: no\n")
    config = load(
        ArmConfig,
        from_file(path),
        from_values({"host": "from-values"}),
        from_assignments(ArmConfig, ["limits.max_step=0.3", "limits.max_step=0.4"]),
    )
    assert (config.host, config.rate) == ("from-values", 100.0)
    assert config.limits == LimitsConfig(max_step=0.4, clamp_servo=False)
    assert config.open_timeout == 5.0


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.yaml", "host: h\nlimits: {max_step: 0.2}\n"),
        ("a.yml", "# only\nhost: h\nlimits:\n  max_step: 2e-1\n"),
        ("a.toml", 'host = "h"\n[limits]\nmax_step = 0.2\n'),
        ("b.toml", 'limits.max_step = 0.2\nhost = "h"\n'),
        ("bom.yaml", "\ufeffhost: h\nlimits: {max_step: 0.2}\n"),
    ],
)
def test_both_formats_say_the_same(write: Write, name: str, text: str) -> None:
    config = load(ArmConfig, from_file(write(text, name)))
    assert (config.host, config.limits.max_step) == ("h", 0.2)


def test_an_empty_file_leaves_the_defaults(write: Write) -> None:
    assert load(ArmConfig, from_file(write("# nothing\n"))) == ArmConfig()


def test_text_keys_take_text_that_looks_like_something_else() -> None:
    layer = from_assignments(ArmConfig, ["host=10", "on_stream_timeout=fault", "rate=1e2"])
    config = load(ArmConfig, layer)
    assert (config.host, config.on_stream_timeout, config.rate) == ("10", "fault", 100.0)


def test_an_optional_key_can_be_taken_back() -> None:
    path = {"limits": {"max_command_age": 1.0}}
    layer = from_assignments(ArmConfig, ["limits.max_command_age=null"])
    assert load(ArmConfig, from_values(path), layer).limits.max_command_age is None


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        pytest.param(
            "host: a\nlimits:\n  max_stepp: 1\n",
            ["arm.yaml:3: limits.max_stepp: unknown key", "Did you mean 'limits.max_step'?"],
            id="unknown key",
        ),
        pytest.param(
            "max_step: 0.2", ["arm.yaml:1", "Did you mean 'limits.max_step'?"], id="wrong table"
        ),
        pytest.param("zzz: 1", ["arm.yaml:1", "zzz", "Known keys: name,"], id="no idea"),
        pytest.param(
            "\n\nrate: fast", ["arm.yaml:3: rate: must be a number, not 'fast'"], id="wrong type"
        ),
        pytest.param("host: 5", ["arm.yaml:1: host: must be text (in quotes), not 5"], id="text"),
        pytest.param("limits: 5", ["arm.yaml:1: limits: must be a table of keys"], id="table"),
        pytest.param(
            "on_stream_timeout: hald",
            ["must be 'hold', 'pause' or 'fault'", "Did you mean 'hold'?"],
            id="choice",
        ),
        pytest.param("rate: -125", ["arm.yaml:1: rate: must be greater than 0"], id="negative"),
        pytest.param("rate: .nan", ["rate: must be a finite number, not nan"], id="NaN"),
        pytest.param("rate: .inf", ["rate: must be a finite number, not inf"], id="infinite"),
        pytest.param(
            "axes:\n  elbow:\n    lower: 1.0\n    upper: -1.0\n",
            ["arm.yaml:2: axes.elbow: lower (1) must be below upper (-1)"],
            id="min > max",
        ),
        pytest.param(
            "steps:\n  - {lower: 0, upper: 1}\n  - {lower: 0, uper: 1}\n",
            ["arm.yaml:3: steps[1].uper: unknown key. Did you mean 'steps[1].upper'?"],
            id="in a list",
        ),
        pytest.param(
            "axes:\n  a: {lower: .nan, upper: 1}", ["axes.a.lower", "finite"], id="NaN limit"
        ),
        pytest.param(
            "host: a\nrate: 1\nhost: b\n",
            ["arm.yaml:3: the key 'host' is given twice, first on line 1"],
            id="duplicate",
        ),
        pytest.param(
            "axes:\n  a: {lower: 0, upper: 1}\n  a: {lower: 0, upper: 2}\n",
            ["arm.yaml:3: the key 'axes.a' is given twice"],
            id="inner duplicate",
        ),
        pytest.param("5: a", ["arm.yaml:1: the key '5' is not text"], id="key is a number"),
        pytest.param("- host", ["arm.yaml: holds no keys"], id="list"),
        pytest.param("host: [1\n", ["arm.yaml:2: not valid YAML"], id="syntax"),
        pytest.param("a: 1\n---\nb: 1", ["not valid YAML"], id="two documents"),
        pytest.param(
            "a: &a [1]\nb: *a\n", ["arm.yaml:2", "anchors and aliases"], id="billion laughs"
        ),
        pytest.param(
            "a: !!python/object/apply:os.system [ls]",
            ["arm.yaml:1", "could not determine a constructor"],
            id="code",
        ),
        pytest.param("a: " + "[" * 20_000, ["is nested too deeply"], id="deep"),
        pytest.param("a: 2026-13-45", ["impossible value"], id="impossible date"),
        pytest.param("a: \x01", ["not valid YAML"], id="control character"),
        pytest.param(b"a: 1\nb: \xff", ["arm.yaml:2: is not UTF-8 text"], id="not text"),
        pytest.param("#" * (MAX_SIZE + 1), ["bytes; a configuration has at most"], id="huge"),
    ],
)
def test_mistakes_in_yaml(write: Write, text: str | bytes, parts: list[str]) -> None:
    message = refusal(write(text))
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        pytest.param(
            'host = "a"\n\n[limits]\n# one\nmax_stepp = 1\n',
            ["arm.toml:5: limits.max_stepp: unknown key", "'limits.max_step'"],
            id="unknown key",
        ),
        pytest.param("limits.max_step = nan", ["arm.toml:1", "finite number"], id="NaN"),
        pytest.param("limits = {max_step = -1}", ["arm.toml:1", "greater than 0"], id="inline"),
        pytest.param(
            "[[steps]]\nlower = 0\nupper = 1\n[[steps]]\nlower = 2\nupper = 1\n",
            ["arm.toml:4: steps[1]: lower (2) must be below upper (1)"],
            id="array of tables",
        ),
        pytest.param("rate = 1\nrate = 2\n", ["arm.toml:2: not valid TOML"], id="duplicate"),
        pytest.param("rate = 1\nhost = \n", ["arm.toml:2: not valid TOML"], id="syntax"),
        pytest.param("a = " + "[" * 20_000, ["is nested too deeply"], id="deep"),
    ],
)
def test_mistakes_in_toml(write: Write, text: str, parts: list[str]) -> None:
    message = refusal(write(text, "arm.toml"))
    for part in parts:
        assert part in message


def test_all_mistakes_are_told_at_once(write: Write) -> None:
    message = refusal(write("rate: -1\nhots: a\n"), "limits.max_step=7")
    assert message.startswith("3 mistakes")
    assert "arm.yaml:1: rate" in message
    assert "arm.yaml:2: hots: unknown key. Did you mean 'host'?" in message
    assert "--set limits.max_step=7: limits.max_step: must be less than or equal to 1" in message


def test_a_required_key_is_asked_for(write: Write) -> None:
    class Needy(DeviceConfig):
        port: int = Field(description="Serial port number.")

    assert refusal(write("name: a"), model=Needy) == (
        "arm.yaml: port: is required. Serial port number."
    )


@pytest.mark.parametrize("assignment", ["rate", "=1", "limits.=1", ".rate=1"])
def test_an_assignment_without_key_or_value(assignment: str) -> None:
    with pytest.raises(ConfigError, match="is not of the form key=value"):
        from_assignments(ArmConfig, [assignment])


def test_an_assignment_into_a_scalar_is_told_not_lost() -> None:
    layer = from_assignments(ArmConfig, ["rate=5", "rate.x=1"])
    with pytest.raises(ConfigError, match=r"--set rate\.x=1: rate: must be a number"):
        load(ArmConfig, layer)


def make_directory(path: Path) -> Path:
    path.mkdir()
    return path


def make_pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: path, "No such file"),
        (make_directory, "is a directory"),
        (make_pipe, "is not a regular file"),
        (lambda path: path.with_suffix(".json"), "not a known kind of configuration file"),
    ],
    ids=["missing", "directory", "pipe", "suffix"],
)
def test_what_is_no_file(tmp_path: Path, make: Callable[[Path], Path], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        from_file(make(tmp_path / "arm.yaml"))


def test_a_configuration_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="frozen"):
        ArmConfig().rate = 5.0


def test_the_node_has_a_table_of_its_own() -> None:
    config = load(with_node(ArmConfig), from_values({"rate": 5, "node": {"tf_rate": 0}}))
    assert isinstance(config, ArmConfig)
    assert config.node == NodeConfig(tf_rate=0.0)  # type: ignore[attr-defined]
    with pytest.raises(ConfigError, match=r"Did you mean 'node\.tf_rate'"):
        load(with_node(ArmConfig), from_values({"node": {"tf_rat": 0}}))


def test_limits_have_the_defaults_of_the_core() -> None:
    assert LimitPolicy(**LimitsConfig().model_dump()) == LimitPolicy()


@dataclass(frozen=True, kw_only=True)
class SimOptions:
    model: str = field(default="a1", metadata={"help": "arm to simulate", "choices": ("a1", "a2")})
    port: int = field(default=0, metadata={"help": "port"})

    def __post_init__(self) -> None:
        if self.port < 0:
            raise ValueError(f"port must not be negative, but is {self.port}")


def test_a_dataclass_is_judged_like_a_model() -> None:
    options = load(SimOptions, from_assignments(SimOptions, ["port=5", "model=7"], "--sim-set"))
    assert options == SimOptions(port=5, model="7")
    for assignment, message in (
        ("prot=5", "prot: unknown key. Did you mean 'port'"),
        ("port=x", "port: must be a whole number, not 'x'. port"),
        ("port=-1", "port must not be negative"),
    ):
        with pytest.raises(ConfigError, match=message):
            load(SimOptions, from_assignments(SimOptions, [assignment], "--sim-set"))


KEYS = st.sampled_from(["host", "rate", "limits", "max_step", "axes", "steps", "name", "x"])
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS, inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(KEYS, VALUES, max_size=5))
def test_any_values_give_a_configuration_or_one_error(values: dict[str, object]) -> None:
    try:
        config = load(ArmConfig, from_values(values))
    except ConfigError:
        return
    assert 0.0 < config.rate <= 500.0
    assert math.isfinite(config.limits.max_step)


@settings(max_examples=examples(300))
@given(st.text(alphabet="ab:=[]{}&*!|>-\"'#\n \t.,0~?%@", max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    for parse in (parse_yaml, parse_toml):
        try:
            content = parse(text, "f")
        except ConfigError:
            continue
        lines = text.count("\n") + 1
        assert all(1 <= line <= lines for line in content.lines.values())


def test_tables_by_name_and_in_lists_are_told_with_their_keys() -> None:
    class Wall(Settings):
        stiffness: float = Field(description="In N/m.")

    class Room(Settings):
        walls: tuple[Wall, ...] = Field(default=(), description="What there is.")
        doors: dict[str, Wall] = Field(default={}, description="By name.")
        names: dict[str, int] = Field(default={}, description="No tables.")

    keys = [row.key for row in rows(Room.model_json_schema())]
    assert keys == ["walls", "walls[].stiffness", "doors", "doors.NAME.stiffness", "names"]


def test_the_schema_names_every_key_and_is_json() -> None:
    schema = json.loads(json.dumps(with_node(ArmConfig).model_json_schema()))
    keys = [row.key for row in rows(schema)]
    assert set(ArmConfig.model_fields) <= set(keys)
    assert {"limits.max_step", "node.publish_rate"} <= set(keys)
    assert schema["additionalProperties"] is False


def test_the_reference_table() -> None:
    class Small(Settings):
        speed: float | None = Field(default=None, gt=0.0, le=2.0, description="In m/s.")
        limits: LimitsConfig = Field(default=LimitsConfig(), description="Of commands.")

    lines = table_of(Small).splitlines()
    assert lines[2] == "| `speed` | number > 0, ≤ 2 or null |  | In m/s. |"
    assert lines[3] == "| `limits` | table |  | Of commands. |"
    assert "| `limits.clamp_servo` | true or false | true |" in lines[4]


def test_every_key_is_described() -> None:
    for row in rows(with_node(DeviceConfig).model_json_schema()):
        assert row.description, row.key
