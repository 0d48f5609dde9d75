"""Video files: written by ffmpeg and read back before they count, and any video decoded frame by frame."""

import re
import subprocess
import tempfile
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray

from keycld_envs.errors import InputError
from keycld_envs.reading import check_file, check_size

Frame = NDArray[np.uint8]
H264 = {"codec": "libx264", "output_params": ["-crf", "20", "-preset", "fast", "-movflags", "+faststart", "-f", "mp4"]}
"""Options of `write_video` for clips to look at, which every browser plays."""
PLAINLY = {
    "moov atom not found": "it is cut short, or no MP4",
    "matches no streams": "it holds no pictures",
}
"""Parts of what ffmpeg says, and what that means."""
SQUARE = "scale=round(iw*sar):ih"
"""Filter of ffmpeg that makes pixels square which are shown wider or narrower ("sample aspect ratio"); no others."""
LOSSY = 20.0
"""Mean difference, of 255, up to which a frame and its copy by a lossy encoder are the same."""


def write_video(path: Path, frames: Iterable[Frame], size: tuple[int, int], fps: float, **options: Any) -> None:
    """Encode frames, and read the file back.

    Args:
        path: the file to write.
        frames: each [H, W, 3] uint8.
        size: (W, H), pixels.
        fps: nominal frame rate, Hz.
        **options: of `imageio_ffmpeg.write_frames`; by default FFV1 with checksums, in which every pixel survives.

    Raises:
        InputError: if the encoder failed, as on a full disk, or the file does not hold all frames.
    """
    lossless = not options
    if lossless:
        options = {
            "pix_fmt_in": "rgb24",
            "pix_fmt_out": "bgr0",
            "codec": "ffv1",
            "output_params": ["-level", "3", "-slicecrc", "1", "-g", "1"],
        }
    with warnings.catch_warnings():  # subprocess runs a program at once, so JAX's threads are in no danger
        warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
        writer = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=fps,  # pyright: ignore[reportArgumentType]
            quality=None,  # pyright: ignore[reportArgumentType]
            macro_block_size=1,
            **options,
        )
        count, last = 0, None
        try:
            writer.send(None)
            for frame in frames:
                last = np.ascontiguousarray(frame)
                writer.send(last)
                count += 1
        except OSError as error:
            raise _not_whole(path) from error
        finally:
            writer.close()
    if last is not None:
        _check_written(path, count, last, 0.0 if lossless else LOSSY)


def _check_written(path: Path, count: int, last: Frame, tolerance: float) -> None:
    """Compare the number of frames in a file, and the last of them, with what was to be written."""
    found, frame = 0, None
    try:
        for frame in decode(path):  # noqa: B007
            found += 1
    except (OSError, ValueError) as error:
        raise _not_whole(path) from error
    if found != count or frame is None or frame.shape != last.shape:
        raise _not_whole(path)
    if np.abs(frame.astype(np.int16) - last).mean() > tolerance:
        raise _not_whole(path)


def _not_whole(path: Path) -> InputError:
    parts = (part[1:].removesuffix(".partial") if part.endswith(".partial") else part for part in path.parts)
    return InputError(f"{Path(*parts)} could not be written whole; free space on its disk and run again.")


def decode(
    path: Path, size: tuple[int, int] | None = None, crop: tuple[int, int, int, int] | None = None
) -> Iterator[Frame]:
    """Decode a video frame by frame, in constant memory, without dropping or repeating frames, as it is shown.

    It is turned, and pixels that are not square are made so.

    Args:
        path: a file ffmpeg can read.
        size: (W, H) to reduce frames to by averaging areas, pixels; by default they stay as they are.
        crop: (left, top, W, H) of the part that is kept before that, pixels, inside the frame.

    Yields:
        [H, W, 3] uint8, RGB.

    Raises:
        OSError: if there is no such file.
        ValueError: if it is no regular file, or, after the last frame, if the decoder reported an error.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-nostdin", "-i", str(check_file(path)), "-map", "0:v:0"]
    filters = [SQUARE] if crop is None else [SQUARE, "crop={2}:{3}:{0}:{1}:exact=1".format(*crop)]
    filters += [] if size is None else [f"scale={size[0]}:{size[1]}:flags=area"]
    command += ["-vf", ",".join(filters)]
    command += ["-fps_mode", "passthrough", "-pix_fmt", "rgb24", "-c:v", "ppm", "-f", "image2pipe", "-"]
    with tempfile.TemporaryFile() as log, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as decoder:
        assert decoder.stdout is not None
        try:
            while decoder.stdout.readline():  # "P6", then "WIDTH HEIGHT", "255", and the pixels
                width, height = map(int, decoder.stdout.readline().split())
                check_size(3.0 * width * height)
                decoder.stdout.readline()
                data = decoder.stdout.read(width * height * 3)
                if len(data) < width * height * 3:
                    break
                yield np.frombuffer(data, np.uint8).reshape(height, width, 3)
            decoder.wait()
        finally:
            decoder.kill()
        log.seek(0)
        errors = log.read(10_000).decode(errors="replace").splitlines()
    if errors:
        raise ValueError(_plain(errors[0]))


def _plain(line: str) -> str:
    """A line of ffmpeg's log without the addresses in front of it; what is met most often is said in other words."""
    words = re.sub(r"^(\[[^]]*\] *)+", "", line.strip())
    return next((said for part, said in PLAINLY.items() if part in words), words)


def frame_times(path: Path) -> NDArray[np.float64]:
    """When each frame of a video is shown, by the file's presentation time stamps.

    Returns:
        [T], seconds from the first frame on, in the order in which `decode` yields the frames; where a frame has no
        time stamp, or two have the same, the clock does not say when they were taken, and the array is empty.

    Raises:
        OSError: if there is no such file.
    """
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-hide_banner", "-nostdin", "-nostats", "-i", str(check_file(path))]
    command += ["-map", "0:v:0", "-fps_mode", "passthrough", "-vf", "showinfo", "-f", "null", "-"]
    shown = subprocess.run(command, capture_output=True, check=False).stderr.decode(errors="replace")
    stamps = re.findall(r"\bn: *\d+ pts: *\S+ pts_time:(\S+)", shown)
    if not stamps or "NOPTS" in stamps:
        return np.empty(0)
    times = np.array(stamps, float)
    return times - times[0] if (np.diff(times) > 0).all() else np.empty(0)


def iter_video(path: Path, num_frames: int) -> Iterator[Frame]:
    """The frames of a recording's video; see `decode`.

    Args:
        path: a file ffmpeg can read.
        num_frames: how many frames it must hold.

    Yields:
        [H, W, 3] uint8, RGB.

    Raises:
        InputError: after the last frame, if the decoder reported an error or the number of frames is another.
    """
    count = 0
    try:
        for frame in decode(path):
            count += 1
            yield frame
    except (OSError, ValueError) as error:
        raise InputError(f"{path} is damaged ({error}); replace the file.") from error
    if count != num_frames:
        raise InputError(
            f"{path} holds {count} frames, but t_frame in signals.npz has {num_frames}; "
            "the video is truncated or belongs to another recording."
        )
