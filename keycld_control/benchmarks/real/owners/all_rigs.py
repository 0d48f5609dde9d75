"""All mechanisms whose owners published what they identified, with recordings to learn from and others to test on."""

from collections.abc import Sequence
from functools import partial

from keycld_control.benchmarks.real import servo
from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.owners import double_pendulum, multiarm, servo_friction, simple_pendulum
from keycld_control.benchmarks.real.owners.versus import OwnersRig
from keycld_control.benchmarks.real.rigs import named_rig


def parted(files: Sequence[RecordingFile]) -> tuple[list[RecordingFile], list[RecordingFile]]:
    """To learn from, and every third, from the second on, to test on."""
    held_out = list(files[1::3])
    return [file for file in files if file not in held_out], held_out


def owners_rigs() -> dict[str, OwnersRig]:
    """By name."""
    decay = named_rig("multiarm_pendulum").files
    rigs = [
        *(
            OwnersRig(
                f"double pendulum {design}",
                *parted(named_rig(f"double_pendulum_{design.replace('.', '')}").files["identification"]),
                partial(double_pendulum.owners_models, design=design),
            )
            for design in double_pendulum.MODELS
        ),
        OwnersRig(
            "simple pendulum",
            *parted(named_rig("simple_pendulum").files["untouched"]),
            simple_pendulum.owners_models,
        ),
        OwnersRig("servo xl330", *parted([servo.log_file(name) for name in servo.LOGS]), servo_friction.owners_models),
        OwnersRig(
            "multiarm pendulum", list(decay["identification"]), list(decay["validation"]), multiarm.owners_models
        ),
    ]
    return {rig.name: rig for rig in rigs}
