"""A data set of a video."""

import sys
from pathlib import Path
from typing import Any

from keycld_control.cli._import_options import Args

APART = 0.1
"""Image units between the pivot that is declared and the one that is filmed; beyond, they are two places."""
WITHIN = 0.5
"""Of the square that is kept, inside the picture; with less, more of the frames is repeated border than video."""


def import_video(path: Path, args: Args) -> dict[str, Any]:
    """Look for what moves, cut, and say what became of it.

    Args:
        path: the video.
        args: options of `keycld import`.

    Raises:
        InputError: if it cannot be read, or the folder exists.
    """
    import numpy as np

    from keycld_envs.errors import InputError
    from keycld_envs.mechanism_file import read_mechanism
    from keycld_envs.progress import progress
    from keycld_envs.recordings.importers import film

    given = args.film
    cut = film.Cut(given.size, given.frames, given.every, args.licence, args.origin)
    mechanism = None if given.mechanism is None else read_mechanism(given.mechanism)
    if mechanism is not None and mechanism.num_actions:
        raise InputError(
            f"{given.mechanism} declares num_actions={mechanism.num_actions}, but a video tells of no actions, and "
            "what is learned from it is passive; write num_actions=0, as `keycld new --template video` does."
        )
    fixed = mechanism is not None and (any(rod.start is None for rod in mechanism.rods) or bool(mechanism.sliders))
    if fixed and given.crop is None and given.pivot is None:
        raise InputError(
            f"{given.mechanism} declares a fixed pivot; say where it is in {path} with --pivot COLUMN ROW, or what to "
            "keep with --crop LEFT TOP SIDE."
        )
    with progress("Looking", total=1) as advance:
        look = film.look_at(path, given.fps)
        advance()
    place = (0.0, 0.0) if mechanism is None else mechanism.pivot
    square = film.Square(*given.crop) if given.crop else film.square_around(look, place, given.pivot)
    at = None if given.pivot is None else square.units(*given.pivot)
    if fixed and at is not None and max(abs(a - b) for a, b in zip(at, place, strict=True)) > APART:
        raise InputError(
            f"--crop puts the pivot at ({at[0]:.3f}, {at[1]:.3f}), but {given.mechanism} declares pivot={place}; write "
            "that place into the file, or leave --crop out."
        )
    width, height = look.size
    if given.pivot is not None and not (0 <= given.pivot[0] < width and 0 <= given.pivot[1] < height):
        print(
            f"keycld: warning: --pivot {given.pivot[0]:g} {given.pivot[1]:g} lies outside {path}, whose pictures are "
            f"{width}x{height} pixels; beyond them, the pixels of their border are repeated.",
            file=sys.stderr,
        )
    if (within := square.share_within(look.size)) and within < WITHIN:
        print(
            f"keycld: warning: {path}, {width}x{height} pixels, covers {within:.0%} of the square that is kept, "
            f"{square.left} {square.top} {square.side}; beyond it, the pixels of its border are repeated. A smaller "
            "square, --crop LEFT TOP SIDE, shows more of the mechanism.",
            file=sys.stderr,
        )
    with progress("Cutting", total=len(look.times)) as advance:
        number = film.write_parts(path, args.out, look, square, advance, cut)
    return {
        "data": args.out,
        "recordings": number,
        "frames": cut.frames,
        "frames_per_second": round(float(1 / (cut.every * np.median(np.diff(look.times)))), 3),
        "used": number * cut.frames * cut.every / len(look.times),
        "crop": (square.left, square.top, square.side),
        "pivot": at,
    }
