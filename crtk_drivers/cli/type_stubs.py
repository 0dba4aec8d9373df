"""The types of devices for type checkers and editors, made of the command table and of what plugins declare.

python -m crtk_drivers.cli.type_stubs            # writes crtk_drivers/front/kinds.pyi and local_devices.pyi
python -m crtk_drivers.cli.type_stubs --check    # 1 if one is out of date

`kinds.pyi` has a class for each kind of device, with the commands that devices of this kind may have.
`local_devices.pyi` has one for each device of this distribution: its kind, and what it has beyond CRTK; and
`connect`, which returns it for the name of its plugin.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from inspect import Parameter, getdoc, signature
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Final

from crtk_drivers import plugins
from crtk_drivers.cli.written_files import write_or_check, writer_parser
from crtk_drivers.commands import COMMANDS, FRAMES, Command, Level, Space, find
from crtk_drivers.config import from_values, load
from crtk_drivers.device import Device, DeviceKind
from crtk_drivers.device.device_kind import class_name
from crtk_drivers.device.offered import IN_OWN_BASE, in_frames, offered
from crtk_drivers.front import kinds, local
from crtk_drivers.front.base import PARTS
from crtk_drivers.front.method_forms import (
    Form,
    form_of,
    form_of_input,
    form_of_reading,
    form_of_service,
)
from crtk_drivers.plugins import DevicePlugin
from crtk_drivers.samples import VALUE_TYPES

_FOLDER: Final = Path(kinds.__file__).parent
KINDS: Final = _FOLDER / "kinds.pyi"
DEVICES: Final = _FOLDER / "local_devices.pyi"

_OPERATED: Final = ("operating_state", "state_command")
"""What `Operated` has."""

MOST_COLUMNS: Final = 100

_GENERATED: Final = (
    "# Written by `python -m crtk_drivers.cli.type_stubs`, from the command table.\n"
)


def _is_joint(command: Command) -> bool:
    return command.space is Space.JOINT or command.name.startswith("trajectory_j/")


def _is_cartesian(command: Command) -> bool:
    return command.space is Space.CARTESIAN or command.level is Level.QUERY


def _named(*names: str) -> Callable[[Command], bool]:
    return lambda command: command.name in names


@dataclass(frozen=True)
class _Has:
    """What a class of `crtk_drivers.front.kinds` has beside what its bases have.

    Attributes:
        commands: which rows of the command table.
        in_frames: it has its Cartesian commands in the sub-namespaces of frames, too.
        others: names of other commands, in sub-namespaces.
        parts: devices that may be behind it, and their classes.
    """

    commands: Callable[[Command], bool] = field(default_factory=_named)
    in_frames: bool = False
    others: tuple[str, ...] = ()
    parts: Mapping[str, str] = field(default_factory=dict)


_CLASSES: Final[Mapping[str, _Has]] = MappingProxyType(
    {
        "SomeDevice": _Has(),
        "InputDevice": _Has(),
        "Tracker": _Has(_named("measured_cp_array")),
        "ForceSensor": _Has(_named("measured_cf"), others=("raw/measured_cf",)),
        "Moving": _Has(_named("hold", "free", "use_gravity_compensation")),
        "JointMotion": _Has(_is_joint),
        "CartesianMotion": _Has(
            _is_cartesian, in_frames=True, others=("body/set_cf_orientation_absolute",)
        ),
        "Gripper": _Has(),
        "HapticDevice": _Has(parts={"gripper": "Gripper"}),
        "Arm": _Has(parts={"jaw": "Gripper", "gripper": "Gripper", "actuators": "JointMotion"}),
        "AnyDevice": _Has(),
    }
)

_SPACES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "local": "In the frame of the device's own base.",
        "body": "Along the axes of the tool, at the tool point.",
        "spatial": "Along the axes of the base frame, at its origin.",
        "raw": "As the sensor measures, without bias and filters.",
        "trajectory_j": "Which share of the limits of joints moves use.",
        "state": "What the device tells beyond CRTK.",
    }
)

_Methods = dict[str, Form]


def _commands_of(has: _Has) -> list[Command]:
    """Return the commands that a class adds."""
    own = [each for each in COMMANDS.values() if has.commands(each)]
    framed = [
        find(f"{frame}/{each.name}")
        for frame in FRAMES
        for each in own
        if has.in_frames
        and (frame in in_frames(each) or (frame == "local" and each.name in IN_OWN_BASE))
    ]
    return [*own, *framed, *map(find, has.others)]


def _methods(commands: Iterable[Command]) -> _Methods:
    """Return the forms of commands, with those of the parts of joint states."""
    methods: _Methods = {}
    for command in commands:
        methods[command.name] = form_of(command)
        for part, (whole, part_field) in PARTS.items():
            if whole == command.name:
                methods[part] = form_of(command, part_field)
    return methods


def kinds_text() -> str:
    """Return `kinds.pyi`."""
    classes: list[str] = []
    for name, has in _CLASSES.items():
        kind: type = getattr(kinds, name)
        bases = ", ".join(base.__name__ for base in kind.__bases__)
        parts = {part: (of, f"The device in `{part}/`.") for part, of in has.parts.items()}
        classes += _class(name, bases, kind.__doc__ or "", _methods(_commands_of(has)), parts)
        if name == "SomeDevice":
            classes.append(_CHILD)
    return _module("What each kind of device offers.", "".join(classes), _CLASSES)


def _module(doc: str, body: str, exported: Iterable[str]) -> str:
    """Return the text of a module: what `body` uses is imported."""
    used = set(re.findall(r"\w+", re.sub(r'""".*?"""', "", body, flags=re.DOTALL)))
    defined = set(re.findall(r"^class (\w+)", body, flags=re.MULTILINE))
    groups = []
    for group in _IMPORTS:
        lines = [
            _import(module, sorted(set(names) & used - defined, key=_as_sorted))
            for module, names in group.items()
        ]
        groups.append("".join(lines))
    listed = "".join(f'    "{name}",\n' for name in sorted(exported))
    head = "\n".join((f'"""{doc}"""\n', _GENERATED, *filter(None, groups)))
    return f"{head}\n__all__ = [\n{listed}]\n{body}"


def _as_sorted(name: str) -> tuple[bool, str]:
    return name[0].islower(), name


def _import(module: str, names: Sequence[str]) -> str:
    if not names:
        return ""
    line = f"from {module} import {', '.join(names)}\n"
    if len(line) <= MOST_COLUMNS + 1:
        return line
    return f"from {module} import (\n" + "".join(f"    {name},\n" for name in names) + ")\n"


_CHILD: Final = '''
    def child(self, name: str) -> AnyDevice:
        """Return a device behind this one, by the name of its sub-namespace."""
'''

_IMPORTS: Final[Sequence[Mapping[str, Sequence[str]]]] = (
    {
        "collections.abc": ["Mapping"],
        "pathlib": ["Path"],
        "typing": ["Any", "Literal", "Protocol", "overload"],
    },
    {"numpy.typing": ["ArrayLike"]},
    {
        "crtk_drivers.front.base": ["Operated"],
        "crtk_drivers.front.kinds": [each.value for each in DeviceKind],
        "crtk_drivers.front.local": ["LocalDevice", "LocalFront"],
        "crtk_drivers.front.payloads": ["JointsLike", "PoseLike", "TwistLike", "WrenchLike"],
        "crtk_drivers.motion.move": ["Move"],
        "crtk_drivers.samples": ["Vector", *(each.__name__ for each in VALUE_TYPES.values())],
    },
)
"""What the types of arguments and results are, and where they are."""


def devices_text() -> str:
    """Return `local_devices.pyi`.

    Raises:
        PluginError, MissingExtra, ConfigError: a device cannot be made.
    """
    entries = {
        name: entry.plugin
        for name, entry in sorted(plugins.devices().items())
        if entry.distribution == plugins.OWN_DISTRIBUTION
    }
    classes = [_device_class(plugin) for plugin in entries.values()]
    overloads = [_overload(f'Literal["{name}"]', class_name(name)) for name in entries]
    body = "".join(
        (*chain.from_iterable(classes), "\n", *overloads, _overload("str", "LocalDevice"))
    )
    exported = ("LocalDevice", "connect", *map(class_name, entries))
    return _module(
        "The devices of this distribution, and what `connect` returns for each.", body, exported
    )


def _device_class(plugin: DevicePlugin) -> list[str]:
    device = plugin.make(load(plugin.config, from_values(plugin.typical)))
    known = set(_names_of(plugin.kind))
    commands = [each for each in offered(device).values() if each.name not in known]
    methods = _methods(each for each in commands if each.name not in _OPERATED)
    children = {
        name: ("LocalDevice", f"The device in `{name}/`.")
        for name in device.children
        if name not in known
    }
    name = class_name(plugin.name)
    return _class(
        name,
        f"LocalFront, {plugin.kind.value}",
        f"{plugin.summary[0].upper()}{plugin.summary[1:]}.",
        {**methods, **_extras(device)},
        children,
    )


def _extras(device: Device) -> _Methods:
    return {
        **{name: form_of_service(each.summary) for name, each in device.services.items()},
        **{name: form_of_input(each.summary, each.payload) for name, each in device.inputs.items()},
        **{
            each.told_as(name): form_of_reading(each.summary, each.payload)
            for name, each in device.readings.items()
        },
    }


def _names_of(name: str) -> Iterator[str]:
    """Return the names of the commands and parts of a class, with those of its bases."""
    for each in getattr(kinds, name).__mro__:
        has = _CLASSES.get(each.__name__, _Has())
        yield from (command.name for command in _commands_of(has))
        yield from has.parts


def _class(
    name: str,
    bases: str,
    doc: str,
    methods: _Methods,
    properties: Mapping[str, tuple[str, str]],
) -> list[str]:
    """Return the text of a class, after those of its sub-namespaces."""
    spaces: dict[str, _Methods] = {}
    own: _Methods = {}
    for path, form in methods.items():
        space, slash, base = path.rpartition("/")
        (spaces.setdefault(space, {}) if slash else own)[base] = form
    before: list[str] = []
    all_properties = {**properties}
    for space, inner in spaces.items():
        inner_name = f"{name}{space.title().replace('_', '')}"
        text = _SPACES[space]
        before += _class(inner_name, "Protocol", text, inner, {})
        all_properties[space] = (inner_name, text)
    body = [f'\nclass {name}({bases}):\n    """{doc}"""\n']
    for prop, (kind, text) in all_properties.items():
        body.append(f'\n    @property\n    def {prop}(self) -> {kind}:\n        """{text}"""\n')
    body += (_method(each, form) for each, form in own.items())
    return [*before, "".join(body).replace(" ...\n\n    ", " ...\n    ")]


def _method(name: str, form: Form) -> str:
    parameters, returns = list(form.signature.parameters.values()), form.signature.return_annotation
    doc = _indented(form.doc, "        ")
    if not form.is_feedback:
        return "\n" + _head(name, parameters, returns, "    ") + f"\n{doc}"
    plain, stamped = _with_extra(parameters, "Literal[False]"), _with_extra(parameters, _STAMPED)
    return (
        f"\n    @overload\n{_head(name, plain, returns, '    ')}\n{doc}"
        f"    @overload\n{_head(name, stamped, f'tuple[{returns}, float]', '    ')} ...\n"
    )


_STAMPED: Final = "Literal[True]"


def _with_extra(parameters: Sequence[Parameter], annotation: str) -> list[Parameter]:
    """Return the parameters of feedback with `extra` of this type; without it there is no stamp."""
    *others, extra = (each.replace(annotation=str(each.annotation)) for each in parameters)
    extra = extra.replace(annotation=annotation)
    if annotation == _STAMPED:
        extra = extra.replace(default=Parameter.empty, kind=Parameter.KEYWORD_ONLY)
    return [*others, extra]


def _head(name: str, parameters: Sequence[Parameter], returns: str, indent: str = "") -> str:
    """Return ``def name(...) -> returns:``, in one line if there is room."""
    kinds_of_parameters = [each.kind for each in parameters]
    pieces = [str(each).replace("'", "") for each in parameters]
    if Parameter.KEYWORD_ONLY in kinds_of_parameters:
        pieces.insert(kinds_of_parameters.index(Parameter.KEYWORD_ONLY), "*")
    if Parameter.POSITIONAL_ONLY in kinds_of_parameters:
        pieces.append("/")
    pieces = ["self"] * bool(indent) + pieces
    line = f"{indent}def {name}({', '.join(pieces)}) -> {returns}:"
    if len(line) <= MOST_COLUMNS:
        return line
    lines = "".join(f"{indent}    {piece},\n" for piece in pieces)
    return f"{indent}def {name}(\n{lines}{indent}) -> {returns}:"


def _indented(doc: str, indent: str) -> str:
    first, *rest = doc.splitlines()
    if not rest:
        return f'{indent}"""{first}"""\n'
    lines = [f"{indent}{line}" if line else "" for line in rest]
    return "\n".join([f'{indent}"""{first}', *lines, f'{indent}"""\n'])


def _overload(name: str, returns: str) -> str:
    first, *others = signature(local.connect).parameters.values()
    head = _head("connect", [first.replace(annotation=name), *others], returns)
    body = f"\n{_indented(getdoc(local.connect) or '', '    ')}" if name == "str" else " ...\n"
    return f"@overload\n{head}{body}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, or check them; return the exit code."""
    module = __spec__.name
    parser = writer_parser(module, "Types of devices, for type checkers and editors.")
    options = parser.parse_args(arguments)
    texts = {KINDS: kinds_text(), DEVICES: devices_text()}
    return write_or_check(texts, only_check=options.check, module=module)


if __name__ == "__main__":
    sys.exit(main())
