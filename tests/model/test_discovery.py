"""The structure of a mechanism from frames alone, against drawings whose structure, lengths and pivots are known."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.mechanism import Mechanism, Rod, Slider
from keycld_envs.mechanism_file import read_mechanism
from keycld_envs.recordings import Recording, read_dataset, write_recording
from keycld_model.discovery import Frames, declare, discover, doubts, read_frames
from keycld_model.discovery.charts import Chart
from keycld_model.discovery.parts import Joint, Part, Placed
from keycld_model.discovery.shapes import Fit, Shape
from keycld_model.discovery.structure import _follows

Drawing = Callable[[np.random.Generator], NDArray[np.uint8]]
SIDE, MIDDLE = 48, 23.5
BLUE, ORANGE = (0.2, 0.5, 0.8), (0.9, 0.6, 0.2)


def bar(
    image: NDArray[np.float64],
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    colour: tuple[float, float, float],
    half: float = 2.0,
) -> None:
    """Draw a bar with round ends, `half` of its width in pixels, its edges one pixel soft."""
    pixels = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE)), axis=-1).astype(float)
    along = end - start
    share = ((pixels - start) @ along / max(along @ along, 1e-9)).clip(0, 1)
    cover = (half + 0.5 - np.linalg.norm(pixels - start - share[..., None] * along, axis=-1)).clip(0, 1)[..., None]
    image[:] = image * (1 - cover) + cover * np.asarray(colour)


def direction(angle: float) -> NDArray[np.float64]:
    return np.array([math.cos(angle), math.sin(angle)])


def arm(
    rng: np.random.Generator, second: tuple[float, float, float] = ORANGE, background: float = 0.1
) -> NDArray[np.uint8]:
    """Two links, 11 and 9 pixels, the first on the middle of the image."""
    image = np.full((SIDE, SIDE, 3), background)
    one, two = rng.uniform(-np.pi, np.pi, 2)
    elbow = MIDDLE + 11 * direction(one)
    bar(image, np.full(2, MIDDLE), elbow, BLUE)
    bar(image, elbow, elbow + 9 * direction(two), second)
    return (255 * image).round().astype(np.uint8)


def cart(rng: np.random.Generator, half: tuple[float, float]) -> NDArray[np.uint8]:
    """A cart on a level rail 4 pixels below the middle, half of its length and width in pixels; a pole of 11 pixels."""
    image = np.full((SIDE, SIDE, 3), 0.1)
    hinge = np.array([MIDDLE + rng.uniform(-14, 14), MIDDLE + 4])
    bar(image, hinge - np.array([half[0], 0]), hinge + np.array([half[0], 0]), BLUE, half[1])
    bar(image, hinge, hinge + 11 * direction(rng.uniform(-np.pi, np.pi)), ORANGE)
    return (255 * image).round().astype(np.uint8)


def frames_of(draw: Drawing, number: int = 60, seed: int = 0) -> Frames:
    pixels = np.stack([draw(np.random.default_rng([seed, i])) for i in range(number)]).astype(np.float32) / 255
    out = np.arange(number) % 5 == 4
    return Frames(pixels[~out], pixels[out], np.median(pixels, axis=0), (SIDE, SIDE), 1)


def silent(steps: int = 1, note: str | None = None) -> None:
    """No progress bar."""


def write(folder: Path, draw: Drawing, number: int = 6, length: int = 10, actions: int = 1) -> None:
    times = np.linspace(0, 0.01 * (length - 1), length, dtype=np.float64)
    for i in range(number):
        images = np.stack([draw(np.random.default_rng([1, i, t])) for t in range(length)])
        recording = Recording(
            id=f"run-{i}",
            source="simulation",
            units={"action": "N m"} if actions else {},
            actuator_names=tuple(f"motor-{k}" for k in range(actions)),
            t_frame=times,
            frames=images,
            t_action=times if actions else None,
            action=np.zeros((length, actions)) if actions else None,
        )
        write_recording(folder / recording.id, recording)


@pytest.mark.parametrize("along", [None, np.array([[0.6, 0.8]])])
def test_motion_of_a_joint_is_a_shift_of_its_chart(along: NDArray[np.float64] | None) -> None:
    chart = Chart(np.array([[10.0, 12.0]]), along, (64, 20))
    nodes = chart.nodes()[0][0]
    by = 5
    moved = chart.coordinates(nodes, np.array([by * chart.unit]))[:, 0]
    expected = np.stack(np.meshgrid(np.arange(64) - by, np.arange(20), indexing="ij")).astype(float)
    if along is None:
        off = (moved[0] - expected[0] + 32) % 64 - 32
        assert np.abs(off).max() < 1e-9
    else:
        assert np.abs(moved[0] - expected[0]).max() < 1e-9
    assert np.abs(moved[1] - expected[1]).max() < 1e-9


def test_area_of_a_polar_chart_is_that_of_its_disc() -> None:
    assert Chart(np.zeros((1, 2)), None, (64, 20)).nodes()[1].sum() == pytest.approx(np.pi * 20**2, rel=1e-5)


@pytest.mark.long
@pytest.mark.parametrize(("second", "background"), [(ORANGE, 0.1), (BLUE, 0.1), (ORANGE, 0.0)])
def test_arm_of_two_links_whatever_the_colours(second: tuple[float, float, float], background: float) -> None:
    frames = frames_of(lambda rng: arm(rng, second, background))
    found = discover(frames, silent)
    declared = declare(found.best.parts, frames, 2)
    assert declared.mechanism.rods == (Rod(None, 0), Rod(0, 1))
    assert declared.mechanism.sliders == ()
    assert np.abs(declared.mechanism.pivot).max() * MIDDLE < 1
    points = declared.keypoints(found.held_out)
    assert np.abs(np.linalg.norm(points[:, 0] - MIDDLE, axis=1) - 11).max() < 1
    assert np.abs(np.linalg.norm(points[:, 1] - points[:, 0], axis=1) - 9).max() < 3  # the end of a bar is round
    assert found.ranked[0] is found.best


@pytest.mark.long
@pytest.mark.parametrize(
    "half",
    [
        (6.0, 4.0),
        pytest.param(
            (3.0, 2.0),
            marks=pytest.mark.xfail(
                strict=True, reason="the first part is the one that explains most, here a hinge for the pole"
            ),
        ),
    ],
)
def test_cart_with_a_pole(half: tuple[float, float]) -> None:
    frames = frames_of(lambda rng: cart(rng, half))
    found = discover(frames, silent)
    mechanism = declare(found.best.parts, frames, 0).mechanism
    assert mechanism.rods == (Rod(0, 1),)
    assert [slider.keypoint for slider in mechanism.sliders] == [0]
    assert mechanism.sliders[0].normal == pytest.approx((0, 1), abs=0.05)
    assert mechanism.pivot[1] * MIDDLE == pytest.approx(-4, abs=1)


def part(joint: Joint, points: list[tuple[int, int]]) -> Part:
    size = (64, 20) if joint.kind == "hinge" else (60, 60)
    there = np.zeros(size, np.float32)
    for row, column in points:
        there[row, column] = 1
    return Part(joint, Shape(there, np.zeros((*size, 3), np.float32)), size)


def blank() -> Frames:
    image = np.zeros((1, SIDE, SIDE, 3), np.float32)
    return Frames(image, image, image[0], (SIDE, SIDE), 1)


def test_two_poles_on_one_cart_need_a_keypoint_each_where_they_are_hinged() -> None:
    parts = (
        part(Joint("slide", None, (MIDDLE, MIDDLE), 0.0), [(30, 30)]),
        part(Joint("hinge", 0, (-5.0, 0.0)), [(0, 10)]),
        part(Joint("hinge", 0, (5.0, 0.5)), [(0, 10)]),
    )
    mechanism = declare(parts, blank(), 1).mechanism
    assert mechanism == Mechanism(
        num_keypoints=4,
        num_actions=1,
        rods=(Rod(0, 1), Rod(0, 2), Rod(1, 3)),
        sliders=(Slider(0), Slider(1)),
        pivot=mechanism.pivot,
    )
    assert mechanism.degrees_of_freedom == len(parts)


def test_inclined_rail_has_its_normal_in_image_axes() -> None:
    parts = (part(Joint("slide", None, (MIDDLE, MIDDLE), math.radians(-25)), [(30, 30)]),)
    normal = declare(parts, blank(), 0).mechanism.sliders[0].normal
    assert normal == pytest.approx((-math.sin(math.radians(25)), math.cos(math.radians(25))), abs=1e-4)


def test_places_on_the_ground_that_no_mechanism_declares_are_refused() -> None:
    parts = tuple(part(Joint("hinge", None, (x, 20.0)), [(0, 10)]) for x in (10.0, 30.0))
    with pytest.raises(InputError, match="20 pixels apart"):
        declare(parts, blank(), 0)


@pytest.mark.parametrize(("sign", "noise", "leader"), [(1, 0.02, 0), (-1, 0.02, 0), (1, 0.5, None)])
def test_what_moves_with_a_part_or_mirrors_it_is_none_of_its_own(sign: int, noise: float, leader: int | None) -> None:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, 50)
    images = np.zeros((50, SIDE, SIDE, 3), np.float32)
    now = Placed.nothing(images, images[0])
    joint = Joint("hinge", None, (MIDDLE, MIDDLE))
    shape = part(joint, [(0, 10)]).shape
    for shift in (angles, sign * angles + 0.7 + noise * rng.standard_normal(50)):
        now = now.with_part(joint, Fit(shape, shift, np.ones(50)), (64, 20))
    assert _follows(now) == leader


def test_frames_that_cannot_tell_are_refused(tmp_path: Path) -> None:
    still = np.full((SIDE, SIDE, 3), 9, np.uint8)
    write(tmp_path / "still", lambda rng: still)
    with pytest.raises(InputError, match="Nothing moves"):
        read_frames(read_dataset(tmp_path / "still"))
    few = Recording(
        id="a", source="real", joint_names=("a",), units={"qpos": "rad"}, t_state=np.arange(9.0), qpos=np.zeros((9, 1))
    )
    write_recording(tmp_path / "blind" / "a", few)
    with pytest.raises(InputError, match="have no frames"):
        read_frames(read_dataset(tmp_path / "blind"))
    write(tmp_path / "few", arm, number=1)
    with pytest.raises(InputError, match="10 frames"):
        read_frames(read_dataset(tmp_path / "few"))


def test_large_frames_are_reduced_and_places_stay(tmp_path: Path) -> None:
    write(tmp_path / "large", lambda rng: np.kron(arm(rng), np.ones((5, 5, 1), np.uint8)))
    frames = read_frames(read_dataset(tmp_path / "large"))
    assert (frames.reduction, frames.background.shape) == (3, (80, 80, 3))
    assert frames.to_image(np.full(2, 39.5)) == pytest.approx([0, 0])
    assert frames.to_image(np.array([(239 + 0.5) / 3 - 0.5, 39.5])) == pytest.approx([1, 0])


@pytest.mark.parametrize("words", [["--out", "arm.txt"], ["--out", "arm.py", "--picture", "arm.txt"]])
def test_names_that_cannot_be_written_are_refused(words: list[str], tmp_path: Path) -> None:
    assert main(["discover", str(tmp_path), *words]) == 2


@pytest.mark.slow
def test_command_writes_a_file_that_other_commands_take(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "data", arm, actions=2)
    assert main(["discover", "data", "--out", "arm.py", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    mechanism = read_mechanism("arm.py")
    assert mechanism == Mechanism.from_dict(result["mechanism"])
    assert replace(mechanism, pivot=(0.0, 0.0)) == Mechanism(2, 2, (Rod(None, 0), Rod(0, 1)))
    scores = [each["score"] for each in result["ranked"]]
    assert scores == sorted(scores)
    assert Path("arm.png").stat().st_size > 1000
    assert main(["check", "arm.py", "--data", "data", "--json"]) == 0
    assert main(["discover", "data", "--out", "arm.py"]) == 2  # the file exists


def test_part_that_hardly_moves_is_doubted() -> None:
    frames = blank()
    now = Placed.nothing(np.zeros((20, SIDE, SIDE, 3), np.float32), frames.background)
    joint = Joint("hinge", None, (MIDDLE, MIDDLE))
    fit = Fit(part(joint, [(0, 10)]).shape, 0.05 * np.sin(np.arange(20)), np.ones(20))
    now = now.with_part(joint, fit, (64, 20))
    from keycld_model.discovery.structure import Discovery, Structure

    best = Structure(now.parts, 0.1, 1)
    said = doubts(Discovery(best, (best,), frames, now, now))
    assert len(said) == 1 and "moves little" in said[0]
