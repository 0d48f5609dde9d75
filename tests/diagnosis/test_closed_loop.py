"""A slider-crank: a mechanism whose joints depend on each other."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import recordings

from keycld_model.diagnosis import Source, diagnose, write_corrected
from keycld_model.diagnosis.estimation.gauss_newton import minimise
from keycld_model.diagnosis.estimation.problem import Problem
from keycld_model.diagnosis.inputs.observation import JointPositions
from keycld_model.diagnosis.inputs.windows import cut
from keycld_model.diagnosis.simulation.simulator import Simulator

CRANK = """
<mujoco>
  <option gravity="0 0 -9.81" timestep="0.002" integrator="implicitfast"><flag contact="disable"/></option>
  <worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0.15 0 0" size="0.02"/>
      <body name="rod" pos="0.15 0 0"><joint name="rod" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.015"/></body></body>
    <body name="slider" pos="0.55 0 0"><joint name="slider" type="slide" axis="1 0 0"/>
      <geom type="box" size="0.03 0.03 0.03"/></body>
  </worldbody>
  <equality><connect body1="rod" body2="slider" anchor="0.4 0 0"/></equality>
  <actuator><motor name="drive" joint="crank"/></actuator>
</mujoco>
"""


def runs(friction: float, number: int = 6):
    """Recordings of 1.2 s with steps of torque; the plant has a heavier slider and friction there."""
    model, rng = mujoco.MjModel.from_xml_string(CRANK), np.random.default_rng(0)
    model.opt.timestep, model.opt.integrator = 0.001, mujoco.mjtIntegrator.mjINT_RK4
    model.body_mass[3] *= 1.08
    mujoco.mj_setConst(model, mujoco.MjData(model))
    data, t, out = mujoco.MjData(model), 0.01 * np.arange(120), []
    form = recordings("pendulum", 0, number=1, seconds=0.5)[0]
    for run in range(number):
        mujoco.mj_resetData(model, data)
        data.qvel[0] = rng.uniform(-4, 4)
        u, q = np.repeat(rng.uniform(-0.8, 0.8, (12, 1)), 10, axis=0), np.empty((120, 3))
        mujoco.mj_step(model, data, 200)
        for k in range(120):
            q[k], data.ctrl[:] = data.qpos, u[k]
            for _ in range(10):
                data.qfrc_applied[2] = -friction * data.qvel[2]
                mujoco.mj_step(model, data)
        names = {"joint_names": ("crank", "rod", "slider"), "actuator_names": ("drive",)}
        noisy = q + rng.normal(0, 3e-4, q.shape)
        out.append(replace(form, id=str(run), t_action=t, action=u, t_state=t, qpos=noisy, **names))
    return out


@pytest.mark.slow
def test_refitted_masses_leave_only_noise_of_a_closed_loop():
    given = runs(0.0)
    simulator = Simulator(mujoco.MjModel.from_xml_string(CRANK), 0.01)
    problem = Problem(simulator, cut(given, JointPositions(simulator.model).calibrated(given), simulator.step, 40))
    fit = minimise(problem, problem.start())
    masses = [np.exp(x) for n, x in zip(problem.nuisances, fit.point.variant.values, strict=True) if n.kind == "mass"]
    assert masses == pytest.approx([1.0, 1.0, 1.08], abs=0.01)
    assert fit.chi_square < 1.1


@pytest.mark.long
def test_friction_of_the_slider_is_found_and_corrected(tmp_path):
    (tmp_path / "crank.xml").write_text(CRANK)
    source = Source.of_file(tmp_path / "crank.xml")
    report = diagnose(runs(2.0), source.model)
    (finding,) = report.findings
    assert (report.verdict, finding.effect, finding.where["name"]) == ("mismatch", "viscous_friction", "slider")
    assert finding.parameters["b"].value == pytest.approx(2.0, rel=0.01)
    assert report.fit.corrected < 0.01 * report.fit.refitted
    assert report.evidence is not None
    write_corrected(report.evidence, source, tmp_path / "corrected.xml")
    corrected = mujoco.MjModel.from_xml_path(str(tmp_path / "corrected.xml"))
    assert corrected.dof_damping[2] == finding.parameters["b"].value
    np.testing.assert_allclose(corrected.site_pos, report.evidence.corrected.eq_data[0, :6].reshape(2, 3), rtol=1e-12)
