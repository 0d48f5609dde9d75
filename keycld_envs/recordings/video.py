"""Lossless video of frames, and frame-by-frame decoding of any video."""

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError


def write_video(path: Path, frames: NDArray[np.uint8], fps: float) -> None:
    """Write frames, [T, H, W, 3], as FFV1 with checksums; every pixel survives.

    Args:
        path: the file to write, ending in .mkv.
        frames: [T, H, W, 3] uint8.
        fps: nominal frame rate in Hz, for video players only; the clock of a recording is `t_frame`.
    """
    writer = imageio_ffmpeg.write_frames(
        str(path),
        (frames.shape[2], frames.shape[1]),
        pix_fmt_in="rgb24",
        pix_fmt_out="bgr0",
        fps=max(1, round(fps)),
        codec="ffv1",
        quality=None,  # pyright: ignore[reportArgumentType]
        macro_block_size=1,
        output_params=["-level", "3", "-slicecrc", "1", "-g", "1"],
    )
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def iter_video(path: Path, num_frames: int) -> Iterator[NDArray[np.uint8]]:
    """Decode a video frame by frame, in constant memory, without dropping or repeating frames.

    Args:
        path: a file ffmpeg can read.
        num_frames: how many frames it must hold.

    Yields:
        [H, W, 3] uint8, RGB.

    Raises:
        InputError: after the last frame, if the decoder reported an error or the number of frames is another.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-nostdin", "-i", str(path), "-map", "0:v:0"]
    command += ["-fps_mode", "passthrough", "-pix_fmt", "rgb24", "-c:v", "ppm", "-f", "image2pipe", "-"]
    count = 0
    with tempfile.TemporaryFile() as log, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as decoder:
        assert decoder.stdout is not None
        try:
            while decoder.stdout.readline():  # "P6", then "WIDTH HEIGHT", "255", and the pixels
                width, height = map(int, decoder.stdout.readline().split())
                decoder.stdout.readline()
                data = decoder.stdout.read(width * height * 3)
                if len(data) < width * height * 3:
                    break
                count += 1
                yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
            decoder.wait()
        finally:
            decoder.kill()
        log.seek(0)
        errors = log.read().decode(errors="replace").splitlines()
    if errors:
        raise InputError(f"{path} is damaged ({errors[0].strip()}); replace the file.")
    if count != num_frames:
        raise InputError(
            f"{path} holds {count} frames, but t_frame in signals.npz has {num_frames}; "
            "the video is truncated or belongs to another recording."
        )
