"""A diagnosis of an arm of one's own through the command line."""

import json
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from plants import recordings

from keycld_control.cli import main
from keycld_envs.recordings import write_recording


@pytest.mark.long
def test_two_effects_at_once_and_the_masses_of_an_arm_of_ones_own(tmp_path):
    """The command line, with an MJCF file of two links, which is no system of ours."""
    mjcf = tmp_path / "arm.xml"
    link = (
        '<body name="{0}" pos="0 0 {1}"><joint name="{0}" axis="0 1 0"/>'
        '<geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/>'
    )
    mjcf.write_text(
        "<mujoco><option gravity='0 0 -9.81' timestep='.002'><flag contact='disable'/></option><worldbody>"
        + link.format("a", 0)
        + link.format("b", -0.3)
        + "</body>" * 2
        + "</worldbody><actuator><motor name='m' joint='b'/></actuator></mujoco>"
    )
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    true, rng = mujoco.MjModel.from_xml_path(str(mjcf)), np.random.default_rng(0)
    true.body_mass[2] *= 1.1
    true.body_inertia[2] *= 1.1
    true.opt.timestep, true.opt.integrator = 0.001, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(true)
    mujoco.mj_setConst(true, data)
    t = 0.01 * np.arange(160)
    for run in range(6):
        mujoco.mj_resetData(true, data)
        data.qpos[:] = rng.uniform(-1, 1, 2)
        u, q = np.repeat(rng.uniform(-1, 1, (11, 1)), 15, axis=0)[: len(t)], np.empty((len(t), 2))
        for k in range(len(t)):
            q[k] = data.qpos
            for _ in range(10):
                data.ctrl[:] = u[k]
                data.qfrc_applied[:] = -0.02 * data.qvel[0], 0.05
                mujoco.mj_step(true, data)
        recording = replace(
            recordings("pendulum", 0, number=1, seconds=0.5)[0],
            id=f"{run}",
            joint_names=("a", "b"),
            actuator_names=("m",),
            t_action=t,
            action=u,
            t_state=t,
            qpos=q + rng.normal(0, 5e-4, q.shape),
        )
        write_recording(tmp_path / "data" / f"{run}", recording)
    out = tmp_path / "report"
    assert main(["diagnose", str(tmp_path / "data"), "--mjcf", str(mjcf), "--out", str(out)]) == 10
    report = json.loads((out / "report.json").read_text())
    found = {(f["effect"], f["where"]["name"]) for f in report["findings"]}
    assert found == {("viscous_friction", "a"), ("constant_force", "b")}
    assert report["nuisance"]["mass of b"]["value"] == pytest.approx(1.1, abs=0.05)
    corrected = mujoco.MjModel.from_xml_path(str(out / "corrected.xml"))
    assert corrected.body_mass[2] / model.body_mass[2] == pytest.approx(1.1, abs=0.05)
    assert corrected.dof_damping == pytest.approx([0.02, 0], abs=0.005)
    assert 'ConstantForce("b", f=0.0' in (out / "corrected.xml").read_text()
    page = (out / "report.html").read_text()
    for f in report["findings"]:
        assert f'data-effect="{f["effect"]}" data-kind="joint" data-place="{f["where"]["name"]}"' in page
    assert model.body_mass[2] == mujoco.MjModel.from_xml_path(str(mjcf)).body_mass[2]
