"""MJCF files that no recording can be compared with: one sentence each."""

import pytest

from keycld_envs.errors import InputError
from keycld_model.diagnosis.inputs.source import Source

MOTOR = '<actuator><motor name="m" joint="b"/></actuator>'
SENSOR = '<sensor><jointpos joint="b"/></sensor>'


@pytest.mark.parametrize(
    ("step", "more", "message"),
    [
        ("0", "", "time step of 0 s; write one between 1e-05 and 0.1 s"),
        ("-1", "", "time step of -1 s"),
        ("1e-7", "", "time step of 1e-07 s"),
        ("0.5", "", "time step of 0.5 s"),
        ("0.002", MOTOR, "does not compile: .*unknown transmission target 'b'.*; mend the document"),
        ("0.002", SENSOR, "does not compile: .*'b'.*; mend the document"),
    ],
)
def test_a_simulator_that_cannot_be_is_refused_in_one_sentence(step, more, message, tmp_path):
    path = tmp_path / "arm.xml"
    body = '<body><joint name="a"/><geom size=".1"/></body>'
    path.write_text(f'<mujoco><option timestep="{step}"/><worldbody>{body}</worldbody>{more}</mujoco>')
    with pytest.raises(InputError, match=message) as caught:
        Source.of_file(path)
    assert "\n" not in str(caught.value)
