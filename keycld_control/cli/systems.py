"""List the systems that come with the library."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """List the systems that come with the library: motors, ranges, control steps, and whether weights are shipped.

    Attributes:
        json: Print one JSON object.
    """

    json: bool = False


def run(args: Args) -> None:
    """Print a table."""
    if args.json:
        print_result({row.pop("system"): row for row in rows()}, as_json=True)
        return

    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE, padding=0, collapse_padding=True, pad_edge=False)
    for name in ("system", "environment", "motors", "gear", "range", "step", "weights"):
        table.add_column(name, no_wrap=name != "motors")
    for row in rows():
        low, high = row["range"]
        table.add_row(
            row["system"],
            row["environment"],
            ", ".join(row["motors"]),
            ", ".join(f"{gear:g}" for gear in row["gear"]),
            f"±{high:g}" if low == -high else f"{low:g} to {high:g}",
            f"{row['control_step_s']:g} s",
            "shipped" if row["weights"] else "–",
        )
    Console().print(table)


def rows() -> Iterator[dict[str, Any]]:
    """Of every system: name, environment id, motors, gears, range of actions, control step, shipped weights or not."""
    from keycld_envs import SYSTEMS, KeyCLDEnv, resolve_env_id
    from keycld_model.stored import shipped_models

    shipped = shipped_models()
    for name, system in SYSTEMS.items():
        env = KeyCLDEnv(system, obs_type="state")
        low, high = env.action_space.low, env.action_space.high
        yield {
            "system": name,
            "environment": resolve_env_id(name),
            "motors": list(system.actuators),
            "gear": env.model.actuator_gear[:, 0].tolist(),
            "range": [float(low.min()), float(high.max())],
            "control_step_s": system.timestep,
            "weights": name in shipped,
        }
        env.close()
