"""``crtk-driver calibrate``: where a pointer's tip, a model, a tracker and its marker are."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from crtk_drivers.cli.help_pages import HelpfulCommand, HelpfulGroup
from crtk_drivers.cli.reaching import FIND_TIMEOUT, Timeout
from crtk_drivers.cli.terminal import OUT
from crtk_drivers.errors import ConfigError
from crtk_drivers.labs.calibration import HandEye, Pivot, Registration, hand_eye, pivot, register
from crtk_drivers.labs.calibration.hand_eye import ROTATIONS, Method
from crtk_drivers.labs.calibration.measured_files import (
    POINT,
    POSE,
    poses_of,
    read_table,
    rows_of,
    write_table,
)
from crtk_drivers.samples import Array, Pose

_MM = 1e3
_DEGREES = 57.29577951308232
_PAIR = ("arm", "marker")
_POINTS = ("model", "measured")

app = typer.Typer()
calibrate_app = typer.Typer(cls=HelpfulGroup, no_args_is_help=True, rich_markup_mode="rich")

FileOption = Annotated[
    Path | None,
    typer.Option("--file", metavar="CSV", help="Read what was measured instead of measuring it."),
]
SaveOption = Annotated[
    Path | None, typer.Option("--save", metavar="CSV", help="Keep what was measured, for --file.")
]


@calibrate_app.callback()
def _calibrate() -> None:
    """Find where the tip of a pointer, a model, a tracker or its marker is, from what devices measure."""


@calibrate_app.command("pivot", cls=HelpfulCommand)
def _pivot(
    pointer: Annotated[
        str, typer.Argument(metavar="POINTER", help="Its namespace.", show_default=False)
    ] = "",
    seconds: Annotated[
        float, typer.Option("--seconds", min=1.0, max=300.0, help="How long to measure.")
    ] = 20.0,
    worst: Annotated[
        float, typer.Option("--worst", metavar="MM", min=0.001, help="Residual that is allowed.")
    ] = 2.0,
    file: FileOption = None,
    save: SaveOption = None,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Find the tip of a pointer, which is tilted to all sides while its tip rests.

    Examples:

        crtk-driver calibrate pivot /polaris/pointer --save pivot.csv
        crtk-driver calibrate pivot --file pivot.csv
    """
    if file is not None:
        poses = poses_of(read_table(file, ("",), POSE)[""])
    else:
        from crtk_drivers.cli.calibrate_recording import moving

        poses = moving(_needed(pointer, "POINTER"), seconds, timeout)
        _keep(save, {"": rows_of(poses)}, POSE)
    _tell_pivot(pivot(poses, worst / _MM))


