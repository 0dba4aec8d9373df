"""Options made from a configuration class: one for each scalar key, none of them typed twice.

All of them arrive as text (flags as booleans) and are judged by `crtk_drivers.config.load`, so that a
mistake reads the same in a file and on the command line.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_origin

import typer
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from crtk_drivers.cli.help_pages import HelpfulCommand, HelpfulGroup, completed_from
from crtk_drivers.cli.terminal import plain, sentence
from crtk_drivers.config import Layer, typed_value
from crtk_drivers.config.keys import annotation_of, choices_of, description_of, setting_names
from crtk_drivers.ros.names import suggestion

Parameters = Sequence[inspect.Parameter]

SETTING_PREFIX = "setting_"
"""Before the parameter of a setting: a device may have a key with the name of one of our options."""

_METAVARS: Mapping[type, str] = types.MappingProxyType(
    {float: "NUMBER", int: "INTEGER", str: "TEXT", Path: "FILE"}
)


@dataclass(frozen=True)
class Setting:
    """One scalar key of a configuration, as the command line sees it."""

    name: str
    annotation: Any
    default: Any
    description: str
    choices: tuple[str, ...]

    @property
    def option(self) -> str:
        """As it is typed: ``--open-timeout``."""
        return "--" + self.name.replace("_", "-")

    @property
    def metavar(self) -> str:
        """What its value is."""
        if len(self.choices) in range(1, 6):
            return "|".join(self.choices)
        return _METAVARS.get(self.annotation, "VALUE")

    @property
    def help(self) -> str:
        """Description and default, for rich."""
        text = sentence(self.description)
        if len(self.choices) > 5:
            text += plain(f" One of {', '.join(self.choices)}.")
        if self.default in (None, ""):
            return text
        default = _text(self.default)
        return f"{text} [dim]{plain(f'[default: {default}]')}[/dim]"


def _text(default: Any) -> str:
    if isinstance(default, bool):
        return "yes" if default else "no"
    return f"{default:g}" if isinstance(default, float) else str(default)


def scalar_settings(model: type) -> Iterator[Setting]:
    """Yield the keys of a configuration class or dataclass that hold one value."""
    for name in setting_names(model):
        annotation = annotation_of(model, (name,))
        choices = choices_of(annotation) or _metadata_choices(model, name)
        if choices or _is_scalar(annotation):
            yield Setting(
                name,
                annotation,
                _default(model, name),
                description_of(model, (name,)),
                tuple(map(str, choices)),
            )


def _is_scalar(annotation: Any) -> bool:
    if get_origin(annotation) is not None:
        return all(_is_scalar(part) for part in get_args(annotation)) and not isinstance(
            get_origin(annotation), type
        )
    if hasattr(annotation, "SHORTHAND"):
        return True
    return isinstance(annotation, type) and issubclass(annotation, str | int | float | Path | Enum)


def _metadata_choices(model: type, name: str) -> tuple[str, ...]:
    fields: Mapping[str, Any] = getattr(model, "__dataclass_fields__", {})
    return tuple(fields[name].metadata.get("choices", ())) if name in fields else ()


def _default(model: type, name: str) -> Any:
    if issubclass(model, BaseModel):
        default = model.model_fields[name].default
        return None if default is PydanticUndefined else default
    fields: Mapping[str, Any] = getattr(model, "__dataclass_fields__", {})
    default = fields[name].default
    return None if default is MISSING else default


def option(name: str, annotation: Any, default: Any, *names: str, **more: Any) -> inspect.Parameter:
    """Return a parameter for `make_command`: an option with its names, help, panel, metavar."""
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        annotation=annotation,
        default=typer.Option(default, *names, **more),
    )


def namespace_option(device: str) -> inspect.Parameter:
    """Return the option ``--ns`` of a command for a device."""
    namespace = suggestion(f"/{device}")
    return option(
        "ns",
        str,
        namespace,
        "--ns",
        metavar="NAMESPACE",
        help="ROS namespace of the device: its topics are NAMESPACE/measured_js, ... "
        f"[dim]\\[default: {namespace}][/dim]",
        show_default=False,
    )


def setting_options(
    model: type,
    panel_of: Callable[[str], str],
    reserved: Collection[str] = (),
    prefix: str = SETTING_PREFIX,
    positional: Sequence[str] = (),
) -> Parameters:
    """Return one option for each scalar key of `model` that is not `reserved` for another option.

    `prefix` keeps the options of several models of one command apart; the keys `positional` are arguments,
    given in this order without their names.
    """
    settings = {setting.name: setting for setting in scalar_settings(model)}
    parameters = [_argument(prefix, settings.pop(name)) for name in positional]
    for setting in settings.values():
        if setting.option in reserved:
            continue
        is_flag = setting.annotation is bool
        names = setting.option
        if is_flag:
            names += f"/--no-{setting.option.removeprefix('--')}"
        parameters.append(
            option(
                prefix + setting.name,
                bool | None if is_flag else str | None,
                None,
                names,
                help=setting.help,
                metavar=None if is_flag else setting.metavar,
                rich_help_panel=panel_of(setting.name),
                autocompletion=completed_from(partial(tuple, setting.choices)),
            )
        )
    return parameters


def _argument(prefix: str, setting: Setting) -> inspect.Parameter:
    """Return an argument of the command line; whether it is needed is judged with the other settings."""
    return inspect.Parameter(
        prefix + setting.name,
        inspect.Parameter.KEYWORD_ONLY,
        annotation=str | None,
        default=typer.Argument(
            None, help=setting.help, metavar=setting.name.upper(), show_default=False
        ),
    )


def given_settings(model: type, given: Mapping[str, Any], prefix: str = SETTING_PREFIX) -> Layer:
    """Return the layer of the settings that were given as options of their own.

    Args:
        model: that `setting_options` was called with.
        given: the arguments of the command's function.
        prefix: that `setting_options` was called with.

    Raises:
        ConfigError: a value cannot be read.
    """
    values: dict[str, Any] = {}
    places: dict[tuple[str | int, ...], str] = {}
    for setting in scalar_settings(model):
        value = given.get(prefix + setting.name)
        if value is None:
            continue
        if isinstance(value, str):
            value = typed_value(model, (setting.name,), value, setting.option)
        values[setting.name] = value
        places[setting.name,] = setting.option
    return Layer(values, "command line", places)


def make_command(
    name: str, run: Callable[..., int], parameters: Parameters, *, help: str, panel: str
) -> Any:
    """Return the click command `name` that calls `run` with the parameters as keywords.

    What `run` returns is the exit code. The type is that of whichever click typer brings.
    """

    app = typer.Typer(add_completion=False, rich_markup_mode="rich")
    function = _function(run, parameters)
    app.command(name=name, help=help, rich_help_panel=panel, cls=HelpfulCommand)(function)
    return typer.main.get_command(app)


@dataclass(frozen=True)
class SubCommand:
    """A command of a group made by `make_group`: see `make_command`."""

    name: str
    run: Callable[..., int]
    parameters: Parameters
    help: str


def make_group(
    name: str,
    run: Callable[..., int],
    parameters: Parameters,
    commands: Sequence[SubCommand],
    *,
    help: str,
    panel: str,
) -> Any:
    """Return a click group that is a command by itself, as of `make_command`, and has commands below it."""
    app = typer.Typer(
        name=name,
        cls=HelpfulGroup,
        help=help,
        invoke_without_command=True,
        add_completion=False,
        rich_markup_mode="rich",
    )

    def itself(context: typer.Context, **given: Any) -> int:
        return 0 if context.invoked_subcommand else run(context=context, **given)

    app.callback()(_function(itself, parameters, ends=False))
    for each in commands:
        app.command(name=each.name, help=each.help, cls=HelpfulCommand)(
            _function(each.run, each.parameters)
        )
    group: Any = typer.main.get_command(app)
    group.rich_help_panel = panel  # typer keeps that of a command only
    return group


def _function(
    run: Callable[..., int], parameters: Parameters, ends: bool = True
) -> Callable[..., None]:
    """Return a function with these parameters for typer; `ends`: nothing may follow a run that succeeds."""

    def function(**given: Any) -> None:
        code = run(**given)
        if ends or code:
            raise typer.Exit(code)

    context = inspect.Parameter("context", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context)
    signature = [context, *parameters]
    function.__signature__ = inspect.Signature(signature)  # type: ignore[attr-defined]
    function.__annotations__ = {each.name: each.annotation for each in signature}
    return function
