"""Conceal, explore, diagnose, correct, and count successes before and after."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import mujoco

from keycld_control.closed_loop import LoopSettings, make_loop, run_episode
from keycld_control.correction.concealed import conceal
from keycld_control.correction.corrections import corrections_of
from keycld_control.correction.explore import REPEATS, explore, follow
from keycld_control.plain_json import plain, write_json
from keycld_control.swingup import swing_up
from keycld_envs import KeyCLDEnv, make, resolve_env_id
from keycld_envs.checks import MOST_WORKERS, check_whole
from keycld_envs.effects import Effect
from keycld_envs.effects.stored import effect_to_json, effects_from_json
from keycld_envs.errors import InputError
from keycld_envs.files import one_writer
from keycld_envs.reading import read_json
from keycld_envs.recordings import Recording, read_dataset
from keycld_model import WorldModel
from keycld_model.checkpoint import check_same_run

Observe = Literal["pixels", "both", "states"]
PROBES = 6
"""Episodes, other than those that are counted, of which the uncorrected agent must fail in more than half."""
PROBE_SEED = 900_000
LINKS = 0.02
"""Spread of the logarithms of masses and lengths, which are those that the model was trained on. Were they free, as in
a mechanism that nobody has measured, a weak motor on a single joint would look like a heavy link."""
SCHEMA = "keycld.loop/1"


@dataclass(frozen=True)
class LoopPlan:
    """What determines a loop's result.

    Attributes:
        system: short name or environment id.
        conceal: seed of the combination of effects, and of the exploration.
        episodes: counted after the correction.
        baseline_episodes: counted in each of the other columns, with the same first starts; None takes as many.
        recordings: runs of the exploration.
        experiments: to follow at most, of those that a diagnosis proposes where they would tell rivals apart, each with
            another diagnosis after it.
        observe: what the diagnosis compares: frames, measured joint positions, or both.
        fine_tune: also train the model on the recordings, and count with it.
        seed: of the first counted episode.
    """

    system: str
    conceal: int
    episodes: int = 100
    baseline_episodes: int | None = None
    recordings: int = 12
    experiments: int = 1
    observe: Observe = "pixels"
    fine_tune: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", resolve_env_id(self.system))
        if self.baseline_episodes is None:
            object.__setattr__(self, "baseline_episodes", self.episodes)
        floors = (
            ("conceal", 0),
            ("episodes", 1),
            ("baseline_episodes", 1),
            ("recordings", 3),
            ("experiments", 0),
            ("seed", 0),
        )
        for name, least in floors:
            if getattr(self, name) < least:
                raise InputError(f"{name} is {getattr(self, name)}; it must be at least {least}.")


def close_the_loop(plan: LoopPlan, out: Path, workers: int = 1) -> dict[str, Any]:
    """Run the whole loop; what an interrupted call has finished is kept.

    Args:
        plan: what to do.
        out: folder for recordings, the diagnosis' report, the corrected checkpoint, and results.
        workers: processes that run episodes and read frames; the result does not depend on it.

    Returns:
        JSON-compatible: the concealed effects, those found, those the model cannot be given, and for each of "before",
        "after", "true" (corrected by the concealed effects themselves) and "fine_tuned" what `swing_up` says.

    Raises:
        InputError: if there are no weights, the folder holds another loop, or nothing makes the agent fail.
    """
    check_whole("workers", workers, 1, MOST_WORKERS)
    model = WorldModel.load(plan.system)  # before there is a folder
    with one_writer(out):
        settings = plain({"schema": SCHEMA, **asdict(plan)})
        check_same_run(out, _kept(out / "plan.json", lambda: settings), settings)
        base = LoopSettings(plan.system, seed=plan.seed)
        drawn = _kept(out / "concealed.json", lambda: _conceal(plan, base))
        concealed = effects_from_json(drawn["effects"], f"{out / 'concealed.json'}: effects")
        report, followed = _report(plan, model, concealed, out, workers)
        found, left = corrections_of(report, str(out / "report.json"))
        model.with_effects(found).save(out / "corrected")
        arms = {"before": {}, "after": {"corrections": found}, "true": {"corrections": concealed}}
        if plan.fine_tune:
            _fine_tune(model, out / "recordings", out / "fine_tuned", plan.conceal)
            arms["fine_tuned"] = {"weights": str(out / "fine_tuned")}
        base = replace(base, effects=concealed)
        counts = {arm: _count(arm, replace(base, **changes), plan, out, workers) for arm, changes in arms.items()}
        result = {
            **settings,
            "concealed": drawn["effects"],
            "passed_over": drawn["passed_over"],
            "verdict": report["verdict"],
            "found": [effect_to_json(effect) for effect in found],
            "not_corrected": left,
            "experiments": followed,
            **counts,
        }
        write_json(out / "loop.json", result)
        return result


def _report(
    plan: LoopPlan, model: WorldModel, concealed: Sequence[Effect], out: Path, workers: int
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The report of the last diagnosis, written as report.json, and the experiments that followed from those before."""
    folder, followed = out / "recordings", []
    recordings = explore(folder, plan.system, model, concealed, plan.recordings, plan.conceal)
    while True:
        path = out / "reports" / f"{len(followed)}.json"
        report = _kept(path, partial(_diagnose, plan, recordings, workers))
        proposed = report["next_experiment"]
        if len(followed) == plan.experiments or proposed is None or not proposed["decisive"]:
            write_json(out / "report.json", report)
            return report, followed
        first = plan.recordings + REPEATS * len(followed)
        recordings = follow(folder, plan.system, model, concealed, proposed, first, plan.conceal)
        followed.append(proposed)


