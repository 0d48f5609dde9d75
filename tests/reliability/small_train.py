"""`keycld train` with a recipe of a few steps, saved after each: python small_train.py DATA FOLDER."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "model"))
from sharded import PRESET  # pyright: ignore[reportMissingImports]
from swinging import random_parameters  # pyright: ignore[reportMissingImports]

from keycld_control.cli import main
from keycld_model.modules import Parts
from keycld_model.training import PRESETS, loop

if __name__ == "__main__":
    PRESETS["default"] = PRESET
    setattr(Parts, "initial", lambda parts, seed: random_parameters(parts.config, seed))  # noqa: B010
    loop.SAVE_EVERY, loop.COLLAPSED = 0.0, 0.0
    sys.exit(main(["train", "pendulum", "--data", sys.argv[1], "--out", sys.argv[2]]))
