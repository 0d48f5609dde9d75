"""The score for people: a table on the terminal, and a Markdown report with all methods side by side."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any


def print_score(result: Mapping[str, Any]) -> None:
    """Print the rows of all methods, and what the first got wrong."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console, methods = Console(), list(result["methods"])
    table = Table(box=box.SIMPLE)
    table.add_column("measure")
    table.add_column("required", justify="right")
    for method in methods:
        table.add_column(method, justify="right")
    for line in _lines(result):
        table.add_row(*line)
    console.print(table)
    first, cases = result["methods"][methods[0]], result["manifest"]["cases"]
    console.print(f"{methods[0]}: {len(first['wrong'])} of {first['cases']} cases are wrong; score.md lists them.")
    for method, scored in result["methods"].items():
        if scored["cases"] < cases:
            console.print(f"{method}: {cases - scored['cases']} of {cases} cases have no report yet.")


def print_ideal(result: Mapping[str, Any]) -> None:
    """Print what comes nearest to each effect, and how many can be told from it."""
    from rich import box
    from rich.console import Console
    from rich.table import Table

    console, table = Console(), Table(box=box.SIMPLE)
    for column in ("case", "missing", "nearest of another name", "nats", "nearest elsewhere", "nats"):
        table.add_column(column, justify="right" if column == "nats" else "left")
    for told in result["told"]:
        cells = (
            cell
            for key in ("nearest", "elsewhere")
            for cell in (f"{told[key]['effect']} {told[key]['joint']}", f"{told[key]['nats']:.1f}")
        )
        table.add_row(told["case"], f"{told['true']['effect']} {told['true']['joint']}", *cells)
    console.print(table)
    if result["cases"]:
        names, places = f"{100 * result['name']:.1f} %", f"{100 * result['place']:.1f} %"
        console.print(
            f"Of {result['cases']} clear single effects an ideal observer tells {names} from the nearest of another "
            f"name, and {places} from the nearest elsewhere."
        )
    else:
        console.print("No case has a single clear effect.")


def markdown(result: Mapping[str, Any]) -> str:
    """The whole report."""
    manifest, methods = result["manifest"], list(result["methods"])
    lines = [
        "# Blind benchmark",
        "",
        f"{manifest['cases']} cases, seed {manifest['seed']}, generator {manifest['generator']}, mix "
        + ", ".join(f"{count} {kind}" for kind, count in sorted(manifest["mix"].items()))
        + ".",
        f"Answers sealed as SHA-256 `{manifest['answers_sha256']}`. Shares with 95 % Clopper-Pearson intervals.",
        "",
        *_table(["measure", "required", *methods], _lines(result)),
    ]
    for method in methods:
        scored = result["methods"][method]
        left = manifest["cases"] - scored["cases"]
        lines += [
            "",
            f"## {method}",
            "",
            *([f"{left} cases have no report yet.", ""] if left else []),
            "Truth and what was named, of cases with at most one effect:",
            "",
        ]
        lines += _table(["truth", "named"], ([t, _counts(said)] for t, said in scored["confusion"].items()))
        lines += ["", "Wrong: false alarms, clear effects not named and placed exactly, errors.", ""]
        columns = ["case", "system", "excitation", "truth", "said", "rivals", "verdict", "nats", "R"]
        lines += _table(columns, (_wrong(case) for case in scored["wrong"]))
        notes = [row for row in scored["rows"] if row["note"]]
        lines += ["", *(f"- {row['measure']}: {row['note']}" for row in notes)]
    return "\n".join(lines) + "\n"


def _lines(result: Mapping[str, Any]) -> Iterator[list[str]]:
    tables = [scored["rows"] for scored in result["methods"].values()]
    for rows in zip(*tables, strict=True):
        yield [rows[0]["measure"], _required(rows[0]), *(_reached(row) for row in rows)]


def _required(row: Mapping[str, Any]) -> str:
    required = row["required"]
    if required is None:
        return ""
    if isinstance(required, tuple | list):
        return f"{required[0]:g} to {required[1]:g}"
    return f"{'≤' if row['at_most'] else '≥'} {required:g}"


def _reached(row: Mapping[str, Any]) -> str:
    if row["reached"] is None:
        return "–"
    mark = {True: " ✓", False: " ✗", None: ""}[row["met"]]
    if row["interval"] is None:
        return f"{row['reached']:.3g} (n = {row['count']}){mark}"
    low, high = row["interval"]
    return f"{row['reached']:.3f} ({row['hits']}/{row['count']}, {low:.3f} to {high:.3f}){mark}"


def _wrong(case: Mapping[str, Any]) -> list[str]:
    return [
        case["case"],
        case["system"],
        case["excitation"],
        ", ".join(case["truth"]) or "nothing",
        case["failure"] or ", ".join(case["said"]) or "nothing",
        ", ".join(case["rivals"]),
        case["verdict"],
        ", ".join(f"{nats:.0f}" for nats in case["gain_nats"]),
        "" if case["recovery"] is None else f"{case['recovery']:.3f}",
    ]


def _counts(said: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in said.items())


def _table(columns: Sequence[str], lines: Iterable[Sequence[str]]) -> list[str]:
    cells = [columns, ["---"] * len(columns), *([cell.replace("|", "/") for cell in line] for line in lines)]
    return ["| " + " | ".join(row) + " |" for row in cells]
