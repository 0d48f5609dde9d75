"""Lossless video of frames, and frame-by-frame decoding of any video."""

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
        output_params=["-level", "3", "-slicecrc", "1"],
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
        InputError: if the file cannot be decoded or holds another number of frames.
    """
    count = 0
    try:
        reader = imageio_ffmpeg.read_frames(
            str(path), input_params=["-err_detect", "crccheck+explode"], output_params=["-fps_mode", "passthrough"]
        )
        width, height = next(reader)["size"]
        for data in reader:
            count += 1
            yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
    except (OSError, RuntimeError, StopIteration) as error:
        reason = str(error).strip().splitlines()[-1:] or ["no frame found"]
        raise InputError(f"{path} cannot be decoded after frame {count} ({reason[0]}); replace the file.") from error
    if count != num_frames:
        raise InputError(
            f"{path} holds {count} readable frames, but t_frame in signals.npz has {num_frames}; "
            "the video is truncated or belongs to another recording."
        )
