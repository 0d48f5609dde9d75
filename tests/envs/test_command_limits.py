"""Commands that a simulator cuts off are told."""

import numpy as np

from keycld_envs.command_limits import beyond_limits
from keycld_envs.recordings import Recording
from keycld_envs.systems import get_system


def told(name: str, *commands: float) -> Recording:
    still = {"t_state": 0.02 * np.arange(5), "qpos": np.zeros((5, 1)), "joint_names": ("hinge",)}
    signals = {"t_action": 0.02 * np.arange(len(commands)), "action": np.array(commands)[:, None]}
    units, motors = {"qpos": "rad", "action": "1"}, {"actuator_names": ("torque",)}
    return Recording(id=name, source="simulation", units=units, **still, **({**signals, **motors} if commands else {}))


def test_the_worst_command_of_a_motor_is_named():
    model = get_system("pendulum").compile()
    assert not beyond_limits([told("a", 3.0, -3.0000001), told("b")], model)
    (sentence,) = beyond_limits([told("a", 3.2), told("b", 1.0, -3.5), told("c", 3.1)], model)
    assert sentence.startswith("'torque' is told -3.5 in recording 'b', beyond its range of -3 to 3")


def test_a_motor_without_limits_may_be_told_anything():
    model = get_system("pendulum").compile()
    model.actuator_ctrllimited[:] = 0
    assert not beyond_limits([told("a", 99.0)], model)


def test_a_mechanism_without_motors_has_means_of_no_commands():
    still = {"t_state": np.arange(5.0), "qpos": np.zeros((5, 1)), "joint_names": ("hinge",)}
    times, units = np.arange(5.0), {"qpos": "rad", "action": ()}
    run = Recording(id="a", source="simulation", units=units, t_action=times, action=np.zeros((5, 0)), **still)
    assert run.mean_actions(times).shape == (4, 0)
