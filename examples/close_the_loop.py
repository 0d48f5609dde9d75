"""Swing-up that fails, because the mechanism has physics that nobody knows of; found from pixels; and then succeeds.

python examples/close_the_loop.py
"""

from pathlib import Path

from keycld_control.correction.loop import LoopPlan, close_the_loop

if __name__ == "__main__":
    result = close_the_loop(LoopPlan("acrobot", conceal=0, episodes=10), Path("loop"))
    for arm in ("before", "after", "true"):
        print(f"{arm:7} {result[arm]['successes']} of {result[arm]['episodes']}")
