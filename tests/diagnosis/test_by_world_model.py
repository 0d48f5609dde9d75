"""A world model as sensor and simulator of the diagnosis: images alone, and nobody's MJCF."""

import json
from contextlib import closing
from dataclasses import replace

import mujoco
import numpy as np
import pytest

from keycld_control.cli import main
from keycld_control.cli.diagnose import _write_corrected_world_model
from keycld_envs import KeyCLDEnv, make, resolve_env_id
from keycld_envs.collect import CollectSettings, record_episode
from keycld_envs.effects import ViscousFriction
from keycld_envs.errors import InputError
from keycld_envs.projection import world_to_image
from keycld_envs.recordings import write_recording
from keycld_envs.systems import get_system
from keycld_model import WorldModel
from keycld_model.diagnosis import Report, diagnose_by_world_model
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Unexplained
from keycld_model.learned_mjcf import learned_mjcf, places_of
from keycld_model.learned_positions import learned_positions

SYSTEMS = ("pendulum", "cartpole", "acrobot")


def filmed(system, effects=(), number=6, frames=100, seed=0):
    """Recordings of the frames and commands of an environment, and its true positions."""
    settings = CollectSettings(resolve_env_id(system), frames, "piecewise", action_range=1.0, seed=seed)
    env = make(settings.env_id, disable_env_checker=True, effects=tuple(effects)).unwrapped
    assert isinstance(env, KeyCLDEnv)
    with closing(env):
        runs = [record_episode(env, settings, index) for index in range(number)]
    blind = [replace(r, qpos=None, qvel=None, t_state=None, joint_names=()) for r in runs]
    return blind, [np.asarray(r.qpos) for r in runs]


@pytest.mark.parametrize("name", SYSTEMS)
def test_in_units_of_the_system_torques_are_newton_metres(name):
    learned = mujoco.MjModel.from_xml_string(learned_mjcf(WorldModel.load(name), of_system=True).xml)
    true = get_system(name).compile()
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (5, true.nq)):
        forces = []
        for model in (learned, true):
            data = mujoco.MjData(model)
            data.qpos[:], data.ctrl[:] = q, 1.0
            mujoco.mj_forward(model, data)
            inertia = np.zeros((model.nv, model.nv))
            mujoco.mj_fullM(model, data, inertia)
            forces.append((data.qfrc_actuator.copy(), data.qfrc_bias - data.qfrc_passive))
        scale = np.abs(forces[1][0]).max()
        np.testing.assert_allclose(forces[0][0], forces[1][0], atol=0.05 * scale)
        np.testing.assert_allclose(forces[0][1], forces[1][1], atol=0.05 * np.abs(forces[1][1]).max() + 0.02)


@pytest.mark.parametrize("name", SYSTEMS)
def test_places_are_those_at_which_the_document_shows_its_keypoints(name):
    world = WorldModel.load(name)
    document = learned_mjcf(world, of_system=True)
    model = mujoco.MjModel.from_xml_string(document.xml)
    data, sites = mujoco.MjData(model), [f"keypoint_{k}" for k in range(world.mechanism.num_keypoints)]
    for q in np.random.default_rng(1).uniform(-1.2, 1.2, (5, model.nq)):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        points = np.stack([data.site(site).xpos for site in sites])
        seen = world_to_image(model, data, points, "front", *reversed(world.image_shape))
        np.testing.assert_allclose(places_of(world, document)(seen), q, atol=1e-4)


@pytest.mark.render
@pytest.mark.parametrize("name", ["pendulum", "acrobot"])
def test_positions_are_those_of_the_systems_joints(name):
    runs, truth = filmed(name, number=2, frames=40)
    world = WorldModel.load(name)
    positions = learned_positions(runs, world, learned_mjcf(world, of_system=True))
    assert positions.trusted == 1.0
    for run, q in zip(positions.recordings, truth, strict=True):
        assert run.joint_names == tuple(joint.name for joint in get_system(name).joints)
        off = np.asarray(run.qpos) - q
        off -= 2 * np.pi * np.round(off[0] / (2 * np.pi))
        assert np.sqrt(np.mean(off**2)) < 0.03
        assert np.all(positions.error < 0.03)


