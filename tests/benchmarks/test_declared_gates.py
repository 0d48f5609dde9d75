"""Gates as data: what a file declares, how faults in it are told, and that each expectation can be missed."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from keycld_control.benchmarks.real import GATES, Gate, expectations, read_gate
from keycld_control.benchmarks.real.concealed import ConcealedGate
from keycld_control.benchmarks.real.declaration import HERE
from keycld_control.benchmarks.real.expectations import EXPECTATIONS
from keycld_control.benchmarks.real.gate import Diagnosed
from keycld_control.benchmarks.real.halves import HalvesGate, calibrated, confirmed, parted, passed, summary
from keycld_control.benchmarks.real.rigs import several
from keycld_control.cli import main
from keycld_envs.errors import InputError
from keycld_envs.recordings import Recording
from keycld_envs.recordings.importers import Table
from keycld_model.diagnosis.verdict.report import Estimate, Finding, FitErrors, Report, Unexplained, Verdict

DOCS = Path(__file__).parents[2] / "docs" / "real-data.md"
OWN = DOCS.read_text().split("```toml\n")[1].split("```")[0]
"""A gate of one's own."""


def own(folder: Path, old: str = "", new: str = "") -> Path:
    path = folder / "mine.toml"
    assert old in OWN
    path.write_text(OWN.replace(old, new))
    return path


def test_a_file_declares_files_columns_simulator_and_what_is_expected(tmp_path: Path) -> None:
    gate = read_gate(own(tmp_path))
    assert isinstance(gate, Gate)
    data = gate.diagnoses["diagnosis"]
    assert [(f.path, f.id) for f in data.baseline][1:] == [("mine/run02.csv", "run 2"), ("mine/run03.csv", "run 3")]
    (new,) = data.recordings
    assert data.baseline[0].columns.units == {"angle": "rad"} and new.columns.units == {"angle": "deg"}
    assert gate.required == ("dry friction at hinge, c 0.1 to 0.2; no viscous_friction or quadratic_drag")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "numbers.yml").write_text("a title\nm: 0.5\nIr = 1e-3\n")
    (tmp_path / "mine" / "new.csv").write_text("t,angle,torque\n0,0,0\n0.01,180,1\n0.02,190,1\n")
    model = gate.simulator(tmp_path)
    assert model.body_mass[1] == 0.5 and model.dof_armature[0] == pytest.approx(9e-3)
    recording = new.recording(tmp_path)
    assert (recording.licence, recording.id) == ("CC0", "new")
    assert np.asarray(recording.qpos)[1, 0] == pytest.approx(np.pi)


@pytest.mark.parametrize(
    "old, new, message",
    [
        ('title = "my rig"', "", "mine.toml: title is missing; write it down."),
        ('title = "my rig"', "title = 3", "mine.toml: title is 3; it must be text."),
        (
            'title = "my rig"',
            'titel = "x"',
            "mine.toml: the field 'titel' is unknown; did you mean 'title'?",
        ),
        ('title = "my rig"', "title =", "mine.toml is no TOML"),
        ('kind = "pendulum"', 'kind = "pendulums"', "mine.toml: simulator.kind 'pendulums' is unknown; did"),
        ("com = 0.1", "com = true", "mine.toml: simulator.link.com is True; it must be a number."),
        ("motor = true", "motor = 1", "mine.toml: simulator.motor is 1; it must be true or false."),
        ("com = 0.1, ", "", "mine.toml: simulator.link.com is missing; write it down."),
        ('time = "t"', "", "mine.toml: files.before.columns.time is missing; write it down."),
        ("run {1..3}", "run", "mine.toml: files.before.id is the same for 3 files; write {...} in it, too."),
        ("run {1..3}", "run {1..2}", "mine.toml: files.before has {...} for 2 and for 3 things; write as many."),
        (
            'recordings = "after"',
            'recordings = "afer"',
            "mine.toml: diagnosis[0].recordings 'afer' is unknown",
        ),
        ("[[diagnosis]]", "[[diagnoses]]", "mine.toml: the field 'diagnoses' is unknown; did you mean"),
        (
            "[[expect.finding]]",
            "[[expect.findings]]",
            "mine.toml: expect 'findings' is unknown; did you mean",
        ),
        (
            'family = "dry friction"',
            'family = "dry"',
            "mine.toml: expect.finding[0]: family 'dry' is unknown",
        ),
        ("[0.1, 0.2]", "[0.1]", "mine.toml: expect.finding[0].between.c is [0.1]; it must be a list of 2."),
        ('"viscous_friction"', '"viscous"', "expect.absent[0]: effect 'viscous' is unknown; did you mean"),
        ('kind = "pendulum"', "", "mine.toml: simulator.kind None is unknown; there are pendulum, double"),
    ],
)
def test_a_fault_is_told_by_file_field_and_remedy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    assert main(["real", str(tmp_path), "--gate", str(own(tmp_path, old, new))]) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_numbers_that_the_owners_do_not_have_are_refused(tmp_path: Path) -> None:
    gate = read_gate(own(tmp_path))
    assert isinstance(gate, Gate)
    with pytest.raises(InputError, match=r"numbers.yml does not exist"):
        gate.simulator(tmp_path)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "numbers.yml").write_text("mass: 0.5\nIr: 0\n")
    with pytest.raises(InputError, match=r"numbers.yml: the number 'm' is unknown"):
        gate.simulator(tmp_path)
    (tmp_path / "mine" / "numbers.yml").write_text("m: 50\nIr: 0\n")
    with pytest.raises(InputError, match=r"0.05 kg m², is not above mass × com² = 0.5; give it about the joint"):
        gate.simulator(tmp_path)


