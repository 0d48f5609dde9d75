"""Write recordings as a data set of Minari or LeRobot, or as files of Rerun to look at; a world model as MJCF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from keycld_control.cli._output import print_result


@dataclass(frozen=True)
class Args:
    """Write recordings or a world model in another format, and say what it cannot hold.

    For instance: keycld export data/arm --to rerun --out arm_rrd --diagnosis report, then rerun arm_rrd/*.rrd

    Attributes:
        source: A recording, or a folder of recordings; with --to mjcf, a checkpoint or the name of shipped weights.
        to: Format: "minari" (steps of Gymnasium), "lerobot" (version 3), "rerun" (.rrd files, for the Rerun viewer),
            and of a world model "mjcf" (a MuJoCo XML file). `keycld import` reads Minari and LeRobot back.
        out: Folder to create; of MJCF, the file.
        diagnosis: With rerun: folder of a report of `keycld diagnose`, shown beside.
        json: Print one JSON object.
    """

    source: Positional[str]
    to: Literal["minari", "lerobot", "rerun", "mjcf"]
    out: Path
    diagnosis: Path | None = None
    json: bool = False


def run(args: Args) -> None:
    """Read, write, and say what was lost."""
    from keycld_envs.errors import InputError
    from keycld_envs.recordings import read_dataset, read_recording
    from keycld_envs.recordings.exporters import write_lerobot, write_minari, write_rerun

    if args.diagnosis is not None and args.to != "rerun":
        raise InputError("--diagnosis goes into files of Rerun only; export --to rerun, or leave it out.")
    if args.to == "mjcf":
        return _write_mjcf(args)
    source = Path(args.source)
    document = None if args.diagnosis is None else _document(args.diagnosis)
    single = (source / "meta.json").exists()
    recordings = [read_recording(source)] if single else list(read_dataset(source).recordings)
    try:
        if args.to == "rerun":
            lost = write_rerun(recordings, args.out, document)
        else:
            lost = (write_minari if args.to == "minari" else write_lerobot)(recordings, args.out)
    except FileExistsError as error:
        raise InputError(f"{args.out} exists already; choose another folder or remove it.") from error
    print_result({"out": args.out, "format": args.to, "recordings": len(recordings), "lost": lost}, as_json=args.json)


def _write_mjcf(args: Args) -> None:
    """What a world model has learned, for MuJoCo."""
    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_file
    from keycld_model import WorldModel
    from keycld_model.learned_mjcf import learned_mjcf

    if args.out.exists():
        raise InputError(f"{args.out} exists already; choose another file or remove it.")
    found = learned_mjcf(WorldModel.load(args.source))
    with atomic_file(args.out, "w") as file:
        file.write(found.xml)
    left_out = {"potential energy": round(found.of_potential, 4), "inputs": round(found.of_inputs, 4)}
    result = {"out": args.out, "format": "mjcf", "joints": found.joints, "left_out": left_out}
    print_result(result, as_json=args.json)


def _document(folder: Path) -> str:
    """A report of the diagnosis in Markdown."""
    from keycld_envs.errors import InputError
    from keycld_envs.reading import read_json

    path = folder / "report.json" if folder.is_dir() else folder
    try:
        report = read_json(path)
        lines = [f"# {report['headline']}", "", f"Verdict: {report['verdict']}"]
        for finding in report["findings"]:
            where = finding["where"].get("name", "")
            lines += ["", f"## {finding['effect'].replace('_', ' ')} {where}".rstrip()]
            for name, found in finding["parameters"].items():
                lines.append(
                    f"- {name} {found['value']:.4g} ({found['low']:.4g} to {found['high']:.4g}) {found['unit']}"
                )
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else error
        raise InputError(f"{path} is no report of `keycld diagnose` ({why}); name its folder.") from error
    return "\n".join(lines)
