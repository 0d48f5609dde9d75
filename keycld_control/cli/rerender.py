"""Draw joint recordings as a camera of the simulator would have seen them."""

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional, UseAppendAction

from keycld_control.cli._output import print_result
from keycld_control.cli._simulator import simulator_of


@dataclass(frozen=True)
class Args:
    """Draw joint recordings as a camera of the simulator would have seen them.

    Real motions, and images of which everything is known: to see whether what works from joint positions works from
    images, and to choose where a camera should stand before one is bought.

    For instance: keycld rerender data/logs --mjcf rig.xml --camera front --out data/filmed

    Attributes:
        recordings: Folder of recordings with joint positions.
        out: Folder to create, with recordings of the same names.
        env: Environment that the recordings are of; by default the one that they name.
        mjcf: MuJoCo XML file of the mechanism instead.
        camera: Camera of the simulator; by default the environment's, or the only one.
        width: Of frames, pixels.
        height: Of frames, pixels.
        fps: Frames per second, at most; each is drawn at a measured sample.
        render_quality: How exact shadows and edges are.
        disturb: What the camera does to images, as NAME=NUMBERS, again for another: shift=2 or shift=RIGHT,UP (pixels),
            brightness=0.7 or R,G,B, offset, zoom, roll, pitch, yaw (rad), blur (pixels), noise (grey levels), jpeg
            (quality).
        seed: Of the noise of images.
        json: Print one JSON object.
    """

    recordings: Positional[Path]
    out: Path
    env: str | None = None
    mjcf: Path | None = None
    camera: str | None = None
    width: int = 64
    height: int = 64
    fps: float = 50.0
    render_quality: Literal["fast", "full"] = "fast"
    disturb: UseAppendAction[tuple[str, ...]] = ()
    seed: int = 0
    json: bool = False


def run(args: Args) -> None:
    """Draw and write."""
    from keycld_control.cli._pairs import pairs
    from keycld_envs.checks import check_number, check_size, the_camera
    from keycld_envs.collect import keep_action_range
    from keycld_envs.disturbance import Disturbance
    from keycld_envs.errors import InputError
    from keycld_envs.files import atomic_folder
    from keycld_envs.progress import progress
    from keycld_envs.recordings import read_dataset, write_recording
    from keycld_envs.registration import system_of
    from keycld_envs.rerender import count_frames, rerender

    size = check_size("--width", args.width), check_size("--height", args.height)
    check_number("--fps", args.fps, above=0.0, most=10_000.0)
    words = pairs("--disturb", args.disturb, "NUMBERS", "brightness=0.7")
    disturbance = Disturbance.parse(words) if words else None
    if args.out.exists():
        raise InputError(f"--out: {args.out} exists; choose another folder, or remove it.")
    recordings = read_dataset(args.recordings).recordings
    source = simulator_of(args.recordings, recordings, args.mjcf, args.env)
    named = args.camera
    if named is None and source.environment is not None:
        with suppress(InputError):  # another library's environment does not say
            named = system_of(source.environment).camera
    camera = the_camera(source.model, named)
    total = sum(count_frames(recording, source.model, args.fps) for recording in recordings)
    with progress("Drawing", total=total) as advance, atomic_folder(args.out) as folder:
        for number, recording in enumerate(recordings):
            drawn = rerender(
                recording,
                source.model,
                camera,
                size=size,
                rate=args.fps,
                quality=args.render_quality,
                disturbance=disturbance,
                seed=args.seed + number,
                advance=advance,
            )
            write_recording(folder / recording.id, drawn)
        keep_action_range(args.recordings, folder)
    print_result(
        {"recordings": args.out, "number": len(recordings), "frames": total, "camera": camera}, as_json=args.json
    )
