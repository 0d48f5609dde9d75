"""Check a mechanism of your own before anything is recorded."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_envs import Mechanism
    from keycld_envs.inspection import Inspection


@dataclass(frozen=True)
class Args:
    """Check a mechanism before anything is recorded: move it, look at it, say what does not fit and how to mend it.

    Random poses, the target and the rest are drawn with keypoints, rods, sliders and the values of constraints. With
    recordings, what is weak in them is said, too. The exit code is 2 if something has to be mended.

    Attributes:
        system: Python file that declares a system or a mechanism (`keycld new` writes one), or the name of a system.
        data: Folder of recordings that a model shall learn from.
        out: Picture to write (.png, .jpg).
        show: Open the picture.
        seed: Of the poses.
        json: Print one JSON object.
    """

    system: Positional[str]
    data: Path | None = None
    out: Path = Path("check.png")
    show: bool = False
    seed: int = 0
    json: bool = False


def run(args: Args) -> int:
    """Look, draw, and print what was found."""
    from keycld_control.cli._declared import declared
    from keycld_envs import system_of
    from keycld_envs.checks import check_whole
    from keycld_envs.errors import InputError

    check_whole("seed", args.seed, 0, 2**63)
    if args.out.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"--out is {args.out}; a picture must end in .png or .jpg.")
    name, mechanism = declared(args.system)
    if name is None and args.data is None:
        raise InputError(f"{args.system} declares no simulation to look at; name recordings of yours, --data FOLDER.")
    result: dict[str, Any] = {"degrees_of_freedom": mechanism.degrees_of_freedom}
    problems: list[str] = []
    warnings: list[str] = []
    if name is not None:
        from keycld_envs.inspection import inspect

        found = inspect(system_of(name), args.seed)
        problems, warnings = [*found.problems, *_drawn(args, found)], [*found.warnings]
        result |= _summary(found, args.json) | {"picture": args.out}
    if args.data is not None:
        unfit, weak = _recorded(args, name, mechanism)
        problems, warnings = [*problems, *unfit], [*warnings, *weak]
        result["recordings"] = args.data
        if name is None:
            result["picture"] = args.out
    return _report(args, result, problems, warnings)


def _drawn(args: Args, found: "Inspection") -> list[str]:
    """Write the picture; what its images say is a problem."""
    from keycld_control.check_picture import draw, panels
    from keycld_envs.errors import InputError

    try:
        drawn, unseen = panels(found.poses)
    except InputError as error:  # there is no OpenGL, which must not hide what else is wrong
        return [str(error)]
    draw(args.out, found.poses.system.mechanism, drawn)
    if found.problems:
        return []
    system, camera = found.poses.system, found.poses.system.camera
    remedy = "add a light, opaque colours (rgba) that differ from the background, or thicker geometry."
    if len(unseen) == len(system.joints):
        return [f"The camera {camera!r} sees nothing move: images of random poses are alike; {remedy}"]
    return [
        f"Joint {system.joints[i].name!r} moves keypoints, but nothing that the camera {camera!r} sees; {remedy}"
        for i in unseen
    ]


def _recorded(args: Args, name: str | None, mechanism: "Mechanism") -> tuple[list[str], list[str]]:
    """What does not fit in recordings, and what is weak; without a simulation, they are what the picture shows."""
    from keycld_control.check_picture import draw, recorded_panels
    from keycld_envs import system_of
    from keycld_envs.recordings import read_dataset
    from keycld_envs.recordings.weaknesses import weaknesses
    from keycld_envs.registration import same_system

    assert args.data is not None
    dataset = read_dataset(args.data)
    if name is None:
        draw(args.out, mechanism, recorded_panels(dataset, mechanism))
    elif dataset.system is not None and not same_system(dataset.system, name):
        return [f"{args.data} records {dataset.system}, not {name}; name the system that was recorded."], []
    if (recorded := len(dataset.recordings[0].actuator_names)) != mechanism.num_actions:
        return [
            f"{args.data} has {recorded} actions, the mechanism of {args.system} has {mechanism.num_actions}; correct "
            "num_actions, or name the recordings of this mechanism."
        ], []
    return [], list(weaknesses(dataset, None if name is None else system_of(name), mechanism))


def _summary(found: "Inspection", as_json: bool) -> dict[str, Any]:
    """What was measured."""
    if as_json:
        return {
            "constraints": [asdict(value) | {"constant": value.constant} for value in found.constraints],
            "in_view": found.in_view,
            "actuators": [asdict(actuator) for actuator in found.actuators],
            "speed": None if found.speed is None else asdict(found.speed),
        }
    rows: dict[str, Any] = {f"{v.name} (image units)": f"{v.least:.3f} to {v.most:.3f}" for v in found.constraints}
    rows |= {f"keypoint {k} in view": f"{100 * part:.0f} %" for k, part in enumerate(found.in_view)}
    for each in found.actuators:
        rows[f"actuator {each.name}"] = f"{each.low:g} to {each.high:g} moves keypoints by {each.pixels:.0f} pixels"
    if found.speed is not None:
        rows["fastest from frame to frame"] = f"{found.speed.pixels:.1f} pixels, {found.speed.radians:.2f} rad"
    return rows


def _report(args: Args, result: dict[str, Any], problems: list[str], warnings: list[str]) -> int:
    """Print; a problem is a sentence on stderr and makes the exit code."""
    import sys

    if args.json:
        print_result({"system": args.system, **result, "problems": problems, "warnings": warnings}, as_json=True)
    else:
        print_result(result, as_json=False)
    for sentence in (*problems, *(f"warning: {warning}" for warning in warnings)):
        print(f"keycld: {sentence}", file=sys.stderr)
    if args.show:
        from PIL import Image

        Image.open(args.out).show()
    return 2 if problems else 0
