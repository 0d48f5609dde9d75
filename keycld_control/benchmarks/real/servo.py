"""The servo XL330 on the pendulum bench of Rhoban: its logs, its law, and its simulator without friction."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_control.benchmarks.real.parameter_files import numbers_of
from keycld_envs.errors import InputError
from keycld_envs.recordings.importers import Columns, Table, read_json_log

FOLDER = "rhoban_bam"
LOGS = {
    f"kp {kp} {motion}": f"2026-01-15_10h{time}"
    for (kp, motion), time in zip(
        [(kp, motion) for kp in (100, 200, 400, 800) for motion in ("sin_sin", "up_and_down")],
        ("28m10", "28m24", "28m42", "28m57", "29m14", "29m29", "29m47", "30m02"),
        strict=True,
    )
}
"""Files by gain and motion."""
MASS, LENGTH, GRAVITY = 0.49, 0.1, 9.80665
"""kg at so many m from the axis, and m/s^2."""
SUPPLY = 7.4
"""V."""
DUTY_PER_ERROR = 4096 / (2 * np.pi) / 256 / 885
"""Share of the supply that the firmware switches on per rad of error and unit of gain: 4096 counts per turn, a gain of
kp/256, and 885 for the whole supply (bam/dynamixel/actuator.py). What the servo reports as "load" is this share."""


def read_servo_log(path: Path) -> Table:
    """A log with the column "volts": what the servo's law switches on, V.

    The law is part of what is known. Taken at the measured angle, its voltage is one input whatever the gain, so that
    one simulator serves all logs; it is within 1 % of the supply of what servos report.

    Raises:
        InputError: if the log is not one of a servo.
    """
    table = read_json_log(path)
    missing = sorted({"goal_position", "position", "kp", "vin"} - set(table.columns))
    if missing:
        raise InputError(f"{path} has no {missing[0]!r}; a log of a servo holds its goal, position, gain and supply.")
    goal, position, kp, supply = (table.columns[name] for name in ("goal_position", "position", "kp", "vin"))
    duty = np.clip(DUTY_PER_ERROR * kp * (goal - position), -1.0, 1.0)
    return replace(table, columns={**table.columns, "volts": supply * duty})


def log_file(name: str) -> RecordingFile:
    """One of `LOGS`; the action is the voltage."""
    columns = Columns(
        "timestamp", {"hinge": "position"}, {}, {"servo": "volts"}, units={"position": "rad", "volts": "V"}
    )
    path = f"{FOLDER}/raw/{LOGS[name]}.json"
    return RecordingFile(path, columns, name, "Apache-2.0", "Rhoban/bam: xl330", read_servo_log)


def motor_constants(folder: Path, model: str = "m6") -> Mapping[str, float]:
    """What the owners identified, by name: kt N m/A, R ohm, armature kg m^2, q_offset rad, and friction.

    Raises:
        InputError: if the file is missing or damaged.
    """
    return numbers_of(folder / FOLDER / f"params/xl330/{model}.json", ("kt", "R", "armature", "q_offset"))


def servo(kt: float, resistance: float, armature: float, offset: float) -> mujoco.MjModel:
    """A mass on the servo's horn, "hinge", and a motor "servo" that is told a voltage, V; without friction.

    Args:
        kt: torque per current behind the gear, N m/A, which is also the voltage of the turning motor, V s/rad.
        resistance: ohm.
        armature: inertia of the rotor behind the gear, kg m^2.
        offset: angle of the horn where the servo says zero, rad.
    """
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/>
        <option timestep="0.005" gravity="0 0 {-GRAVITY}" integrator="RK4"><flag contact="disable"/></option>
        <worldbody><body name="link" euler="0 {offset!r} 0"><inertial pos="0 0 {-LENGTH}" mass="{MASS}"
        diaginertia="1e-6 1e-6 1e-6"/><joint name="hinge" axis="0 1 0" armature="{armature!r}"/></body></worldbody>
        <actuator><general name="servo" joint="hinge" ctrlrange="{-SUPPLY} {SUPPLY}" gainprm="{kt / resistance!r}"
        biastype="affine" biasprm="0 0 {-(kt**2) / resistance!r}"/></actuator></mujoco>"""
    )


def simulator(folder: Path, model: str = "m6") -> mujoco.MjModel:
    """The servo with motor constants that the owners identified."""
    known = motor_constants(folder, model)
    return servo(known["kt"], known["R"], known["armature"], known["q_offset"])
