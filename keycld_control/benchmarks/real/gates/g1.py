"""G1: effects concealed in runs of the double pendulum, of three designs and two controllers, and of a simple one."""

from pathlib import Path

import mujoco

from keycld_control.benchmarks.real.concealed import ConcealedGate, Runs
from keycld_control.benchmarks.real.dfki import identified, leaderboard_runs, system_identification_runs
from keycld_control.benchmarks.real.gates import r6


def simple(folder: Path) -> mujoco.MjModel:
    """The simple pendulum as its owners identified it, without friction."""
    return r6.simulator()


GATE = ConcealedGate(
    name="G1",
    title="concealed effects, baseline given",
    required="0 alarms in 30; named .90, in the reported set .97, placed .97; size within 20 % in .80; intervals cover "
    ".85 to .95; held-out error falls in every true case",
    rigs=(
        Runs("acrobot C.1", identified("C.1", "1.0"), leaderboard_runs("acrobot", "ilqr_tvlqr_lqr", 5), 0.12),
        Runs("pendubot C.1", identified("C.1", "1.0"), leaderboard_runs("pendubot", "ilqr_tvlqr_lqr", 5), 0.12),
        Runs("double pendulum A.0", identified("A.0", "2.0"), system_identification_runs("A.0"), 0.12),
        Runs("double pendulum C.0", identified("C.0", "h1.0"), system_identification_runs("C.0"), 0.12),
        Runs("double pendulum C.1", identified("C.1", "1.0"), system_identification_runs("C.1"), 0.12),
        Runs(
            "simple pendulum",
            simple,
            [r6.run_file(f"control_method_{c}") for c in ("ddp", "direct_collocation", "energy_shaping", "sac")],
            0.15,
        ),
    ),
    cases=100,
    nulls=0.3,
    seed=2,
)
