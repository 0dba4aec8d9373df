"""The types that a type checker sees are those of the command table and of the devices."""

import ast
from collections.abc import Iterator, Mapping

import pytest

from crtk_drivers import plugins
from crtk_drivers.cli import type_stubs
from crtk_drivers.config import from_values, load
from crtk_drivers.device.device_kind import DeviceKind, class_name
from crtk_drivers.device.offered import offered
from crtk_drivers.front import base, kinds

OWN = {
    name: entry
    for name, entry in plugins.devices().items()
    if entry.distribution == plugins.OWN_DISTRIBUTION
}


def test_the_types_are_up_to_date() -> None:
    assert type_stubs.main(["--check"]) == 0


def classes() -> Mapping[str, ast.ClassDef]:
    texts = (type_stubs.KINDS.read_text(), type_stubs.DEVICES.read_text())
    return {
        node.name: node
        for text in texts
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef)
    }


CLASSES = classes()


def names_in(name: str) -> Iterator[str]:
    """The names that a class has for a type checker, with those of its bases and sub-namespaces."""
    node = CLASSES.get(name)
    if node is None:
        yield from vars(getattr(base, name, object))
        return
    for member in node.body:
        if isinstance(member, ast.FunctionDef):
            yield member.name
            inner = member.returns.id if isinstance(member.returns, ast.Name) else ""
            if any(getattr(each, "id", "") == "property" for each in member.decorator_list):
                yield from (f"{member.name}/{each}" for each in names_in(inner))
    for each in node.bases:
        yield from names_in(ast.unparse(each))


@pytest.mark.parametrize("name", OWN)
def test_a_class_has_all_that_its_device_offers(name: str) -> None:
    plugin = OWN[name].plugin
    device = plugin.make(load(plugin.config, from_values(plugin.typical)))
    told = {reading.told_as(each) for each, reading in device.readings.items()}
    needed = {*offered(device), *device.services, *device.inputs, *told, *device.children}
    assert needed <= set(names_in(class_name(name)))


def test_a_sensor_has_no_command_that_moves() -> None:
    for kind in (DeviceKind.FORCE_SENSOR, DeviceKind.TRACKER, DeviceKind.INPUT):
        assert not [each for each in names_in(kind) if each.startswith(("move_", "servo_"))]


def test_each_kind_exists_at_run_time_with_the_same_bases() -> None:
    for kind in DeviceKind:
        bases = [ast.unparse(each) for each in CLASSES[kind].bases]
        assert [each.__name__ for each in getattr(kinds, kind).__bases__] == bases


def test_a_file_that_is_out_of_date_is_told_and_written(
    tmp_path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for constant in ("KINDS", "DEVICES"):
        monkeypatch.setattr(type_stubs, constant, tmp_path / f"{constant}.pyi")
    assert type_stubs.main(["--check"]) == 1
    assert "type_stubs" in capsys.readouterr().err
    assert type_stubs.main([]) == 0
    assert type_stubs.main(["--check"]) == 0
