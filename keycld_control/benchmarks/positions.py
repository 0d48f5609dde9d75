"""How near positions that are read off frames come to the true ones, in pixels of frames of 64 pixels."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from keycld_control.benchmarks.blind.case import SealedCase, Signals, draw_case, recording
from keycld_control.benchmarks.blind.film import SIZE, Studio, lengthen
from keycld_control.benchmarks.blind.plan import Plan
from keycld_control.benchmarks.figure import Figure
from keycld_envs import REFERENCE_SYSTEMS
from keycld_envs.systems import get_system

Array = NDArray[np.float64]
RUNS, FRAMES = 4, 100
"""Recordings, and frames of each."""
PATH = 15
"""Frames (.3 s) over which errors are averaged for the bias along the path; what is left is noise."""
REQUIRED = {"noise": 0.03, "bias": 0.05}
"""Pixels."""


def position_figures(systems: Sequence[str] = REFERENCE_SYSTEMS, seed: int = 0) -> Iterator[Figure]:
    """Noise and bias of landmarks, pixels, root mean square over frames, landmarks and both directions.

    Links are up to 20 % longer or shorter than the simulator's, the camera is off by some pixels and per cent, and
    pixels have noise, as in the sealed cases; nothing of it is told.

    Args:
        systems: short names.
        seed: of motions, lengths, cameras and noise.
    """
    from keycld_model.image_alignment import read_positions

    for system in systems:
        case, signals = draw_case(Plan("null", system, "open_loop"), (seed, 2), filmed=True)
        assert case.film is not None
        short = [replace(s, t_state=s.t_state[:FRAMES], true=s.true[:FRAMES]) for s in signals[:RUNS]]
        with Studio(system, case.errors) as studio:
            runs = [recording(case, run, s, studio) for run, s in enumerate(short)]
        read = read_positions(runs, get_system(system).compile(), workers=1)
        errors = [_pixels(case, np.asarray(r.qpos), s) for r, s in zip(read.recordings, short, strict=True)]
        bias = np.concatenate([uniform_filter1d(e, PATH, axis=0) for e in errors])
        noise = np.concatenate(errors) - bias
        for name, error in (("noise", noise), ("bias", bias)):
            yield Figure(
                measure=f"{name} of positions read off frames, px",
                system=system,
                reached=float(np.sqrt(np.mean(error**2))),
                required=REQUIRED[name],
                at_most=True,
                count=len(error),
                details={
                    "seed": seed,
                    "film": case.film.answer(),
                    "trusted": read.trusted,
                    "error": read.error.tolist(),
                },
            )


def _pixels(case: SealedCase, read: Array, signals: Signals) -> Array:
    """Of all landmarks, right and up, `[T, 2K]`, pixels of the simulator's camera, where frames could be read."""
    there = np.isfinite(read).all(axis=1)
    system = get_system(case.plan.system)
    model = system.compile()
    lengthen(model, case.errors)
    data = mujoco.MjData(model)

    def seen(positions: Array) -> Array:
        out = []
        for q in positions:
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            out.append(system.keypoints(model, data, SIZE, SIZE).ravel() * (SIZE - 1) / 2)
        return np.array(out)

    return seen(read[there]) - seen(signals.true[there])