@calibrate_app.command("register", cls=HelpfulCommand)
def _register(
    pointer: Annotated[
        str, typer.Argument(metavar="POINTER", help="Its namespace.", show_default=False)
    ] = "",
    model: Annotated[
        Path | None,
        typer.Option(
            "--model", metavar="CSV", help="Points of the model, in m, under a line `x,y,z`."
        ),
    ] = None,
    tip: Annotated[
        tuple[float, float, float],
        typer.Option("--tip", metavar="X Y Z", help="Of the pointer in its own frame, in m."),
    ] = (0.0, 0.0, 0.0),
    target: Annotated[
        list[str] | None,
        typer.Option(
            "--target", metavar="X,Y,Z", help="Place of the model, in m, whose error is told."
        ),
    ] = None,
    worst: Annotated[
        float, typer.Option("--worst", metavar="MM", min=0.001, help="FRE that is allowed.")
    ] = 5.0,
    file: FileOption = None,
    save: SaveOption = None,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Find where a model is, whose points are touched one after the other, each until it is taken.

    Examples:

        crtk-driver calibrate register /polaris/pointer --model bone.csv
        crtk-driver calibrate register --file pairs.csv
    """
    targets = [_place(each) for each in target or ()]
    if file is not None:
        table = read_table(file, _POINTS, POINT)
        ours, theirs = table["model"], table["measured"]
    else:
        from crtk_drivers.cli.calibrate_recording import touched

        if model is None:
            raise ConfigError("which points?", where="--model", remedy="Give a file of them.")
        ours = read_table(model, ("",), POINT)[""]
        theirs = touched(_needed(pointer, "POINTER"), len(ours), tip, timeout)
        _keep(save, {"model": ours, "measured": theirs}, POINT)
    _tell_registration(register(ours, theirs, worst / _MM), targets)


@calibrate_app.command("hand-eye", cls=HelpfulCommand)
def _hand_eye(
    arm: Annotated[
        str, typer.Argument(metavar="ARM", help="Namespace of the arm.", show_default=False)
    ] = "",
    marker: Annotated[
        str,
        typer.Argument(
            metavar="MARKER",
            help="Namespace of the tool on it that is tracked.",
            show_default=False,
        ),
    ] = "",
    pairs: Annotated[
        int, typer.Option("--pairs", min=5, max=200, help="How many pairs of poses to take.")
    ] = 15,
    method: Annotated[
        str, typer.Option("--method", metavar="park|tsai", help="How the rotation is found.")
    ] = "park",
    worst: Annotated[
        float, typer.Option("--worst", metavar="MM", min=0.001, help="Residual that is allowed.")
    ] = 10.0,
    file: FileOption = None,
    save: SaveOption = None,
    timeout: Timeout = FIND_TIMEOUT,
) -> None:
    """Find where a tracker stands to an arm, and its marker on the flange. You move the arm, this does not.

    A pair is taken whenever both have stood for half a second in a new place.

    Examples:

        crtk-driver calibrate hand-eye /ur5 /polaris/marker --save pairs.csv
        crtk-driver calibrate hand-eye --file pairs.csv --method tsai
    """
    chosen = _method(method)
    if file is not None:
        table = read_table(file, _PAIR, POSE)
        ours, theirs = poses_of(table["arm"]), poses_of(table["marker"])
        frame = "arm_base"
    else:
        from crtk_drivers.cli.calibrate_recording import standing

        taken = standing(
            (_needed(arm, "ARM"), _needed(marker, "MARKER")), pairs, timeout, "move the arm"
        )
        ours, theirs = [pair[0] for pair in taken], [pair[1] for pair in taken]
        _keep(save, {"arm": rows_of(ours), "marker": rows_of(theirs)}, POSE)
        frame = ours[0].frame_id
    _tell_hand_eye(hand_eye(ours, theirs, chosen, worst / _MM), frame)


app.add_typer(calibrate_app, name="calibrate")


def _needed(namespace: str, what: str) -> str:
    if not namespace:
        raise ConfigError("which device?", where=what, remedy="Give its namespace, or --file.")
    return namespace


def _method(text: str) -> Method:
    for method in ROTATIONS:
        if text == method:
            return method
    raise ConfigError(
        "is no method", where=f"--method {text}", remedy=f"Give {' or '.join(ROTATIONS)}."
    )


def _place(text: str) -> tuple[float, ...]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise ConfigError("is no place", where=text, remedy="Give x,y,z in m.") from None
    return x, y, z


def _keep(path: Path | None, bodies: dict[str, Array], parts: Sequence[str]) -> None:
    if path is not None:
        write_table(path, bodies, parts)
        OUT.print(f"kept in {path}", markup=False)


# ------------------------------------------------------------------------------------------ reports


def _tell_pivot(found: Pivot) -> None:
    count = len(found.residuals)
    _print_rows(
        ("poses", f"{count}, turned by up to {_DEGREES * found.widest:.0f}°"),
        _residual("residual", found.residual, found.residuals),
        ("tip", f"{_mm(found.tip)} ± {_mm(found.deviation, 3)} mm in the pointer's frame"),
        ("rested at", f"{_mm(found.place)} mm"),
        ("spread", f"{found.spread:.2f} of 1 (all alike 0)"),
    )
    _print_toml(f"tip = {{ position = {_list(found.tip)} }}", "of the tool, in `[[tools]]`")


def _tell_registration(found: Registration, targets: Iterable[tuple[float, ...]]) -> None:
    _print_rows(
        ("points", f"{len(found.residuals)}"),
        _residual("FRE", found.fre, found.residuals),
        ("FLE", f"{_MM * found.fle:.2f} mm RMS, as far as these residuals tell it"),
        *((f"TRE at {_mm(each)}", f"{_MM * found.tre(each):.2f} mm RMS") for each in targets),
        *([("mirrored", "the points fit better as mirror images")] if found.mirrored else ()),
    )
    _print_toml(_pose(found.pose), "of the model in the frame of the pointer's poses", "[pose]")


def _tell_hand_eye(found: HandEye, frame: str) -> None:
    _print_rows(
        ("pairs", f"{len(found.residuals)}, {found.motions} motions between them"),
        _residual("residual", found.residual, found.residuals[:, 0]),
        ("", f"{_DEGREES * found.turned:.3f}° RMS, {_DEGREES * found.residuals[:, 1].max():.3f}°"),
        ("spread", f"{found.spread:.2f} of 1 (about one axis 0)"),
        ("unlike", f"{_DEGREES * found.unlike:.3f}° that arm and marker turn differently"),
    )
    _print_toml(
        f'{_pose(found.tracker)}\nframe_id = "{frame}"',
        "where the tracker stands, in its configuration",
        "[base]",
    )
    _print_toml(_pose(found.marker), "the marker at the flange", "[kinematics.tool]")


def _residual(name: str, rms: float, each: Array) -> tuple[str, str]:
    worst = f"{_MM * each.max():.2f} mm at number {int(each.argmax()) + 1}"
    return name, f"{_MM * rms:.2f} mm RMS, {worst}"


def _print_rows(*rows: tuple[str, str]) -> None:
    table = Table(box=None, show_header=False, pad_edge=False)
    for name, told in rows:
        table.add_row(name, told)
    OUT.print(table)


def _print_toml(text: str, what: str, heading: str = "") -> None:
    lines = ("", f"# {what}", *([heading] if heading else ()), text)
    OUT.print("\n".join(lines), markup=False, soft_wrap=True)


def _pose(pose: Pose) -> str:
    return f"position = {_list(pose.position)}\norientation = {_list(pose.orientation, 9)}"


def _list(values: Iterable[float], digits: int = 6) -> str:
    return "[" + ", ".join(f"{value:.{digits}f}" for value in values) + "]"


def _mm(values: Iterable[float], digits: int = 2) -> str:
    return " ".join(f"{_MM * value:.{digits}f}" for value in values)