@pytest.mark.render
@pytest.mark.parametrize("change", [lambda f: np.roll(f, 1, axis=2), lambda f: (0.8 * f).astype(np.uint8)])
def test_another_camera_or_light_is_no_other_motion(change):
    """A camera that is off by a pixel had been called cogging; in other light, no frame was trusted."""
    runs, _ = filmed("pendulum", number=2, frames=40)
    world = WorldModel.load("pendulum")
    document = learned_mjcf(world, of_system=True)
    changed = [replace(run, frames=change(np.asarray(run.load_frames())), video=None) for run in runs]
    plain, otherwise = (learned_positions(films, world, document) for films in (runs, changed))
    assert otherwise.trusted == 1.0
    for before, after in zip(plain.recordings, otherwise.recordings, strict=True):
        assert np.sqrt(np.mean((np.asarray(after.qpos) - np.asarray(before.qpos)) ** 2)) < 0.004


@pytest.mark.render
@pytest.mark.long
def test_friction_is_named_from_images_and_the_model_given_it(tmp_path, capsys):
    today, _ = filmed("pendulum", [ViscousFriction("hinge", b=0.1)], seed=1)
    for run in today:
        write_recording(tmp_path / "today" / run.id, run)
    out = tmp_path / "report"
    found = main(
        ["diagnose", str(tmp_path / "today"), "--model", "pendulum", "--observe", "pixels", "--out", str(out), "--json"]
    )
    report = json.loads(capsys.readouterr().out)
    assert found == 10
    assert [(f["effect"], f["where"]["name"]) for f in report["findings"]] == [("viscous_friction", "hinge")]
    assert report["findings"][0]["parameters"]["b"]["value"] == pytest.approx(0.1, rel=0.1)
    assert report["details"]["units"] == "rad, m, N m"
    assert len(WorldModel.load(out / "corrected_model").effects) == 1
    assert mujoco.MjModel.from_xml_path(str(out / "corrected.xml")).dof_damping[0] > 0
    assert "data:image/png" in (out / "report.html").read_text()


@pytest.mark.render
def test_frames_of_another_scene_name_no_physics():
    runs, _ = filmed("pendulum", number=3, frames=20)
    rng = np.random.default_rng(0)
    other = [replace(r, frames=rng.integers(0, 255, np.asarray(r.frames).shape, dtype=np.uint8)) for r in runs]
    report = diagnose_by_world_model(other, WorldModel.load("pendulum"))
    assert report.verdict == "undetermined" and not report.findings
    assert "the frames" in report.headline
    assert "Train a world model" in report.headline


def test_what_no_world_model_can_have_is_said_and_ends_nothing(tmp_path, capsys):
    world, less = WorldModel.load("pendulum"), Estimate(-0.05, "N m s/rad", -0.06, -0.04)
    finding = Finding.of(ViscousFriction("hinge"), {"b": less}, 0.9, [])
    report = Report(
        verdict="mismatch",
        headline="Less friction than before.",
        findings=[finding],
        nuisance={},
        unexplained=Unexplained(False, 0.0, None, "What is left is noise."),
        fit=FitErrors("root mean square", "mrad", 2.0, 2.0, 1.0),
        held_out=[],
        details={},
    )
    assert _write_corrected_world_model(report, world, tmp_path / "corrected_model") == ["viscous_friction at hinge"]
    assert not (tmp_path / "corrected_model").exists()
    assert "no corrected_model: viscous_friction at 'hinge' has b=-0.05" in capsys.readouterr().err


@pytest.mark.render
def test_what_a_world_model_cannot_read_is_refused(tmp_path, capsys):
    world = WorldModel.load("pendulum")
    runs, _ = filmed("pendulum", number=3, frames=10)
    still = replace(runs[0], frames=np.asarray(runs[0].frames)[:1], t_frame=np.asarray(runs[0].t_frame)[:1])
    with pytest.raises(InputError, match="has 1 frames; film it"):
        diagnose_by_world_model([still], world)
    small = replace(runs[0], frames=np.asarray(runs[0].frames)[:, ::2, ::2], camera=None)
    with pytest.raises(InputError, match="32×32 pixels, the model pendulum sees 64×64"):
        diagnose_by_world_model([small], world)
    for run in runs:
        write_recording(tmp_path / run.id, run)
    assert main(["diagnose", str(tmp_path), "--model", "pendulum"]) == 2
    assert "say --observe pixels" in capsys.readouterr().err
    assert main(["diagnose", str(tmp_path), "--model", "nowhere", "--observe", "pixels"]) == 2
    assert "nowhere" in capsys.readouterr().err
