"""The paper's report: what is planned, measures against known truths, tables and the page."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from oracle import SYSTEMS, body_of, point_masses
from plotly.offline import get_plotlyjs

from keycld_control.cli import main
from keycld_control.paper import tables
from keycld_control.paper import work as working
from keycld_control.paper.aims import aims
from keycld_control.paper.measures.ceiling import ceiling
from keycld_control.paper.measures.long import _energy_changes, horizon, natural_frames
from keycld_control.paper.measures.lyapunov import exponent
from keycld_control.paper.measures.masses import equivalent_masses, learned_masses
from keycld_control.paper.measures.memory import distances
from keycld_control.paper.measures.potential import potential, sweeps_of
from keycld_control.paper.measures.speed import speed
from keycld_control.paper.page import Picture, Section, html_page, write_report
from keycld_control.paper.plan import AMOUNTS, Training, trainings
from keycld_control.paper.recordings import PARTS
from keycld_control.paper.tables import Table, amounts, integrators, interval, vpt
from keycld_control.paper.work import Work, results, work_off
from keycld_control.plain_json import write_json
from keycld_envs import REFERENCE_SYSTEMS, get_system
from keycld_envs import SYSTEMS as REGISTERED
from keycld_envs.recordings.dataset import Sequences
from keycld_model import WorldModel
from keycld_model.evaluation.joint_coordinates import joint_positions


def test_every_training_is_planned_once_and_first_seeds_come_first():
    planned = list(trainings())
    assert len(set(planned)) == len(planned) == len(REFERENCE_SYSTEMS) * (3 * 4 + 2 + len(AMOUNTS))
    assert [t.seed for t in planned] == sorted(t.seed for t in planned)
    assert len({t.name for t in planned}) == len(planned)


@pytest.mark.parametrize("amount", [25, 50, 100, 200, 450])
def test_a_tenth_of_the_recordings_validates_and_the_rest_is_as_many_as_asked_for(amount):
    count = Training("pendulum", sequences=amount).recordings
    assert count - count // 10 == amount
    assert Training("pendulum").recordings == PARTS["training"].episodes == 500


def test_tests_are_recorded_with_seeds_of_their_own():
    assert len({part.seed for part in PARTS.values()}) == len(PARTS)


@pytest.mark.parametrize(("name", "ratio"), [("cartpole", 14.7), ("acrobot", 0.957)])
def test_masses_that_move_as_the_bodies_do(name, ratio):
    masses = equivalent_masses(get_system(name))
    assert masses[0] / masses[1] == pytest.approx(ratio, rel=2e-3)
    np.testing.assert_allclose(
        np.divide(masses, sum(masses)), body_of(name).masses / body_of(name).masses.sum(), rtol=1e-3
    )


@pytest.mark.parametrize("name", SYSTEMS)
def test_joint_positions_are_decoded_whatever_the_sense_and_the_zero(name):
    """From point masses; the true positions are those of joints that count the other way round, from elsewhere."""
    system, rng = get_system(name), np.random.default_rng(0)
    path = np.cumsum(rng.normal(0, 0.2, (3, 30, len(system.joints))), axis=1)
    keypoints = np.array([[point_masses(name, q).reshape(-1, 2) for q in run] for run in path])
    kinds = [joint.kind for joint in system.joints]
    true = 0.3 - path
    decoded = joint_positions(system.mechanism, kinds, keypoints, true[:, :5])
    turns = np.round((decoded - true)[:, :1] / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose(decoded - turns, true, atol=1e-6)


def test_energy_of_a_true_motion_does_not_change():
    import mujoco

    system = get_system("acrobot")
    model = system.compile()
    data, path = mujoco.MjData(model), []
    data.qpos[:] = [2.0, 0.5]
    for _ in range(200):
        mujoco.mj_step(model, data)
        path.append(data.qpos.copy())
    true, wrong = np.array(path), np.array(path) * [1.0, 1.2]
    change = _energy_changes("acrobot", np.stack([true, wrong]), system.timestep)
    assert change[0] < 0.01 < 0.05 < change[1]


def test_forgetting_is_as_fast_as_known():
    """A hanging pendulum keeps an offset; an upright one lets it grow with the root of g / L; an acrobot is chaotic."""
    still = np.zeros((400, 1))
    hanging = exponent("pendulum", np.array([np.pi - 0.01]), still)
    assert abs(hanging) < 0.3
    natural = np.sqrt(9.81 / 0.5)
    assert exponent("pendulum", np.array([0.0]), still[:50]) == pytest.approx(natural, rel=0.15)
    assert 1 < exponent("acrobot", np.array([0.5, 0.5]), np.zeros((1000, 2))) < 6


def test_the_mechanism_agrees_with_itself_until_steps_are_too_coarse():
    what = get_system("cartpole")
    plant = what.compile()
    data, actions = mujoco.MjData(plant), np.repeat([[[0.0, 0.0]], [[0.0, 3.0]]], 199, axis=1)
    paths = np.zeros((2, 200, 2))
    for path, torques in zip(paths, actions, strict=True):
        mujoco.mj_resetData(plant, data)
        data.qpos[:] = path[0] = (0.0, 1.0)
        for t, torque in enumerate(torques, 1):
            data.ctrl[:] = torque
            mujoco.mj_step(plant, data)
            path[t] = data.qpos
    truth = Sequences(np.zeros((2, 200, 1, 1, 3), np.uint8), actions, paths, what.timestep)
    assert ceiling("cartpole", truth, finer=1) == [1.0, 1.0]
    free, driven = ceiling("cartpole", truth)
    assert free == 1.0 and 0.5 < driven < 1.0


def test_distances_between_recordings_know_what_a_turn_is():
    frames = np.zeros((2, 2, 1, 1, 3), np.uint8)
    known = Sequences(frames, np.array([[[0.0]], [[3.0]]]), np.array([[[0.5, 3.1]] * 2, [[0.5, 0.0]] * 2]), 0.02)
    new = Sequences(frames[:1], np.array([[[0.0]]]), np.array([[[0.5, -3.1]] * 2]), 0.02)
    apart = distances(known, new, np.array([False, True]))
    np.testing.assert_allclose(apart, [[2 * np.pi - 6.2, np.hypot(3.1, 1.0)]])


def test_the_time_to_the_papers_score_is_that_of_the_first_stage_that_reached_it(tmp_path):
    log = [{"step": 1, "validation_vpt": None, "seconds": 1.0}, {"step": 2, "loss": 0.1, "seconds": 2.0}]
    log += [
        {"step": 3, "validation_vpt": v, "seconds": s} for v, s in ((0.3, 3.0), (0.5, 4.0), (0.9, 5.0), (0.994, 6.0))
    ]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in log))
    for wanted, seconds in ((0.38, 4.0), (0.995, 7.0), (1.0, None)):
        found = speed(tmp_path, {"seconds": 7.0, "validation_vpt": 0.996}, wanted, 2.0)
        assert found["seconds"] == seconds and found["reference"] == 90_000
        assert found["times"] == (None if seconds is None else 90_000 / seconds)


def test_natural_times():
    assert natural_frames("pendulum", 10) == 113
    assert natural_frames("acrobot", 50) == 1596
    assert horizon("acrobot") == 1597 and horizon("pendulum") == 1001


def test_the_papers_sweeps():
    """Figures 8 to 12: what moves, and where the others rest."""
    found = [(s.figure, s.joint, s.poses) for name in SYSTEMS for s in sweeps_of(get_system(name))]
    assert [(figure, joint) for figure, joint, _ in found] == [(8, 0), (9, 1), (10, 0), (11, 0), (12, 1)]
    rest = [(0.0,), (0.0, 0.0), (0.0, np.pi), (0.0, 0.0), (np.pi, 0.0)]
    for (figure, joint, poses), others in zip(found, rest, strict=True):
        expected = np.tile(others, (73, 1))
        expected[:, joint] += np.linspace(*((-1, 1) if figure == 10 else (-np.pi, np.pi)), 73)
        np.testing.assert_array_equal(poses, expected)


@pytest.mark.parametrize("name", REGISTERED)
def test_every_system_has_sweeps_and_natural_times(name):
    system = get_system(name)
    sweeps = sweeps_of(system)
    assert sorted(sweep.joint for sweep in sweeps) == list(range(len(system.joints)))
    assert all(np.ptp(sweep.poses, axis=0)[sweep.joint] > 0 for sweep in sweeps)
    assert horizon(name) > natural_frames(name, 10) > 0


def test_systems_without_published_figures_show_no_aim(monkeypatch):
    monkeypatch.setattr(tables, "REFERENCE_SYSTEMS", ("acrobot-stock",))
    found = [made_up("acrobot-stock", "default", 0, 0.9), made_up("acrobot-stock", "default", 0, 0.8, 50)]
    assert vpt(found).rows[0][1:4] == ("acrobot-stock", "–", "0.450")
    rows = {row[0]: row[1:] for row in aims(found).rows}
    assert rows["VPT of 50 sequences, from 2 frames"] == ("the paper's of 450", "0.400")


def made_up(system, preset, seed, vpt, sequences=450):
    """Figures of a model as `one` writes them."""
    curve = {
        "mean": [1e-4, 2e-4],
        "low": [1e-5, 1e-5],
        "high": [3e-4, 4e-4],
        "epsilon": 1e-3,
        "vpt": vpt,
        "valid": [1.0],
    }
    table = {"vpt_from_10": vpt, "vpt_from_5": vpt, "vpt_from_2": vpt / 2, "frame_index_from_2": 49 * vpt}
    masses = {"ratio": None, "exact": None, "error": None, "lengths": [1.01], "potential": 0.99}
    sweep = {"figure": 8, "title": "pole turns", "position": [0.0, 1.0], "learned": [0.0, 1.1], "true": [0.0, 1.0]}
    return {
        "schema": working.SCHEMA, "data_seed": 1,
        "system": system, "preset": preset, "seed": seed, "sequences": sequences,
        "table": table, "curve": curve, "potential": [{**sweep, "r2": 0.99, "change": 1.0}], "masses": masses,
    }  # fmt: skip


def failed(system, preset, seed):
    """Of a training whose keypoints collapsed."""
    known = {"system": system, "preset": preset, "seed": seed, "sequences": 450}
    return {"schema": working.SCHEMA, "data_seed": 1, **known, "failure": "x"}


@pytest.fixture
def report(tmp_path):
    found = [made_up("pendulum", "default", seed, 0.9 + 0.05 * seed) for seed in range(3)]
    found += [made_up("pendulum", "nc", 0, 0.4), made_up("pendulum", "default", 0, 0.7, 50)]
    found.append(failed("pendulum", "nc", 1))
    for r in found:
        training = Training(r["system"], r["preset"], r["seed"], r["sequences"])
        write_json(Work(tmp_path).result(training), r)
    return tmp_path


def test_tables_tell_the_paper_and_the_mean_over_seeds(report):
    found = results(report)
    rows = vpt(found).rows
    ours = "0.950 ± 0.124"
    assert rows[0] == ("KeyCLD", "pendulum", "0.38", "0.475 ± 0.062", ours, ours, "46.6 ± 6.1", "3 of 3")
    assert rows[1][:5] == ("KeyCLD-NC", "pendulum", "0.20", "0.200", "0.400") and rows[1][-1] == "1 of 2"
    assert amounts(found).rows == (("50", "0.700"), ("450", "0.950 ± 0.124"))
    assert interval([0.5]) == "0.500"


def test_aims_stand_beside_what_was_reached(report):
    rows = {row[0]: row[1:] for row in aims(results(report)).rows}
    assert rows["VPT from 5 frames"] == ("0.98", "0.950 ± 0.124")
    assert rows["VPT of 50 sequences, from 2 frames"] == ("the paper's of 450", "0.350 (0.38)")
    assert rows["R² of V, worst sweep and seed"][1] == "0.9900"


def test_models_stand_in_the_order_that_was_found():
    scores = {"default": 0.9, "nc": 0.3, "node2": 0.6}
    found = [made_up("pendulum", preset, 0, score) for preset, score in scores.items()]
    found.append(failed("pendulum", "fc", 0))
    wanted, *cells = next(row[1:] for row in aims(found).rows if "models" in row[0])
    assert wanted == "KeyCLD > KeyCLD-NC > NODE2 > FC"
    assert cells == ["KeyCLD > NODE2 > KeyCLD-NC > FC"]


def test_what_diverged_is_infinite():
    part = {"change": [0.01, None], "drift": [0.01, None], "off_constraints": None}
    found = [made_up("pendulum", "default", 0, 0.9) | {"integrators": {"projected": part}}]
    assert next(row for row in aims(found).rows if "energy" in row[0])[2] == "inf %"
    assert integrators(found).rows == (("pendulum", "projected", "inf, inf", "inf, inf", "inf"),)


def test_cells_hold_no_bars_that_end_them():
    assert "| a\\|b |" in Table("", "", ("a|b",), (("c",),)).markdown()


def test_the_page_needs_nothing_else(report, capsys):
    assert main(["paper", "--out", str(report), "--only-report", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["models"] == 6
    page = (report / "report.html").read_text().replace(get_plotlyjs(), "")
    order = ["Valid prediction time</h2>", "(figure 3)</h3>", "Training sequences</h2>", "(figures 8 to 12)</h3>"]
    assert "KeyCLD-NC" in page and "pole turns" in page and sorted(order, key=page.index) == order
    assert 'src="http' not in page and "<link" not in page
    assert "| KeyCLD | pendulum | 0.38 |" in (report / "report.md").read_text()


def test_words_of_tables_and_captions_are_escaped():
    table = Table("a < b", "of `x<y>` & z", ("<i>",), (("<td>",),))
    page = html_page("1 > 0", [Section(table, [Picture("<u>", images=(('">', "cGljdHVyZQ=="),))])])
    page = page.replace(get_plotlyjs(), "")
    for part in (
        "<p>1 &gt; 0", "<h2>a &lt; b</h2>", "<th>&lt;i&gt;</th>", "<td>&lt;td&gt;</td>", "<h3>&lt;u&gt;</h3>",
        '<p class="note">of <code>x&lt;y&gt;</code> &amp; z</p>', "<figcaption>&#34;&gt;</figcaption>",
        '<img alt="&#34;&gt;" src="data:image/png;base64,cGljdHVyZQ==">',
    ):  # fmt: skip
        assert page.count(part) == 1, part


def test_the_report_in_the_documentation_is_of_its_figures(tmp_path):
    shipped = Path(__file__).parents[2] / "docs/paper"
    write_report(tmp_path, results(shipped))
    assert (tmp_path / "report.md").read_text() == (shipped / "report.md").read_text()


def test_work_is_not_done_twice(report, monkeypatch):
    done = []
    monkeypatch.setattr(working, "one", lambda work, training: done.append(training))
    monkeypatch.setattr(working, "recordings", lambda *_, **__: None)
    wanted = [Training("pendulum"), Training("pendulum", seed=7)]
    work_off(Work(report), wanted)
    assert done == wanted[1:]


def test_figures_of_other_data_are_told(report, capsys):
    assert main(["paper", "--out", str(report), "--seed", "2"]) == 2
    assert "is of --seed 1, not 2" in capsys.readouterr().err


def test_damaged_figures_are_told(report, capsys):
    path = report / "results" / "pendulum-nc-0.json"
    for text, told in (("{", "is damaged"), ("[]", "is damaged"), ('{"schema": "keycld.paper/9"}', "keycld.paper/9")):
        path.write_text(text)
        assert main(["paper", "--out", str(report), "--only-report"]) == 2
        error = capsys.readouterr().err
        assert str(path) in error and told in error


def test_what_cannot_be_made_is_told(tmp_path, capsys):
    for words, told in {
        ("--seeds", "0"): "seeds is 0",
        ("--preset", "nonsense"): "--preset names 'nonsense'; there are default, nc",
        ("--preset", "fc", "--sequences", "25"): "Nothing that is planned",
        ("--ray", "127.0.0.1:1"): "no Ray cluster",
        ("--only-report",): "holds no results",
    }.items():
        assert main(["paper", "--out", str(tmp_path), *words]) == 2
        assert told in capsys.readouterr().err
        assert not any(tmp_path.iterdir())
    write_report(tmp_path, [made_up("acrobot", "default", 0, 1.0)])
    assert (tmp_path / "report.html").is_file()


def test_learned_masses_are_those_of_the_bodies():
    """Shipped weights of the acrobot: masses, lengths and weights within three percent."""
    model = WorldModel.load("acrobot")
    found = learned_masses(model, "acrobot", potential(model, "acrobot")[0]["unit"])
    assert found["error"] < 0.03
    np.testing.assert_allclose([*found["lengths"], found["potential"]], 1, atol=0.03)
