"""A joint model in the place of a simulator, with the motors that recordings name."""

from collections.abc import Sequence

import mujoco

from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_model.delan.model import JointModel
from keycld_model.delan.read import motors_of
from keycld_model.delan.rig import Motor, rig_of


def simulator_of(model: JointModel, recordings: Sequence[Recording]) -> mujoco.MjModel:
    """The rig of a joint model, with the motors of recordings.

    Raises:
        InputError: if recordings are of other joints, or their actions are no torques.
    """
    motors: list[Motor] | None = None
    for recording in recordings:
        _check_joints(model, recording)
        if recording.action is None:
            continue
        joints, torques = motors_of(f"Recording {recording.id!r}", recording)
        names = [model.config.joints[j] for j in joints]
        found = [Motor(*motor) for motor in zip(recording.actuator_names, names, torques, strict=True)]
        if motors is not None and found != motors:
            raise InputError(
                f"Recording {recording.id!r} has other actuators, or units of them, than those before it: "
                f"{_listed(found)} in place of {_listed(motors)}; record all alike."
            )
        motors = found
    return rig_of(model, motors or [])


def _check_joints(model: JointModel, recording: Recording) -> None:
    joints, kinds = model.config.joints, model.config.kinds
    if recording.joint_names != joints:
        raise InputError(
            f"Recording {recording.id!r} has the joints {list(recording.joint_names)}, the joint model has "
            f"{list(joints)}; diagnose recordings of the model's own joints, in its order."
        )
    units = recording.units.get("qpos", "rad")
    for j, (name, kind) in enumerate(zip(joints, kinds, strict=True)):
        unit = units if isinstance(units, str) else units[j]
        if (unit, kind) in (("m", "hinge"), ("rad", "slide")):
            raise InputError(
                f"Recording {recording.id!r} has positions of {name!r} in {unit}, but the joint model has a {kind} "
                "there; diagnose recordings of the model's own joints."
            )


def _listed(motors: Sequence[Motor]) -> str:
    return ", ".join(f"{motor.name} ({motor.torque:g})" for motor in motors)
