"""The main axes of a KUKA KR 300 (JonasWeigand/Robot_Identification): two runs of 10 s at 250 Hz, all axes moving.

Positions are those of the motors; the wrist's axes, whose masses are small, are left out.
"""

from keycld_control.benchmarks.real.gate import RecordingFile
from keycld_envs.recordings.importers import Columns, read_mat

RATIOS = (256.85714, 267.42857, 252.33333)
"""Of the gears, `para.u` in the files: torques are logged at the motors."""
AXES = tuple(f"axis_{i + 1}" for i in range(len(RATIOS)))
COLUMNS = Columns(
    time="rec.time_cont",
    joints={axis: f"rec.act_pos_mot_deg[{i}]" for i, axis in enumerate(AXES)},
    actions={axis: f"rec.act_torque_abs_nm[{i}]" for i, axis in enumerate(AXES)},
    units={f"rec.act_pos_mot_deg[{i}]": "deg" for i in range(len(RATIOS))}
    | {f"rec.act_torque_abs_nm[{i}]": f"{ratio} N m" for i, ratio in enumerate(RATIOS)},
)


def run(name: str) -> RecordingFile:
    """Run A or B."""
    return RecordingFile(
        f"kuka_identification/{name}/data.mat",
        COLUMNS,
        f"KUKA {name}",
        "MIT",
        "JonasWeigand/Robot_Identification",
        read_mat,
    )
