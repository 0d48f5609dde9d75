"""All mechanisms whose owners published what they identified, with recordings to learn from and others to test on."""

from collections.abc import Sequence
from functools import partial

from keycld_control.benchmarks.real import dfki, servo
from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.gates import r3, r6
from keycld_control.benchmarks.real.owners import double_pendulum, multiarm, servo_friction, simple_pendulum
from keycld_control.benchmarks.real.owners.versus import OwnersRig

RUNS = ("pd/system_identification", "ddp", "direct_collocation", "ilqr")
"""Of the simple pendulum; in the others somebody pushes it by hand, or holds it."""


def _parted(files: Sequence[RecordingFile]) -> tuple[list[RecordingFile], list[RecordingFile]]:
    """To learn from, and every third, from the second on, to test on."""
    held_out = list(files[1::3])
    return [file for file in files if file not in held_out], held_out


SERVO = OwnersRig(
    "servo xl330",
    *_parted([servo.log_file(name) for name in servo.LOGS]),
    servo_friction.owners_models,
)
RIGS = (
    *(
        OwnersRig(
            f"double pendulum {design}",
            *_parted(dfki.system_identification_runs(design)),
            partial(double_pendulum.owners_models, design=design),
        )
        for design in double_pendulum.MODELS
    ),
    OwnersRig(
        "simple pendulum",
        *_parted([r6.run_file(f"control_method_{run}") for run in RUNS]),
        simple_pendulum.owners_models,
    ),
    SERVO,
    OwnersRig(
        "multiarm",
        [r3.segment("id", i) for i in range(4)],
        [r3.segment("vad", i) for i in range(2)],
        multiarm.owners_models,
    ),
)
