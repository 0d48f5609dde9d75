"""Swing-up that fails, because the mechanism has physics that nobody knows of; found from pixels; and then succeeds.

python examples/close_the_loop.py
"""

from pathlib import Path

import tyro

from keycld_control.correction.loop import LoopPlan, close_the_loop


def main(system: str = "acrobot", conceal: int = 0, episodes: int = 10, out: Path = Path("loop")) -> None:
    """Conceal physics, explore, diagnose, correct, and count successes.

    Args:
        system: name of a system.
        conceal: seed of what is concealed.
        episodes: swing-ups to count, each time.
        out: folder for recordings, reports and results.
    """
    result = close_the_loop(LoopPlan(system, conceal=conceal, episodes=episodes), out)
    for arm in ("before", "after", "true"):
        print(f"{arm:7} {result[arm]['successes']} of {result[arm]['episodes']}")


if __name__ == "__main__":
    tyro.cli(main)
