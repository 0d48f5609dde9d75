"""Write a file that declares a mechanism of your own, to be changed."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Write a file that declares a mechanism, with comments, for you to change; all commands take it as a system.

    For instance: keycld new my_arm, then: keycld check my_arm.py

    Attributes:
        name: Of the mechanism; the file is NAME.py.
        template: What the file declares until you change it; "video" has no simulation.
        mjcf: MuJoCo XML file of your own to make the declaration for, in place of a template.
        json: Print one JSON object.
    """

    name: Positional[str]
    template: Literal["pendulum", "cartpole", "two_links", "video"] = "two_links"
    mjcf: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Write the file, unless there is one."""
    import re
    import sys
    from importlib import resources
    from importlib.metadata import packages_distributions

    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_file

    path = Path(args.name).with_suffix(".py") if args.name.endswith(".py") else Path(f"{args.name}.py")
    if re.fullmatch(r"[A-Za-z0-9_-]+", path.stem) is None:
        raise InputError(f"{path.stem!r} cannot be a name; use letters, digits, '_' and '-' alone.")
    if path.exists():
        raise InputError(f"{path} exists; choose another name, or remove it.")
    if path.stem in sys.stdlib_module_names or path.stem in packages_distributions():
        raise InputError(f"{path} would stand in the way of Python's own {path.stem!r}; choose another name.")
    if args.mjcf is None:
        starters = resources.files("keycld_control.starters")
        text = (starters / f"{args.template}.py").read_text(encoding="utf-8")
        text = text.replace("my_arm", path.stem).replace("THIS_FILE", path.name)
    else:
        from keycld_envs.inspection.propose import proposal

        text = proposal(args.mjcf, path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path, "w") as file:
        file.write(text)
    print_result({"file": path, "next": f"keycld check {path}"}, as_json=args.json)
