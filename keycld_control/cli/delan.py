"""Learn the dynamics of joints from logs of torques: Deep Lagrangian Networks and their rivals."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import OmitArgPrefixes, OmitSubcommandPrefixes, Positional, UseAppendAction, arg, configure, subcommand

from keycld_control.cli._compiled import keep_compiled
from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from keycld_model.delan import Motions


@dataclass(frozen=True)
class Log:
    """How to read the data.

    Attributes:
        time: of a log (.csv, .json, .mat, EPOS): column of the clock, as in `keycld import`.
        joint: of a log: column of each joint's position, as JOINT=COLUMN.
        velocity: of a log: column of each joint's measured velocity, as JOINT=COLUMN.
        action: of a log: column of each joint's torque, as JOINT=COLUMN.
        unit: of a log: units of columns that are not in s, rad, rad/s and N m, as COLUMN=UNIT.
        slide: of an .npz archive: names of joints that slide, of joint_1, joint_2 and so on.
        radians: of an .npz archive: positions are in radians, although a joint turns more than twice.
        band: of recordings and logs: all signals are low-passed at this frequency, Hz, below that of vibrating links.
    """

    time: str | None = None
    joint: UseAppendAction[tuple[str, ...]] = ()
    velocity: UseAppendAction[tuple[str, ...]] = ()
    action: UseAppendAction[tuple[str, ...]] = ()
    unit: UseAppendAction[tuple[str, ...]] = ()
    slide: UseAppendAction[tuple[str, ...]] = ()
    radians: bool = False
    band: float | None = None


@dataclass(frozen=True)
class Train:
    """Train a joint model. Run again with the same settings, it continues where it stopped.

    Attributes:
        data: Archive of arrays (.npz: qp, tau, and any of t, qv, qa, labels, lengths), folder of recordings, one
            recording, or a log with --time, --joint and --action.
        out: Folder for the checkpoint and the log.
        model: Family of the model.
        friction: Effects at every joint: viscous_friction, coulomb_friction, stribeck_friction, quadratic_drag.
        test: Names of motions that are held out for the figures at the end, parted by commas, for instance e,q,v; by
            default, the figures are of those that say when to stop.
        validation: Share of the other motions that says when to stop.
        residual_of: Joint model that stays as it is, a folder that this command wrote: what it leaves in the torques is
            learned, and added to it.
        seed: Seed of initialisation and division.
        tracker: Also show curves in "tensorboard", "wandb" or "trackio", which need the extra of that name; a page,
            report.html, is written beside the run in any case.
        log: How to read the data.
        json: Print one JSON object.
    """

    data: Positional[Path]
    out: Path
    model: Literal["structured", "black_box", "hamiltonian", "feed_forward"] = "structured"
    friction: UseAppendAction[tuple[str, ...]] = ()
    test: str = ""
    validation: float = 0.15
    residual_of: Path | None = None
    seed: int = 0
    tracker: Annotated[Literal["tensorboard", "wandb", "trackio"] | None, arg(name="log")] = None
    log: Log = Log()
    json: bool = False


@dataclass(frozen=True)
class Evaluate:
    """Score a joint model on motions.

    Attributes:
        checkpoint: Folder that `keycld delan train` wrote.
        data: Archive, recordings or log, as for `keycld delan train`.
        only: Names of motions, parted by commas; by default all.
        log: How to read the data.
        json: Print one JSON object.
    """

    checkpoint: Positional[Path]
    data: Path
    only: str = ""
    log: Log = Log()
    json: bool = False


@dataclass(frozen=True)
class Paper:
    """Train and measure all models on the characters of the papers, and write a page and a table.

    Run again, it goes on where it stopped; the page holds what is known so far after every call.

    Attributes:
        out: Folder of the report.
        data: The characters, character_data.npz.
        model: Families, repeatable; by default all.
        seeds: Seeds of training per model.
        characters: Numbers of characters to learn from, repeatable; by default all, and 2, 4 and 8 for the first seed.
        noise: Standard deviation that is added to positions, as a share of their spread, for instance 0.01; velocities
            and accelerations are then estimated. Of all characters.
        only_report: Write the report from what is there; train and measure nothing.
        workers: Number of processes.
        ray: Do it on a Ray cluster: "local", "auto" or host:port; all its machines must see the folders.
        json: Print one JSON object.
    """

    out: Path
    data: Path
    model: UseAppendAction[tuple[str, ...]] = ()
    seeds: int = 5
    characters: UseAppendAction[tuple[int, ...]] = ()
    noise: float = 0.0
    only_report: bool = False
    workers: int = 1
    ray: str | None = None
    json: bool = False


@dataclass(frozen=True)
class Real:
    """Train and measure all models on logs of other people's robots, on recordings that no model has seen.

    Run again, it goes on where it stopped; the table holds what is known so far after every call.

    Attributes:
        data: Folder with the data sets; see docs/real-data.md.
        out: Folder of the results.
        rig: Robots, repeatable; by default all.
        model: Families, repeatable; by default all.
        share: Shares of each training recording, from its start, repeatable; by default 1 and 0.25.
        seeds: Seeds of training per model.
        band: Hz, at which all signals are low-passed; links of these robots vibrate at 8 to 12.
        only_report: Write the table from what is there; train and measure nothing.
        workers: Number of processes.
        ray: Do it on a Ray cluster: "local", "auto" or host:port; all its machines must see the folders.
        json: Print one JSON object.
    """

    data: Positional[Path]
    out: Path
    rig: UseAppendAction[tuple[str, ...]] = ()
    model: UseAppendAction[tuple[str, ...]] = ()
    share: UseAppendAction[tuple[float, ...]] = ()
    seeds: int = 1
    band: float = 6.0
    only_report: bool = False
    workers: int = 1
    ray: str | None = None
    json: bool = False


@configure(OmitArgPrefixes, OmitSubcommandPrefixes)
@dataclass(frozen=True)
class Args:
    """Learn the dynamics of joints from logs of torques."""

    command: (
        Annotated[Train, subcommand("train")]
        | Annotated[Evaluate, subcommand("evaluate")]
        | Annotated[Paper, subcommand("paper")]
        | Annotated[Real, subcommand("real")]
    )


def run(args: Args) -> None:
    """Train, evaluate, or write a report."""
    keep_compiled()
    if isinstance(args.command, Train):
        _train(args.command)
    elif isinstance(args.command, Evaluate):
        _evaluate(args.command)
    elif isinstance(args.command, Paper):
        _paper(args.command)
    else:
        _real(args.command)


def _train(args: Train) -> None:
    from keycld_control.runs.watching import watching
    from keycld_envs.errors import InputError
    from keycld_model.delan import JointModel, train
    from keycld_model.delan.baseline import fit_baseline, verdict
    from keycld_model.delan.measures import score

    if args.residual_of is not None and args.residual_of.resolve() == args.out.resolve():
        raise InputError(f"--out is {args.out}, which holds the base of the residual; name another folder.")
    base = None if args.residual_of is None else JointModel.load(args.residual_of)
    motions = _read(args.data, args.log)
    rest, test = motions.hold_out(_names(args.test)) if args.test else (motions, None)
    about = {"model": args.model, "seed": args.seed, "data": str(args.data)}
    with watching(args.out, about, args.tracker) as watchers:
        result = train(rest, args.out, args.model, args.friction, args.seed, args.validation, base, watchers)
    learned, held_out = rest.split(args.validation, args.seed)
    judged = held_out if test is None else test
    network, baseline = score(result.model, judged), None
    try:
        baseline = score(fit_baseline(learned, args.friction), judged)
        said = verdict(network, baseline)
    except InputError as error:  # too few samples for it, which a network and its prior need not mind
        said = f"There is no least-squares baseline: {error}"
    summary: dict[str, Any] = {
        "checkpoint": result.folder,
        "model": args.model,
        "motions": {"learned": len(learned), "validation": len(held_out), "test": 0 if test is None else len(test)},
        "iterations": result.iterations,
        "seconds": round(result.seconds, 1),
        "validation_error": result.validation_error,
        "friction": {f"{e.id} at {e.where}": _numbers(e) for e in result.model.effects},
        "scores": asdict(network),
        "least_squares": None if baseline is None else asdict(baseline),
        "verdict": said,
    } | ({} if base is None else {"residual_of": args.residual_of, "base": asdict(score(base, judged))})
    _print(summary, args.json)


def _evaluate(args: Evaluate) -> None:
    from keycld_model import JointModel
    from keycld_model.delan.measures import check_joints, score
    from keycld_model.delan.speed import inverse_dynamics_per_second

    model, motions = JointModel.load(args.checkpoint), _read(args.data, args.log)
    check_joints(model, motions)
    if args.only:
        motions = motions.chosen(_names(args.only))
    summary = {
        "model": model.config.family,
        "motions": len(motions),
        "scores": asdict(score(model, motions)),
        "inverse_dynamics_per_second": round(inverse_dynamics_per_second(model, motions)),
    }
    _print(summary, args.json)


def _paper(args: Paper) -> None:
    from keycld_control.delan.plan import trainings
    from keycld_control.delan.report import write_report
    from keycld_control.delan.work import results, work_off
    from keycld_envs.errors import InputError

    for name in ("seeds", "workers"):
        if getattr(args, name) < 1:
            raise InputError(f"{name} is {getattr(args, name)}; it must be at least 1.")
    planned = trainings(args.model, args.seeds, args.characters, args.noise)
    if not args.only_report:
        work_off(args.out, args.data, planned, args.workers, args.ray)
    found = results(args.out)
    if not found:
        raise InputError(f"{args.out} holds no results; run without --only-report.")
    write_report(args.out, args.data, found)
    summary = {"models": len(found), "planned": len(planned), "report": args.out / "report.html"}
    print_result(summary, as_json=args.json)


def _real(args: Real) -> None:
    from keycld_control.delan.real import results, trials, work_off
    from keycld_control.delan.real_table import winners, write_table
    from keycld_envs.errors import InputError

    if args.workers < 1:
        raise InputError(f"workers is {args.workers}; it must be at least 1.")
    planned = trials(args.rig, args.model, args.share, args.seeds, args.band)
    if not args.only_report:
        work_off(args.out, args.data, planned, args.workers, args.ray)
    found = results(args.out)
    if not found:
        raise InputError(f"{args.out} holds no results; run without --only-report.")
    write_table(args.out, found)
    summary = {"models": len(found), "winners": winners(found), "table": args.out / "real.md"}
    print_result(summary, as_json=args.json)


def _read(path: Path, log: Log) -> "Motions":
    from keycld_control.cli._pairs import pairs
    from keycld_envs.errors import InputError
    from keycld_envs.recordings.importers import Columns, assemble, read_log
    from keycld_model.delan import motions_of, read_motions

    if path.suffix == ".npz" or path.is_dir() or not path.exists():
        return read_motions(path, log.slide, log.radians, log.band)
    if log.time is None or not log.joint or not log.action:
        raise InputError(f"{path} is a log; name its columns with --time, --joint and --action (the torques).")
    table, units = read_log(path)
    joints, actions = pairs("--joint", log.joint), pairs("--action", log.action, example="hinge=torque")
    units = units | pairs("--unit", log.unit)
    recording = assemble(
        table, Columns(log.time, joints, pairs("--velocity", log.velocity), actions, units=units), path.stem
    )
    return motions_of(str(path), [recording], log.band)


def _names(words: str) -> list[str]:
    return [name.strip() for name in words.split(",") if name.strip()]


def _numbers(effect: Any) -> dict[str, float]:
    return {p.name: getattr(effect, p.name) for p in effect.parameters()}


def _print(summary: dict[str, Any], as_json: bool) -> None:
    """Scores beside each other for people."""
    if as_json:
        print_result(summary, as_json=True)
        return
    scores = summary.pop("scores")
    others = {"base": summary.pop("base", None), "least squares": summary.pop("least_squares", None)}
    others = {who: found for who, found in others.items() if found is not None}
    for name, value in scores.items():
        beside = {who: found[name] for who, found in others.items()}
        summary[name] = {"network": value, **beside} if beside else value
    if "verdict" in summary:
        summary["verdict"] = summary.pop("verdict")
    print_result(summary, as_json=False)
