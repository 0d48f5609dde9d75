"""Joint positions read off frames by drawing the simulator."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from films import film
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording, write_recording
from keycld_envs.recordings.crop import reduced
from keycld_envs.rendering import View
from keycld_envs.systems import get_system
from keycld_model.diagnosis import diagnose_images
from keycld_model.diagnosis.criteria import STANDARD
from keycld_model.diagnosis.from_images import _distrusted, _mostly_seen, _why_distrusted
from keycld_model.diagnosis.output.page import html_page
from keycld_model.image_alignment import Positions, read_positions
from keycld_model.image_alignment.films import LARGEST, repeats
from keycld_model.image_alignment.light import Light
from keycld_model.image_alignment.look import lengthen
from keycld_model.image_alignment.pose import Pose, nothing_moves
from keycld_model.image_alignment.scene import Scene

PIXELS_PER_METRE = {"pendulum": 30.9, "cartpole": 12.9, "acrobot": 12.9}
"""Of the nominal cameras, frames of 64 pixels."""


def errors(positions: Positions, truth: list[NDArray[np.float64]], turn: float) -> NDArray[np.float64]:
    """Difference to the truth, whole turns apart, `[T, nq]` per recording."""
    out = []
    for recording, q in zip(positions.recordings, truth, strict=True):
        e = np.asarray(recording.qpos) - q
        out.append(e - turn * np.round(np.nanmedian(e, axis=0) / turn))
    return np.concatenate(out)


@pytest.mark.render
@pytest.mark.slow
def test_positions_are_those_of_the_simulation_whatever_the_camera_does():
    def develop(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        noisy = 0.7 * image.astype(float) + 12 + np.random.default_rng(int(image.sum())).normal(0, 3, image.shape)
        return np.clip(noisy, 0, 255).round().astype(np.uint8)

    view = View(2.1, -1.3, 1.05, 0.98, 0.04, pitch=-0.05, yaw=0.03)
    model = get_system("pendulum").compile()
    runs, truth = film("pendulum", view=view, develop=develop, change=lambda m: lengthen(m, 1, 0.9))
    positions = read_positions(runs, model, workers=1)
    values = dict(zip([p.name for p in positions.parameters], positions.values, strict=True))
    assert values["right"] == pytest.approx(2.1, abs=0.05)
    assert values["up"] == pytest.approx(-1.3, abs=0.05)
    assert np.exp(values["zoom"]) == pytest.approx(1.05, abs=0.003)
    assert np.exp(values["aspect"]) == pytest.approx(0.98, abs=0.006)
    assert values["roll"] == pytest.approx(0.04, abs=0.002)
    assert (values["pitch"], values["yaw"]) == pytest.approx((-0.05, 0.03), abs=0.005)
    assert np.exp(values["visible length of pole"]) == pytest.approx(0.9, abs=0.01)
    seen = 0.5 * 0.9 * 1.05 * PIXELS_PER_METRE["pendulum"] * errors(positions, truth, 2 * np.pi)  # px at the tip
    assert abs(np.mean(seen)) < 0.05
    assert np.std(seen) < 0.05
    assert positions.trusted == 1.0


@pytest.mark.render
@pytest.mark.slow
def test_a_rail_as_thin_as_a_pixel_and_stars_do_not_lead_the_camera_astray():
    view = View(right=-3.8, up=1.1, zoom=1.01, aspect=0.965, roll=-0.06)
    runs, truth = film("cartpole", frames=12, view=view)
    positions = read_positions(runs, get_system("cartpole").compile(), workers=1)
    values = dict(zip([p.name for p in positions.parameters], positions.values, strict=True))
    assert values["right"] == pytest.approx(-3.8, abs=0.02)
    assert np.exp(values["aspect"]) == pytest.approx(0.965, abs=0.002)
    assert values["roll"] == pytest.approx(-0.06, abs=0.001)
    seen = PIXELS_PER_METRE["cartpole"] * errors(positions, truth, 2 * np.pi)  # the pole is 1 m long
    assert np.abs(seen.mean(axis=0)).max() < 0.05
    assert seen.std(axis=0).max() < 0.05


@pytest.mark.render
@pytest.mark.slow
def test_a_pole_does_not_shrink_while_the_camera_is_far_off():
    def develop(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        noise = np.random.default_rng(int(image.sum())).normal(0, 5, image.shape)
        soft = gaussian_filter(image.astype(float), (1, 1, 0))
        return np.clip(1.12 * soft + 6 + noise, 0, 255).round().astype(np.uint8)

    view, shorter = View(right=-2.9, up=3.3, zoom=0.936, aspect=0.994, roll=0.046), 0.854
    runs, _ = film("cartpole", 1, 16, view, develop, change=lambda m: lengthen(m, 2, shorter))
    positions = read_positions(runs, get_system("cartpole").compile(), workers=1)
    values = dict(zip([p.name for p in positions.parameters], positions.values, strict=True))
    assert np.exp(values["visible length of pole_1"]) == pytest.approx(shorter, abs=0.01)
    assert values["up"] == pytest.approx(3.3, abs=0.1)
    assert positions.trusted == 1.0


@pytest.mark.render
@pytest.mark.long
def test_two_links_are_read_in_workers_as_in_one_process():
    model = get_system("acrobot").compile()
    runs, truth = film("acrobot", frames=12)
    one, two = (read_positions(runs, model, workers=n) for n in (1, 2))
    assert np.array_equal(errors(one, truth, 2 * np.pi), errors(two, truth, 2 * np.pi))
    seen = PIXELS_PER_METRE["acrobot"] * errors(one, truth, 2 * np.pi)
    assert np.abs(seen.mean(axis=0)).max() < 0.05
    assert seen.std(axis=0).max() < 0.06


@pytest.mark.render
@pytest.mark.long
def test_of_another_scene_no_physics_is_named():
    runs, _ = film("cartpole", frames=40)
    model = get_system("pendulum").compile()
    report = diagnose_images(runs, model, camera=get_system("pendulum").camera, workers=1)
    assert report.verdict == "undetermined"
    assert not report.findings
    assert "nothing is said of physics" in report.headline
    assert "nothing is said of physics" in html_page(report)


@pytest.mark.render
def test_the_stub_of_a_link_at_the_border_is_not_in_view():
    declared = get_system("cartpole")
    with Scene(declared.compile(), declared.camera, (64, 64), "fast") as scene:
        shares = [
            scene.in_view(np.array(q), scene.nominal) for q in ((0.0, 0.3), (2.3, 1.57), (2.3, -1.57), (4.0, 0.0))
        ]
        moved = scene.nominal.copy()
        moved[0] = -12.0  # pixels to the right
        inside = scene.in_view(np.array([2.3, 1.57]), moved)
    assert shares[0] == shares[2] == inside == 1.0
    assert 0 < shares[1] < 0.25
    assert shares[3] == 0.0


def test_the_sentence_says_why_no_frame_is_believed():
    none = np.zeros((0, 1))
    shown, told = np.full(10, 0.9), np.zeros(10, bool)
    known = {"joint_names": ("hinge",), "units": {"qpos": "rad"}, "qpos": np.zeros((10, 1))}
    run = Recording(id="05", source="simulation", t_state=np.arange(10.0), **known)
    read = Positions(
        (run,), (none,), (shown,), (told,), (), none[0:0, 0], none[0:0, 0], "fixed", (64, 64), none, (none,), np.ones(1)
    )
    assert "Only 0 % of the frames show the simulator" in _why_distrusted(read, STANDARD)
    assert "in recording '05' its picture explains 90 % of what moves" in _why_distrusted(read, STANDARD)
    astray = _why_distrusted(replace(read, astray=0.25), STANDARD)
    assert astray.startswith("25 % of the frames that were drawn at known positions are read elsewhere (10 % may be)")
    some = replace(read, readable=(np.arange(10) < 3,), out_of_view=(np.arange(10) >= 3,))
    assert some.trusted == 1 and some.read == 0.3
    assert _why_distrusted(some, STANDARD).startswith("The mechanism has left the image in 70 % of the frames")


def test_frames_that_the_mechanism_has_left_do_not_count_against_the_picture():
    rng = np.random.default_rng(0)
    still = np.full((64, 64, 3), 120.0, np.float32)
    seen, noisy = still.copy(), still + rng.normal(0, 8, still.shape).astype(np.float32)
    seen[20:23, 20:23] = 200
    assert nothing_moves(noisy, still)
    assert not nothing_moves(seen, still)
    assert not nothing_moves(still + 30, still)  # a flash is something else
    pose = Pose(np.zeros(1), np.zeros((1, 1)), 2.0, 1.0, 0.9, 0.1, 0.3)
    assert pose.out_of_view and not pose.readable
    assert not replace(pose, in_view=0.8).out_of_view
    assert not replace(pose, explained=0.2).out_of_view  # of what is somewhere else, nothing is known
    assert replace(pose, explained=0.0, empty=True).out_of_view


@pytest.mark.render
@pytest.mark.slow
def test_links_that_are_shorter_than_those_of_the_simulator_are_fitted_to_the_end():
    def shorter(model: mujoco.MjModel) -> None:
        lengthen(model, 1, 0.78)
        lengthen(model, 2, 0.82)

    view = View(right=-0.7, up=3.5, zoom=1.025, aspect=1.0, roll=-0.038)
    runs, _ = film("acrobot", runs=3, frames=9, view=view, change=shorter)
    positions = read_positions(runs, get_system("acrobot").compile(), workers=1)
    lengths = [v for p, v in zip(positions.parameters, positions.values, strict=True) if p.body is not None]
    assert np.exp(lengths) == pytest.approx([0.78, 0.82], abs=0.012)


@pytest.mark.render
def test_the_page_of_frames_that_are_not_believed_shows_them():
    runs, truth = film("pendulum", runs=1, frames=3)
    model, none, no_frame = get_system("pendulum").compile(), np.zeros((3, 1)), np.zeros(3, bool)
    known = {"joint_names": ("hinge",), "units": {"qpos": "rad"}, "qpos": truth[0]}
    read = replace(runs[0], t_state=runs[0].t_frame, **known)
    positions = Positions(
        (read,), (none,), (none[:, 0],), (no_frame,), (), none[0:0, 0], none[0:0, 0], "fixed",
        (64, 64), none[0], (none,), np.ones(1),
    )  # fmt: skip
    report = _distrusted(positions, runs, model, STANDARD, "Give it another camera.")
    page = html_page(report)
    assert "Give it another camera." in page and page.count("<figcaption>") == 3
    assert 'id="errors"' not in page and 'id="rollouts"' not in page


def test_recordings_that_hardly_show_the_mechanism_are_left_out():
    t, still = (
        np.linspace(0, 0.18, 10),
        {"joint_names": ("hinge",), "units": {"qpos": "rad"}, "qpos": np.zeros((10, 1))},
    )
    runs = [Recording(id=str(k), source="simulation", t_state=t, **still) for k in range(3)]
    readable = [np.arange(10) < n for n in (10, 4, 5)]
    assert [r.id for r in _mostly_seen(runs, readable)] == ["0", "2"]
    assert list(_mostly_seen(runs[1:2], readable[1:2])) == runs[1:2]


def test_light_is_a_factor_and_an_offset_that_strangers_do_not_change():
    rng = np.random.default_rng(0)
    drawn = rng.uniform(20, 200, (64, 64, 3)).astype(np.float32)
    shown = drawn * [0.8, 0.9, 1.1] + [5, 10, -5]
    shown[:12] = 128  # somebody walks by
    light = Light.of(drawn, shown.astype(np.float32))
    assert light.gain == pytest.approx([0.8, 0.9, 1.1], abs=0.01)
    assert light.offset == pytest.approx([5, 10, -5], abs=1)


def test_frames_that_a_camera_repeats_are_no_standstill():
    def shown(*columns: float) -> NDArray[np.uint8]:
        x, shades = np.arange(64)[None, :], np.array(columns)[:, None]
        row = 200 * np.exp(-(((x - shades) / 6) ** 2))
        return np.broadcast_to(row[:, None, :, None], (len(columns), 64, 64, 3)).astype(np.uint8)

    moving = np.linspace(10, 50, 21)
    assert not repeats(shown(*moving)).any()
    frozen = moving.copy()
    frozen[8:12], frozen[18:] = frozen[7], frozen[17]
    assert np.flatnonzero(repeats(shown(*frozen))).tolist() == [8, 9, 10, 11, 18, 19, 20]
    settling = 10 + 40 * np.exp(-np.arange(40) / 3.0)  # until the last frames are alike
    assert (np.diff(shown(*settling).astype(int), axis=0)[-3:] == 0).all()
    assert not repeats(shown(*settling)).any()
    assert not repeats(shown(*np.full(5, 20.0))).any()


def test_large_frames_are_reduced_by_means():
    frame = np.zeros((200, 300, 3), np.uint8)
    frame[:, 150:] = 200
    small = reduced(frame, LARGEST)
    assert max(small.shape) <= LARGEST
    assert small.mean() == pytest.approx(100, abs=1)
    assert reduced(small, LARGEST) is small


@pytest.mark.render
def test_mistakes_get_one_sentence(tmp_path, capsys):
    model = get_system("pendulum").compile()
    (run, other), _ = film("pendulum", frames=3)
    states = {"t_state": run.t_frame, "qpos": np.zeros((3, 1)), "joint_names": ("hinge",), "units": {"qpos": "rad"}}
    bare = replace(run, frames=None, t_frame=None, **states)
    with pytest.raises(InputError, match="has 0 frames"):
        read_positions([bare], model)
    camera = {"name": "fixed", "width": 64, "height": 32}
    small = replace(other, frames=other.load_frames()[:, :32], camera=camera)
    with pytest.raises(InputError, match=r"frames of 64×32 pixels, but '0' of 64×64"):
        read_positions([run, small], model)
    with pytest.raises(InputError, match="no camera 'front'"):
        read_positions([run], model, "front")
    nameless = replace(run, camera=None)
    with pytest.raises(InputError, match="say which one looks, --camera NAME"):
        read_positions([nameless], model)
    with pytest.raises(InputError, match="workers is 0"):
        read_positions([run], model, workers=0)
    write_recording(tmp_path / "data" / "0", run)
    command = ["diagnose", str(tmp_path / "data"), "--env", "KeyCLD/Pendulum-v0"]
    for wrong in (["--camera", "fixed"], ["--observe", "pixels", "--tracked"], ["--observe", "both"]):
        assert main([*command, *wrong]) == 2
        assert capsys.readouterr().err.count("\n") == 1
