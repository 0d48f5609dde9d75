"""Conceal an effect in recordings."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result
from keycld_control.cli._simulator import simulator_of
from keycld_control.plain_json import write_json

if TYPE_CHECKING:
    import mujoco

    from keycld_envs.effects import Effect


@dataclass(frozen=True)
class Args:
    """Conceal an effect in recordings, to see whether a diagnosis of your own rig finds it.

    Mechanism and sensors stay as they are; commands, or the sensors' clock, are changed as if the effect acted and
    nobody knew.

    For instance: keycld conceal data --mjcf rig.xml --effect coulomb_friction --at elbow --set c=0.15 --out concealed

    Attributes:
        recordings: Folder of recordings with joint positions and commands.
        effect: Name of the effect, such as viscous_friction or actuator_delay.
        at: Its joint, actuator, "clock" (of the sensors), "world", or axis of the world.
        out: Folder to create, with recordings of the same names, and concealed.json, which tells what is concealed.
        set: Its parameters, as NAME=NUMBER.
        env: Environment that the recordings are of; by default the one that they name.
        mjcf: MuJoCo XML file of the mechanism instead.
        only: Recordings to conceal it in, by name; the others are copied. By default all.
        json: Print one JSON object.
    """

    recordings: Positional[Path]
    effect: str
    at: str
    out: Path
    set: UseAppendAction[tuple[str, ...]] = ()
    env: str | None = None
    mjcf: Path | None = None
    only: tuple[str, ...] = ()
    json: bool = False


def run(args: Args) -> None:
    """Conceal, write, and say how large it is."""
    import numpy as np

    from keycld_envs.collect import keep_action_range
    from keycld_envs.command_limits import beyond_limits
    from keycld_envs.conceal import conceal
    from keycld_envs.errors import InputError
    from keycld_envs.files import one_writer
    from keycld_envs.progress import progress
    from keycld_envs.recordings import read_dataset, write_recording

    recordings = read_dataset(args.recordings).recordings
    model = simulator_of(args.recordings, recordings, args.mjcf, args.env).model
    effect = effect_of(args.effect, args.at, args.set, model)
    if unknown := sorted(set(args.only) - {r.id for r in recordings}):
        raise InputError(
            f"--only: {args.recordings} has no recording {unknown[0]!r}; it has {', '.join(r.id for r in recordings)}."
        )
    if args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise InputError(f"--out: {args.out} exists; name a new folder.")
    chosen = [r for r in recordings if not args.only or r.id in args.only]
    with progress("Concealing", total=len(chosen)) as advance:
        concealed = {}
        for recording in chosen:
            concealed[recording.id] = conceal(recording, model, effect)
            advance()
    if cut := beyond_limits((c.recording for c in concealed.values()), model):
        raise InputError(f"So that {effect.id} is concealed, {cut[0]}; conceal less of it, or in weaker commands.")
    hidden = np.mean([c.hidden for c in concealed.values()], axis=0).tolist()
    if not effect.observes and not any(hidden):
        known = ", ".join(f"--set {p.name}=NUMBER" for p in effect.parameters())
        raise InputError(f"{effect} does nothing in these recordings; say how large it is, with {known}.")
    rms = dict(zip([model.joint(j).name for j in range(model.njnt)], hidden, strict=True))
    truth = {
        "effect": effect.id,
        "where": effect.where,
        "parameters": {p.name: getattr(effect, p.name) for p in effect.parameters()},
        "recordings": list(concealed),
        "hidden_rms": rms,
    }
    with one_writer(args.out):
        for recording in recordings:
            changed = concealed.get(recording.id)
            write_recording(args.out / recording.id, recording if changed is None else changed.recording)
        keep_action_range(args.recordings, args.out)
        write_json(args.out / "concealed.json", truth)
    sizes = {f"rms at {joint} (N m or N)": value for joint, value in rms.items()}
    print_result(truth if args.json else {"concealed": str(effect), **sizes}, as_json=args.json)


def effect_of(name: str, where: str, numbers: tuple[str, ...], model: "mujoco.MjModel") -> "Effect":
    """An effect by its name, place and numbers.

    Raises:
        InputError: if there is none of that name, it cannot be there, or a number is not one of its own.
    """
    from keycld_control.cli._pairs import pairs
    from keycld_envs.effects import EFFECTS
    from keycld_envs.effects.added_physics import check_numbers
    from keycld_envs.errors import InputError

    if name not in EFFECTS:
        raise InputError(f"--effect: there is no effect {name!r}; there are {', '.join(sorted(EFFECTS))}.")
    places = {effect.where: effect for effect in EFFECTS[name].candidates(model)}
    if where not in places:
        can = f"it can be at {', '.join(places)}" if places else "the model has no place for it"
        raise InputError(f"--at: {name} cannot be at {where!r}; {can}.")
    known = {p.name for p in EFFECTS[name].parameters()}
    given: dict[str, float] = {}
    for key, value in pairs("--set", numbers, "NUMBER", "c=0.1").items():
        if key not in known:
            raise InputError(f"--set: {name} has no parameter {key!r}; it has {', '.join(sorted(known))}.")
        try:
            given[key] = float(value)
        except ValueError as error:
            raise InputError(f"--set: {key}={value} is no number; write, for instance, {key}=0.1.") from error
    effect = replace(places[where], **given)
    check_numbers(effect)
    if effect == places[where]:
        raise InputError(f"--set: {name} without numbers does nothing; say how large it is, --set {min(known)}=NUMBER.")
    return effect