def test_a_missing_file_and_two_choices_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["real", str(tmp_path), "--gate", str(tmp_path / "none.toml")]) == 2
    assert "none.toml cannot be read (No such file or directory); hand in a TOML file." in capsys.readouterr().err
    assert main(["real", str(tmp_path), "--gate", str(own(tmp_path)), "--only", "R4"]) == 2
    assert "leave one of them out" in capsys.readouterr().err


def test_a_rig_of_this_package_can_be_named_and_a_simulator_can_be_mjcf(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        'title = "x"\nrig = "simple_pendulum"\n[simulator]\nkind = "mjcf"\npath = "rig.xml"\n'
        '[[diagnosis]]\nrecordings = ["four"]\n[[expect.verdict]]\nany_of = "mismatch"\n'
    )
    (tmp_path / "rig.xml").write_text("<mujoco><worldbody/></mujoco>")
    gate = read_gate(path)
    assert isinstance(gate, Gate) and gate.simulator(tmp_path).nbody == 1
    path.write_text(path.read_text().replace('kind = "mjcf"\npath = "rig.xml"', "motor = false"))
    gate = read_gate(path)
    assert isinstance(gate, Gate) and gate.simulator(tmp_path).nu == 0
    assert len(gate.diagnoses["diagnosis"].recordings) == 4


def test_texts_for_several_things_go_in_step() -> None:
    assert several(["a{08..10}", {"x": "T{{0..2}}"}, "c"], "") == [
        ["a08", {"x": "T{0}"}, "c"],
        ["a09", {"x": "T{1}"}, "c"],
        ["a10", {"x": "T{2}"}, "c"],
    ]
    assert several(["{left,right} hand"], "") == [["left hand"], ["right hand"]]


def test_every_gate_is_found_under_the_name_of_its_file() -> None:
    assert {*(f"G{i}" for i in range(1, 9)), "R2", "R4", "R6"} == GATES.keys()  # R5 is about pixels
    assert all(name == gate.name for name, gate in GATES.items())
    g1, g8 = GATES["G1"], GATES["G8"]
    assert isinstance(g1, ConcealedGate) and [len(r.files) for r in g1.runs] == [5, 5, 6, 7, 5, 4]
    assert isinstance(g8, HalvesGate) and len(g8.runs) == 7
    rigs = {p.stem for p in (HERE / "gates" / "rigs").glob("*.toml")}
    assert len(rigs) == 6


def found(effect: str, at: str, confidence: float = 0.8, rivals: tuple[str, ...] = (), **sizes: float) -> Finding:
    family = "dissipation" if "friction" in effect or "drag" in effect else "actuation"
    kind = "actuator" if family == "actuation" else "joint"
    parameters = {name: Estimate(v, "", v, v) for name, v in sizes.items()}
    return Finding(effect, family, {"kind": kind, "name": at}, parameters, "", confidence, list(rivals))


def report(*findings: Finding, verdict: Verdict = "mismatch", significant: bool = False) -> Report:
    mass = {"mass of link": Estimate(2.0, "1", 2, 2), "length of link": Estimate(1.1, "1", 1, 1)}
    left = Unexplained(significant, 0.1, None, "left")
    return Report(verdict, "", list(findings), mass, left, FitErrors("", "mrad", 3, 2, 1), [])


def diagnosed(report: Report) -> Diagnosed:
    t = np.linspace(0, 3, 301)
    push = np.where((t > 1) & (t < 1.3), 0.6, 0.0)
    table = Table(Path("x.csv"), {"t": t, "push": push})
    recording = Recording(
        id="run", source="real", t_state=t, qpos=np.zeros((301, 1)), joint_names=("hinge",), units={"qpos": "rad"}
    )
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    return Diagnosed(model, [table], [recording], [recording], [recording], report, 1.0)


COULOMB = found("coulomb_friction", "hinge", c=0.2, rivals=("stribeck_friction",))
VISCOUS = found("viscous_friction", "hinge", b=0.2)
PUSH = Finding(
    "external_pulse", "force", {"kind": "joint", "name": "hinge"}, {"f": Estimate(0.6, "N m", 0, 1)}, "", 0.9, [],
    when=[(1.0, 1.3)],
)  # fmt: skip


