"""report.html: what it says, that it needs nothing else, and that its data are those of the diagnosis."""

import base64
import json
import re
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from plants import recordings

from keycld_envs.effects import EFFECTS, ActuatorDeadZone, GravityTilt, StribeckFriction
from keycld_envs.errors import InputError
from keycld_envs.systems import REFERENCE_SYSTEMS, get_system
from keycld_model.diagnosis import Report, diagnose, write_page
from keycld_model.diagnosis.output.page.drawing import draw
from keycld_model.diagnosis.output.page.geometry import skeleton
from keycld_model.diagnosis.output.page.labels import Mark
from keycld_model.diagnosis.output.page.mathml import mathml
from keycld_model.diagnosis.output.page.page import html_page
from keycld_model.diagnosis.output.words import call, measured
from keycld_model.diagnosis.verdict.report import Estimate, Finding, Unexplained
from keycld_model.rigid_body.residual_force import Features, ResidualForce

LIMIT = 8_000_000


@pytest.fixture(scope="module")
def report() -> Report:
    runs = recordings("pendulum", 2, force=lambda t, q, v, u: -0.1 * v, number=4, seconds=1.6)
    return diagnose(runs, get_system("pendulum").compile())


@pytest.fixture(scope="module")
def page(report, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(report, path, "KeyCLD/Pendulum-v0", "corrected.xml")
    return path.read_text(encoding="utf-8")


class Loads(HTMLParser):
    """Everything that a browser would load, and the text that it would show."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.text, self._hidden = "", 0
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self._hidden += tag in ("script", "style")
        self.loads += [str(value) for name, value in attrs if name in ("src", "href", "xlink:href", "data", "poster")]
        self.loads += [str(value) for name, value in attrs if name == "style" and "url(" in str(value)]
        assert tag not in ("link", "iframe", "object", "embed", "base")

    def handle_endtag(self, tag):
        self._hidden -= tag in ("script", "style")

    def handle_data(self, data):
        self.text += "" if self._hidden else data


def embedded(page: str, name: str):
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_the_page_says_what_is_missing_where_and_how_much(report, page):
    text = Loads(page).text.replace("\N{NO-BREAK SPACE}", " ")
    (finding,) = report.findings
    assert finding.effect == "viscous_friction"
    size = measured(finding.parameters["b"])
    assert size.endswith("N·m·s/rad") and size.count("±") == 1
    assert f"The hinge has viscous friction of {size} that the simulator lacks; held-out error falls from" in text
    assert unescape(page).count(report.headline) == 2  # its description and its report
    assert report.unexplained.message in text
    assert 'effects=[ViscousFriction("hinge", b=0.' in text and 'from_xml_path("corrected.xml")' in text
    for name in report.nuisance:
        assert name in text


def test_the_page_says_that_something_stays_unexplained(report):
    left = Unexplained(True, 1.0, "hinge", "The joint 'hinge' still deviates by 9.0 times the noise of its sensor.")
    odd = replace(report, verdict="undetermined", findings=[], unexplained=left)
    text = Loads(html_page(odd)).text.replace("\N{NO-BREAK SPACE}", " ")
    assert f"No effect of the library explains what differs. {left.message}" in text
    assert "Nothing is missing" not in text


def test_the_page_needs_nothing_else_and_is_small(page):
    assert Loads(page).loads == []
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL)
    assert style is not None and not re.search(r"url\(|@import", style.group(1))
    assert "prefers-color-scheme: dark" in style.group(1)
    assert len(page.encode()) < LIMIT


def test_the_data_of_the_page_are_those_of_the_diagnosis(report, page):
    assert embedded(page, "report") == json.loads(json.dumps(report.to_dict()))
    data, rollout = embedded(page, "data"), report.evidence.rollouts[0]
    shown = data["rollouts"][0]
    assert shown["id"] == rollout.recording
    keep = np.isfinite(floats(shown["time"]))
    np.testing.assert_allclose(floats(shown["corrected"][0])[keep], rollout.corrected[:, 0], rtol=1e-6)
    squares = [np.nanmean((r.measured - r.corrected) ** 2) for r in report.evidence.rollouts]
    assert 1e3 * np.sqrt(np.mean(squares)) == pytest.approx(report.fit.corrected, rel=1e-3)
    white = data["whiteness"][0]
    assert white["after"]["within"] > 0.9 > white["before"]["within"]
    assert abs(white["after"]["correlation"][1]) < 0.3 < white["before"]["correlation"][1]
    clip, model = data["mechanism"]["clips"][0], report.evidence.nominal
    points = floats(clip["paths"][0]).reshape(-1, data["mechanism"]["nodes"], 2)
    np.testing.assert_allclose(points, skeleton(model).at(rollout.measured), atol=1e-5)


def test_numbers_that_json_lacks_are_null_and_words_stay_words(report):
    odd = replace(report, details={"NaN": float("nan"), "Infinity": [float("inf"), "NaN"]})
    assert embedded(html_page(odd), "report")["details"] == {"NaN": None, "Infinity": [None, "NaN"]}


def test_evidence_stays_out_of_the_report(report):
    assert "evidence" not in report.to_dict()
    assert replace(report, evidence=None) == report and "Evidence" not in repr(report)
    with pytest.raises(InputError, match="no evidence"):
        html_page(replace(report, evidence=None))


def test_every_kind_of_finding_has_its_place(report):
    """Hostile names, intervals in time, an unknown effect, what MuJoCo lacks."""
    small = Estimate(0.1, "N m", 0.09, 0.11)
    effects = StribeckFriction("hinge", c=0.1, vs=0.3), ActuatorDeadZone("torque", delta=0.1), GravityTilt(alpha=0.02)
    findings = [
        Finding(e.id, e.family, {"kind": e.kind, "name": e.where}, {"c": small, "vs": small}, e.equation, 0.8, [])
        for e in effects
    ]
    findings[0] = replace(
        findings[0], rivals=["coulomb_friction"], rivals_where=[{"kind": "joint", "name": "hinge"}], when=[(0.25, 0.5)]
    )
    unknown = Finding("unknown", "unknown", {"kind": "body", "name": "</script><b>"}, {}, "", 0.7, [])
    left = Unexplained(True, 0.25, "hinge", "The joint 'hinge' still deviates.")
    evidence = replace(report.evidence, effects=effects)
    changed = replace(
        report, verdict="undetermined", findings=[*findings, unknown], unexplained=left, evidence=evidence
    )
    page = html_page(changed, "KeyCLD/Pendulum-v0", "corrected.xml")
    text = Loads(page).text
    for words in ("Stribeck friction", "Actuator dead zone", "Gravity tilt", "Unknown physics", "</script><b>"):
        assert words in text
    assert "may lack" in text and "do not exclude Coulomb friction" in text and "0.25–0.50 s" in text
    assert "25 % of what the refitted" in text and "physics.steps(data, 1)" in text
    assert embedded(page, "data")["when"][0]["intervals"] == {"*": [[0.25, 0.5]]}


def test_a_fitted_function_is_not_spelled_out(report):
    state = np.zeros((4, 1)), np.zeros((4, 1)), np.zeros((4, 1))
    features = Features.draw(np.array([True]), *state, width=1.0, seed=0)
    number = features(*state).shape[-1]
    force = ResidualForce("hinge", features, np.ones((number, 1)), np.ones(number))
    evidence = replace(report.evidence, effects=(*report.evidence.effects, force))
    text = Loads(html_page(replace(report, evidence=evidence), "KeyCLD/Pendulum-v0", "corrected.xml")).text
    assert "a fitted function" in text and "ResidualForce" not in text
    assert call(force) == 'ResidualForce("hinge", features=..., weights=..., precision=...)'


def test_nothing_missing_is_said_so(report):
    page = html_page(replace(report, verdict="no_mismatch", findings=[], evidence=replace(report.evidence, effects=())))
    text = Loads(page).text
    assert "Nothing is missing." in text and embedded(page, "data")["differs"] is False
    assert "corrected.xml" not in text


def test_sixty_long_recordings_stay_below_the_limit(report):
    rollout, residuals = report.evidence.rollouts[0], report.evidence.residuals[0]
    long = {f: np.tile(getattr(rollout, f), (20, 1)) for f in ("measured", "refitted", "corrected")}
    time, starts = np.arange(len(long["measured"])) * 0.01, np.arange(20) * len(rollout.time)
    many = tuple(replace(rollout, recording=f"{i}", time=time, starts=starts, **long) for i in range(60))
    evidence = replace(report.evidence, rollouts=many, residuals=(residuals,) * 60)
    page = html_page(replace(report, evidence=evidence))
    assert len(page.encode()) < LIMIT
    assert len(embedded(page, "data")["rollouts"]) == 60


@pytest.mark.parametrize("system", REFERENCE_SYSTEMS)
def test_the_drawing_shows_all_joints_and_marks_places(system):
    model = get_system(system).compile()
    joints = [model.joint(j).name for j in range(model.njnt)]
    q = np.cumsum(np.random.default_rng(0).normal(0, 0.05, (200, model.nq)), axis=0)
    q[3] = np.nan
    marks = [Mark(1, "joint", joints[-1], "Coulomb friction", "0.1 N·m"), Mark(2, "world", "world", "Gravity tilt", "")]
    drawing = draw(model, np.linspace(0, 2, 200), q, marks)
    root = ElementTree.fromstring(drawing)
    words = [element.text for element in root.iter() if element.tag.endswith("text")]
    assert {*joints, "Coulomb friction", "0.1 N·m", "Gravity tilt"} <= set(words)
    carts = [element for element in root.iter() if element.get("class") == "cart"]
    assert len(carts) == np.sum(model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE))
    halo = next(element for element in root.iter() if element.get("class") == "halo")
    found = next(element for element in root.iter() if element.get("class") == "joint found")
    assert (halo.get("cx"), halo.get("cy")) == (found.get("cx"), found.get("cy"))
    numbers = [float(x) for x in re.findall(r'(?:cx|x1|x2)="([-\d.]+)"', drawing)]
    assert min(numbers) > 0 and max(numbers) < 480


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.id)
def test_every_equation_is_typeset(effect):
    ElementTree.fromstring(mathml(effect.equation).replace("&#8290;", "").replace("&#8289;", ""))
    assert mathml(effect.equation).startswith("<math")


def test_what_is_no_expression_is_shown_as_it_is():
    assert mathml("tau = M(q) x'' <b>") == '<code class="equation">tau = M(q) x&#x27;&#x27; &lt;b&gt;</code>'
