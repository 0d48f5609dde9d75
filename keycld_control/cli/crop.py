"""Cut the frames of recordings to where something moves, and make them small."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from keycld_control.cli._output import print_result

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    from numpy.typing import NDArray

MULTIPLE = 8
"""Pixels; sides of frames that all networks take are multiples of it."""


@dataclass(frozen=True)
class Args:
    """Cut frames to the square in which something moves, and make them as small as models are trained on.

    The camera must stand still. All recordings are cut alike. Image units are others then: it says where a pivot has to
    be declared.

    Attributes:
        data: Folder of recordings.
        out: Folder to create.
        size: Width and height of the new frames, pixels; models take multiples of 8.
        box: Left, top, right and bottom of the square to keep, pixels; by default around what moves.
        json: Print one JSON object.
    """

    data: Positional[Path]
    out: Path
    size: int = 64
    box: tuple[int, int, int, int] | None = None
    json: bool = False


def run(args: Args) -> None:
    """Look for what moves, cut, and write."""
    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_folder
    from keycld_envs.progress import progress
    from keycld_envs.recordings import read_dataset, write_recording
    from keycld_envs.recordings.crop import cropped, moving_box, square, units_of

    if args.size < MULTIPLE or args.size % MULTIPLE:
        raise InputError(f"--size is {args.size}; networks take frames whose sides are multiples of {MULTIPLE}.")
    recordings = read_dataset(args.data).recordings
    if args.out.exists():
        raise InputError(f"{args.out} exists; choose another folder, or remove it.")
    if not recordings[0].num_frames:
        raise InputError(f"{args.data} has no frames to cut; name recordings of a camera.")
    height, width = next(iter(recordings[0].iter_frames())).shape[:2]
    box = args.box
    with progress("Cutting", total=len(recordings) * (1 if box else 2)) as advance:
        if box is None:

            def every() -> "Iterator[NDArray[np.uint8]]":
                for recording in recordings:
                    yield from recording.iter_frames()
                    advance()

            found = moving_box(every())
            if found is None:
                raise InputError(f"Nothing moves in {args.data}; name the square to keep, --box LEFT TOP RIGHT BOTTOM.")
            box = square(found, width, height)
        with atomic_folder(args.out) as folder:
            for recording in recordings:
                write_recording(folder / recording.id, cropped(recording, box, args.size))
                advance()
    (a, b), (c, d) = units_of(box, width, height, args.size)
    result = {"recordings": args.out, "number": len(recordings), "box": box, "size": args.size}
    units = {"factors": (a, b), "shifts": (c, d)}
    moved = f"pivot=(x, y) is ({a:.3f} * x {c:+.3f}, {b:.3f} * y {d:+.3f}) in these frames"
    print_result(result | (units if args.json else {"declared": moved}), as_json=args.json)