@pytest.mark.parametrize(
    "expectation, met, missed",
    [
        (expectations.Finding(effect=("coulomb_friction",)), report(COULOMB), report(VISCOUS)),
        (expectations.Finding(family="dry friction"), report(COULOMB), report(VISCOUS)),
        (expectations.Finding(family="dissipation", least=2), report(COULOMB, VISCOUS), report(VISCOUS)),
        (expectations.Finding(family="dry friction", alone=True), report(COULOMB), report(COULOMB, VISCOUS)),
        (expectations.Finding(at=("elbow",)), report(found("spring", "elbow")), report(VISCOUS)),
        (expectations.Finding(between={"c": (0.1, 0.3)}), report(COULOMB), report(found("x", "hinge", c=0.4))),
        (expectations.Finding(between={"b": (0.1, 0.3), "c": (0, 1)}), report(COULOMB), report(found("x", "y", k=0.2))),
        (expectations.Finding(rivals=("stribeck_friction",)), report(COULOMB), report(VISCOUS)),
        (expectations.Finding(confidence=0.5), report(COULOMB), report(found("spring", "hinge", 0.3))),
        (expectations.Absent(family="dry friction"), report(VISCOUS), report(VISCOUS, COULOMB)),
        (expectations.Absent(), report(), report(VISCOUS)),
        (expectations.Verdict(any_of=("mismatch",)), report(), report(verdict="undetermined")),
        (expectations.Unexplained(significant=True), report(significant=True), report()),
        (
            expectations.Refitted(name="m c", product={"mass of link": 1, "length of link": 1}, between=(2, 2.3)),
            report(),
            Report("mismatch", "", [], {n: Estimate(1, "1", 1, 1) for n in ("mass of link", "length of link")},
                   Unexplained(False, 0, None, ""), FitErrors("", "", 1, 1, 1), []),
        ),
        (
            expectations.Pushes(columns={"hinge": "push"}, strong=0.2, overlap=0.7, auc=0.97),
            report(PUSH),
            report(VISCOUS),
        ),
        (
            expectations.Pushes(columns={"hinge": "none"}, strong=0.2, false=0.5),
            report(VISCOUS),
            report(PUSH),
        ),
        (
            expectations.Pushes(columns={"hinge": "none"}, strong=0.2, overlap=0.7, auc=0.97),
            report(VISCOUS),
            report(PUSH),
        ),
    ],
)  # fmt: skip
def test_every_expectation_can_be_met_and_missed(
    expectation: expectations.Finding, met: Report, missed: Report
) -> None:
    assert expectation.required()
    assert expectation.check(diagnosed(met)).passed
    assert not expectation.check(diagnosed(missed)).passed


def test_an_opponent_must_be_an_effect_somewhere() -> None:
    for table, message in (
        ({"effect": "drag", "at": "hinge"}, "opponent: the effect 'drag' is unknown"),
        ({"effect": "viscous_friction"}, "opponent: viscous_friction is nowhere; write at which place"),
        ({"effect": "viscous_friction", "at": "hinge", "c": 1}, "viscous_friction, the parameter 'c' is unknown"),
    ):
        with pytest.raises(InputError, match=message):
            EXPECTATIONS["error"](opponent=(table,), most=1.0, seconds=1.0)  # pyright: ignore[reportCallIssue]


def test_halves_confirm_what_both_find_in_family_and_place() -> None:
    stribeck = found("stribeck_friction", "hinge", 0.6)
    here, there = report(COULOMB, VISCOUS), report(stribeck, found("viscous_friction", "elbow"))
    own = confirmed(here, there)
    assert [[f[key] for key in ("confirmed", "alike", "named")] for f in own] == [
        [True, True, False],
        [True, False, False],
    ]
    assert not any(f["confirmed"] for f in confirmed(here, report(found("coulomb_friction", "elbow"))))
    assert not passed(summary([]))  # nothing found is nothing shown
    sure = confirmed(report(COULOMB), report(COULOMB))
    assert passed(summary(sure * 3)) and calibrated(summary(sure * 3)["of_family"])
    assert not passed(summary(sure * 40))  # all confirmed, told with a confidence of .8
    counts = summary(sure + confirmed(report(COULOMB), report()))
    assert (counts["confident"], counts["confident_confirmed"]) == (2, 1) and not passed(counts)


def test_halves_are_disjoint_and_all_there_is() -> None:
    runs = [
        Recording(
            id=str(i),
            source="real",
            t_state=np.arange(3.0),
            qpos=np.zeros((3, 1)),
            joint_names=("hinge",),
            units={"qpos": "rad"},
        )
        for i in range(5)
    ]
    a, b = parted(runs, np.random.default_rng(0))
    assert (len(a), len(b)) == (2, 3) and {r.id for r in (*a, *b)} == set("01234")
