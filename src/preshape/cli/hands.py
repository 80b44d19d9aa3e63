"""``preshape hands``: list the hands; ``hands init`` and ``hands check``: describe and check your own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .lazy import HelpfulGroup
from .options import json_option, motors_option
from .printing import emit, say

if TYPE_CHECKING:
    from ..hands.hand import Hand
    from ..hands.trial import ClosingTrial

SIDE = 420
"""Width and height of each of the three pictures of a hand [pixels]."""


@click.group(
    cls=HelpfulGroup,
    invoke_without_command=True,
    epilog="Example: preshape hands init my_hand.urdf",
)
@click.option(
    "--out", metavar="DIR", help="Folder for a picture of every hand, open, half closed and closed."
)
@json_option
@click.pass_context
def hands(ctx: click.Context, out: str | None, as_json: bool) -> None:
    """List the hands with joints, U, palm frame, source and licence; "preshape hands check" checks one."""
    if ctx.invoked_subcommand is not None:
        return
    from ..hands.load import hand_names, load_hand

    found = [load_hand(name) for name in hand_names()]
    pictures = {hand.name: draw_hand(hand, Path(out)) for hand in found} if out is not None else {}
    rows = [_row(hand, pictures.get(hand.name)) for hand in found]
    if as_json:
        emit({"status": "answer", "hands": rows})
        return
    for row in rows:
        _show(row)
    click.echo(
        "NAME:left is the mirror image. --hand also takes your own URDF, MJCF or TOML file "
        "(docs/your-own-hand.md) and menagerie:NAME (shadow_hand, wonik_allegro, leap_hand)."
    )


@hands.command(epilog="Example: preshape hands init my_hand.urdf --out my_hand.toml")
@click.argument("model", metavar="MODEL")
@click.option("--root", metavar="BODY", help="The hand's mount, where MODEL is a whole robot.")
@click.option("--side", metavar="left|right", help="Side of the hand; default: as geometry and names say.")
@motors_option
@click.option("--out", metavar="FILE", help="The TOML file; default: NAME.toml in the current folder.")
@json_option
def init(
    model: str, root: str | None, side: str | None, motors: str | None, out: str | None, as_json: bool
) -> None:
    """Describe the hand of MODEL, a URDF or an MJCF: write its TOML file and a picture of it.

    Fingers, palm, fingertips, sizes, motors and closing paths are inferred; what was guessed is said in three
    lines. Look at the picture, and correct the TOML file where the guess is wrong.
    """
    from ..hands.load import describe_file

    path, made, hand = describe_file(model, root=root, side=side, motors=motors, out=out)
    picture = draw_hand(hand, path.parent)
    if as_json:
        emit(
            {
                "status": "answer",
                "hand": hand.name,
                "file": str(path),
                "picture": str(picture),
                "guesses": list(made.lines),
            }
        )
        return
    say(*made.lines, f"wrote {path}", f"wrote {picture}", f"next: preshape hands check {path}")


@hands.command(epilog="Example: preshape hands check my_hand.toml --out pictures")
@click.argument("file", metavar="FILE")
@motors_option
@click.option("--out", metavar="DIR", help="Folder for a picture of the hand, open, half closed and closed.")
@json_option
def check(file: str, motors: str | None, out: str | None, as_json: bool) -> int:
    """Report what is missing or wrong in a hand. FILE is its TOML file, its URDF or MJCF, or its name.

    Exit code 0: fit for use. 1: findings. 2: the file or its model cannot be read.
    """
    from ..hands.check import inspect_hand
    from ..hands.load import joined
    from ..hands.trial import trials
    from ..report.plain import escaped

    found, hand = inspect_hand(joined(file, motors))
    picture = draw_hand(hand, Path(out)) if out is not None and hand is not None else None
    if as_json:
        emit(
            {
                "status": "findings" if found else "fine",
                "hand": hand.name if hand is not None else None,
                "findings": [{"code": finding.code, "text": finding.text} for finding in found],
                "trials": [] if hand is None else [_trial_row(trial) for trial in trials(hand)],
                "picture": str(picture) if picture is not None else None,
            }
        )
        return 1 if found else 0
    for finding in found:
        click.echo(f"{click.style(finding.code, bold=True)}: {escaped(finding.text)}")
    if hand is not None:
        _show(_row(hand, picture))
        say(*trials(hand))
    if found:
        click.echo(f"{len(found)} finding{'s' if len(found) > 1 else ''}; see docs/your-own-hand.md")
    else:
        click.echo("fit for use")
    return 1 if found else 0


def _trial_row(trial: ClosingTrial) -> dict[str, Any]:
    return {
        "shape": trial.shape,
        "size": trial.size,
        "held": bool(trial.against),
        "touching": list(trial.touching),
        "against": trial.against or None,
    }


def draw_hand(hand: Hand, folder: Path) -> Path:
    """Draw a hand open, half closed and closed; each finger stops when it touches another part of the hand.

    Args:
        hand: The hand.
        folder: Folder of the picture; created if it is missing.

    Returns:
        Path of the PNG file, which is named after the hand.

    Raises:
        EnvironmentFailure: The picture cannot be written.
    """
    import numpy as np

    from ..exceptions import EnvironmentFailure
    from ..hands.check import close_empty
    from ..hands.kinematics import hand_geometry
    from ..viewer.gallery import portrait
    from ..viewer.picture_file import write_png
    from ..viewer.shapes import hand_shape

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFailure(f"the folder {folder} cannot be made: {error.strerror or error}") from error
    reached = close_empty(hand)
    # The thumb of a left hand is on the other side, so the camera is there too.
    eye = (0.6 if hand.side == "right" else -0.6, -0.75, 0.35)
    images = []
    for shares in (0.0 * reached, np.minimum(reached, 0.5), reached):
        parts = hand_geometry(hand, np.array([0.0, 0, 0, 1, 0, 0, 0]), hand.at(shares))
        images.append(portrait(hand_shape(parts), (SIDE, SIDE), eye))
    path = folder / f"{hand.name.replace(':', '_').replace('/', '_')}.png"
    write_png(np.hstack(images), path)
    return path


def _row(hand: Hand, picture: Path | None) -> dict[str, Any]:
    row: dict[str, Any] = {
        "name": hand.name,
        "title": hand.title,
        "description": hand.description,
        "side": hand.side,
        "fingers": [finger.name for finger in hand.fingers],
        "joints": len(hand.joints),
        "joint_names": list(hand.joints),
        "actuators": len(hand.motors),
        "motors": hand.motor_facts(),
        "U": hand.u,
        "largest_object": 4 * hand.u,
        "fingertip_radius": hand.fingers[1].tip_radius,
        "palm_frame": {"body": hand.palm_body, "T_root_palm": hand.T_root_palm.tolist()},
        "licence": hand.licence,
        "source": hand.credit,
    }
    if picture is not None:
        row["picture"] = str(picture)
    return row


def _show(row: dict[str, Any]) -> None:
    from ..report.terminal import fact_grid, terminal

    drives = f", {row['actuators']} motors" if row["actuators"] != row["joints"] else ""
    facts = {
        row["name"]: row["title"],
        "fingers": f"{', '.join(row['fingers'])}; {row['joints']} joints{drives}",
        "U": f"{1000 * row['U']:.4g} mm, the middle finger's proximal phalanx",
        "objects": f"up to {1000 * row['largest_object']:.0f} mm (4U) with the ray analyser",
        "fingertips": f"radius {1000 * row['fingertip_radius']:.3g} mm",
        "palm frame": f"in body {row['palm_frame']['body']}; {_place(row)}",
        **{key: row[key] for key in ("source", "licence", "picture") if key in row},
    }
    terminal().print(fact_grid(*facts.items()), highlight=False)


def _place(row: dict[str, Any]) -> str:
    """Pose of the palm frame in the root's frame, in words."""
    T = row["palm_frame"]["T_root_palm"]
    place = " ".join(f"{1000 * T[i][3]:.0f}" for i in range(3))
    axes = []
    for column in range(3):
        values = [T[i][column] for i in range(3)]
        best = max(range(3), key=lambda i: abs(values[i]))
        sign = "+" if values[best] > 0 else "-"
        axes.append(f"{sign}{'xyz'[best]}" if abs(values[best]) > 1 - 1e-6 else "askew")
    return f"origin {place} mm, axes {' '.join(axes)} of the root"
