"""List the recipes that models are trained by."""

from dataclasses import dataclass

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """List the recipes that models are trained by, for `keycld train --preset`.

    Attributes:
        json: Print one JSON object.
    """

    json: bool = False


def run(args: Args) -> None:
    """Print a table."""
    from keycld_model.training import PRESETS

    if args.json:
        print_result({name: {"steps": p.steps, "about": p.about} for name, p in PRESETS.items()}, as_json=True)
    else:
        print_result({name: f"{p.about}; {p.steps:,} steps" for name, p in PRESETS.items()}, as_json=False)