def _count(arm: str, settings: LoopSettings, plan: LoopPlan, out: Path, workers: int) -> dict[str, Any]:
    """What `swing_up` says of one column of the table."""
    episodes = plan.episodes if arm == "after" else plan.baseline_episodes
    assert episodes is not None
    return _kept(out / "results" / f"{arm}.json", lambda: asdict(swing_up(settings, episodes, workers)))


def _kept(path: Path, made: Callable[[], Any]) -> Any:
    """What an earlier call has written, or else what is made now, written."""
    if not path.exists():
        write_json(path, plain(made()))
    return read_json(path)


def _conceal(plan: LoopPlan, base: LoopSettings) -> dict[str, Any]:
    """Draw effects with which the agent fails in more than half of some episodes."""
    with make_loop(base) as loop:

        def fails(effects: tuple[Effect, ...]) -> bool:
            shape = {"width": loop.env.width, "height": loop.env.height}
            env = make(loop.env_id, disable_env_checker=True, effects=effects, **shape).unwrapped
            assert isinstance(env, KeyCLDEnv)
            done = [0, 0]
            with closing(env):
                for probe in range(PROBES):
                    done[run_episode(loop._replace(env=env), PROBE_SEED + probe).success] += 1
                    if 2 * done[True] >= PROBES or 2 * done[False] > PROBES:
                        break
            return done[False] > done[True]

        effects, passed = conceal(loop.env.system, plan.conceal, fails)
    return {"effects": [effect_to_json(effect) for effect in effects], "passed_over": passed}


def _diagnose(plan: LoopPlan, recordings: Sequence[Recording], workers: int) -> dict[str, Any]:
    """The report of a diagnosis against the simulator without effects."""
    from keycld_model.diagnosis import diagnose, diagnose_images
    from keycld_model.diagnosis.criteria import STANDARD

    simulator = environment_simulator(plan.system)
    criteria = replace(STANDARD, spreads=replace(STANDARD.spreads, mass=LINKS))
    if plan.observe == "states":
        return diagnose(recordings, simulator, criteria=criteria).to_dict()
    encoders = plan.observe == "both"
    return diagnose_images(recordings, simulator, encoders=encoders, criteria=criteria, workers=workers).to_dict()


def environment_simulator(env_id: str) -> mujoco.MjModel:
    """What recordings are compared with: an environment's simulator, with the range that it gives its motors."""
    from keycld_model.diagnosis import Source

    return Source.of_environment(env_id).model


def _fine_tune(model: WorldModel, recordings: Path, out: Path, seed: int) -> None:
    """Go on training the model's dynamics on the recordings; nothing if that is done."""
    from keycld_model.training import FINE_TUNING, train

    if not (out / "weights.safetensors").exists():
        train(read_dataset(recordings), model.config, out, FINE_TUNING, seed, start=model.parameters)
