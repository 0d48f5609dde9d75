"""What rendering does on this machine, as one JSON object; a process of its own, for a broken driver may kill it."""

import json
import os
import time
from contextlib import closing, suppress
from typing import Any

SECONDS = 0.5


def probe() -> dict[str, Any]:
    """Backend, driver, and frames/s of the acrobot at 64×64 in both render qualities, or the reason for none."""
    report: dict[str, Any] = {"backend": None, "renderer": None, "frames_per_second": None, "error": None}
    try:
        import keycld_envs  # chooses the backend  # noqa: F401

        report["backend"] = os.environ.get("MUJOCO_GL") or "default"
        report["frames_per_second"] = {quality: _speed(quality, report) for quality in ("fast", "full")}
    except Exception as error:  # whatever is wrong is what the report is for
        report["error"] = f"{error}" or type(error).__name__
    return report


def _speed(quality: Any, report: dict[str, Any]) -> float:
    from keycld_envs.env import KeyCLDEnv

    with closing(KeyCLDEnv("acrobot", render_quality=quality)) as env:
        env.reset(seed=0)
        env.render_frame()
        with suppress(Exception):
            from OpenGL.GL import GL_RENDERER, glGetString

            report["renderer"] = bytes(glGetString(GL_RENDERER) or b"").decode() or None
        frames, start = 0, time.perf_counter()
        while (seconds := time.perf_counter() - start) < SECONDS:
            env.step(env.action_space.sample())
            frames += 1
        return round(frames / seconds, 1)


if __name__ == "__main__":
    print(json.dumps(probe()))
