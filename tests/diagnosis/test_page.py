"""report.html: what it says, that it needs nothing else, and that its data are those of the diagnosis."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from plants import NOISE

from keycld_envs.effects import EFFECTS, ActuatorDeadZone, GravityTilt, StribeckFriction, ViscousFriction, edited
from keycld_envs.errors import InputError
from keycld_envs.recordings.video import decode
from keycld_envs.systems import REFERENCE_SYSTEMS, get_system
from keycld_model.diagnosis import Evidence, Report, write_page
from keycld_model.diagnosis.output.page import html_page
from keycld_model.diagnosis.output.page.drawing import draw
from keycld_model.diagnosis.output.page.elements import element, markup
from keycld_model.diagnosis.output.page.geometry import skeleton
from keycld_model.diagnosis.output.page.labels import Mark
from keycld_model.diagnosis.output.page.mathml import mathml
from keycld_model.diagnosis.output.page.strip import NUMBER
from keycld_model.diagnosis.output.words import call, effect_name, error, headline, measured
from keycld_model.diagnosis.verdict.evidence import Picture, Residuals, Rollout
from keycld_model.diagnosis.verdict.region import Shape
from keycld_model.diagnosis.verdict.report import Estimate, Experiment, Finding, FitErrors, Unexplained
from keycld_model.rigid_body.residual_force import Features, ResidualForce

LIMIT = 8_000_000
SEEN = {"trusted_frames": 1.0, "read_frames": 1.0, "repeated": 0, "left_out": []}


def swing(model: mujoco.MjModel, seconds: float = 1.6) -> np.ndarray:
    """Positions `[T, 1]` of a pendulum that is let go, every 10 ms."""
    data, out = mujoco.MjData(model), []
    model.opt.timestep, model.opt.integrator = 0.01, mujoco.mjtIntegrator.mjINT_RK4
    data.qpos[:] = 2.0
    for _ in range(round(seconds / 0.01)):
        out.append(data.qpos.copy())
        mujoco.mj_step(model, data)
    return np.array(out)


@pytest.fixture(scope="module")
def report() -> Report:
    """Of a pendulum whose simulator lacks viscous friction, as a diagnosis would report it."""
    rng, model, missing = np.random.default_rng(0), get_system("pendulum").compile(), ViscousFriction("hinge", b=0.1)
    refitted, corrected = swing(model), swing(edited(model, [missing]))
    time, starts = np.linspace(0, 1.59, len(refitted)), np.arange(0, len(refitted), 40)
    rollouts, residuals = [], []
    for run in range(3):
        measured = corrected + NOISE * rng.normal(size=corrected.shape)
        before, after = ((measured - fit) / NOISE for fit in (refitted, corrected))
        if run:
            residuals.append(Residuals(f"run-{run}", time, before, after, starts))
        else:
            lines = measured, refitted, corrected
            rollouts.append(Rollout("run-0", time, *lines, np.stack(lines), np.zeros(1, dtype=np.int64)))
    (found,) = missing.parameters()
    finding = Finding(
        missing.id, missing.family, {"kind": "joint", "name": "hinge"},
        {"b": Estimate(0.101, found.unit, 0.099, 0.103)}, missing.equation, 0.92, [],
    )  # fmt: skip
    fit, left = FitErrors("root mean square", "mrad", 27.9, 21.6, 1.19, 2.52), Unexplained(False, 0.0, None, "noise")
    return Report(
        "mismatch", headline("mismatch", [finding], fit, left), [finding],
        {"mass of pole": Estimate(0.954, "1", 0.945, 0.963), "zero of hinge": Estimate(-5e-3, "rad", -6e-3, -4e-3)},
        left, fit, ["run-0"], details={"dispersion": 1.0, "noise": [NOISE]},
        evidence=Evidence(
            model, model, (missing,), ("hinge",), ("rad",), np.array([NOISE]), tuple(rollouts), tuple(residuals)
        ),
    )  # fmt: skip


@pytest.fixture(scope="module")
def page(report, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(report, path, "KeyCLD/Pendulum-v0", "corrected.xml")
    return path.read_text(encoding="utf-8")


class Page(HTMLParser):
    """What a browser makes of a page.

    Attributes:
        loads: everything that it would load.
        elements: tags and attributes, in order.
        texts: what it would show, by the ids of the elements around it; under "" all.
    """

    def __init__(self, page: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.texts: dict[str, str] = {"": ""}
        self._open: list[tuple[str, str]] = []
        self.feed(page)
        assert not self._open

    def handle_starttag(self, tag, attrs):
        given = {name: str(value) for name, value in attrs}
        self.elements.append((tag, given))
        if tag not in ("meta", "input"):
            self._open.append((tag, given.get("id", "")))
        self.loads += [given[name] for name in ("src", "href", "xlink:href", "data", "poster") if name in given]
        self.loads += [given["style"]] if "url(" in given.get("style", "") else []
        assert tag not in ("link", "iframe", "object", "embed", "base")

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag):
        assert self._open.pop()[0] == tag

    def handle_data(self, data):
        if not {"script", "style"} & {tag for tag, _ in self._open}:
            for id in {"", *(id for _, id in self._open)}:
                self.texts[id] = self.texts.get(id, "") + data.replace("\N{NO-BREAK SPACE}", " ")

    def all(self, tag: str, **attributes: str) -> list[dict[str, str]]:
        """Attributes of elements that have these, with `_` for `-`."""
        wanted = {name.rstrip("_").replace("_", "-"): value for name, value in attributes.items()}
        return [given for name, given in self.elements if name == tag and wanted.items() <= given.items()]

    def one(self, tag: str, **attributes: str) -> dict[str, str]:
        (found,) = self.all(tag, **attributes)
        return found

    def bars(self) -> dict[str, float]:
        """Widths in % of the bars of held-out errors, by what they are of."""
        names = [bar["data-of"] for bar in self.all("div", class_="bar")]
        return {name: float(self.one("span", class_=f"fill {name}")["style"][6:-1]) for name in names}


def embedded(page: str, name: str):
    found = re.search(rf'<script type="application/json" id="{name}">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


def floats(text: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), "<f4")


def test_the_page_says_what_is_missing_where_and_how_much(report, page):
    shown, (finding,) = Page(page), report.findings
    assert finding.effect == "viscous_friction"
    size = measured(finding.parameters["b"])
    assert size.endswith("N·m·s/rad") and size.count("±") == 1
    card = shown.one("article")
    assert (card["data-effect"], card["data-kind"], card["data-place"]) == ("viscous_friction", "joint", "hinge")
    for words in ("hinge", "viscous friction", size, error(report.fit.refitted), error(report.fit.corrected)):
        assert words in report.headline
    assert shown.texts["headline"] == report.headline == shown.one("meta", name="description")["content"]
    assert shown.texts["unexplained"].endswith(f"{report.unexplained.message}\n")
    assert shown.one("section", id="unexplained")["data-significant"] == "false"
    assert size in shown.texts["finding-1"] and f"{100 * finding.confidence:.0f} %" in shown.texts["finding-1"]
    assert call(report.evidence.effects[0]) in shown.texts["use"]
    assert 'from_xml_path("corrected.xml")' in shown.texts["use"]
    assert {row["data-name"] for row in shown.all("tr")} == {*finding.parameters, *report.nuisance}


def test_the_page_says_that_something_stays_unexplained(report):
    left = Unexplained(True, 0.25, "hinge", "hinge: 9 times the noise")
    odd = replace(report, verdict="undetermined", findings=[], unexplained=left)
    odd = replace(odd, headline=headline(odd.verdict, odd.findings, odd.fit, left))
    shown = Page(html_page(odd))
    nothing = headline("no_mismatch", [], odd.fit, replace(left, significant=False))
    assert left.message in odd.headline and left.message not in nothing
    assert shown.texts["headline"] == odd.headline and shown.all("article") == []
    assert left.message in shown.texts["unexplained"] and shown.one("span", data_fraction="0.25")
    assert shown.one("section", id="unexplained")["data-significant"] == "true"


@pytest.mark.parametrize("ceiling", [None, 2.0, 19.5, 4487.0, float("inf"), float("nan")])
def test_bars_are_as_long_as_errors_and_none_is_squeezed_by_a_residual_force_that_fails(report, ceiling):
    fit = replace(report.fit, nominal=335.0, refitted=19.0, corrected=1.2, ceiling=ceiling)
    shown = Page(html_page(replace(report, fit=fit)))
    errors = {"nominal": 335.0, "refitted": 19.0, "corrected": 1.2, "noise": 1e3 * report.evidence.noise[0]}
    errors |= {"ceiling": 2.0} if ceiling == 2 else {}
    assert shown.bars() == pytest.approx({name: 100 * value / 335 for name, value in errors.items()}, abs=0.01)
    fails = ceiling is not None and ceiling != 2
    assert len(shown.all("p", id="ceiling-fails")) == fails
    assert ("4487" in shown.texts["errors"]) == (ceiling == 4487)


def test_the_page_needs_nothing_else_and_is_small(page):
    assert Page(page).loads == []
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
    """Intervals in time, a residual force, what MuJoCo lacks."""
    small = Estimate(0.1, "N m", 0.09, 0.11)
    effects = StribeckFriction("hinge", c=0.1, vs=0.3), ActuatorDeadZone("torque", delta=0.1), GravityTilt(alpha=0.02)
    findings = [
        Finding(e.id, e.family, {"kind": e.kind, "name": e.where}, {"c": small, "vs": small}, e.equation, 0.8, [])
        for e in effects
    ]
    findings[0] = replace(
        findings[0], rivals=["coulomb_friction"], rivals_where=[{"kind": "joint", "name": "hinge"}], when=[(0.25, 0.5)]
    )
    region = {"qpos:hinge": (-1.0, 0.5)}
    findings.append(Finding("unknown", "unknown", {"kind": "joint", "name": "hinge"}, {}, "", 0.995, [], region=region))
    along = np.linspace(-1, 1, 50)
    evidence = replace(report.evidence, effects=effects, shape=Shape("hinge", True, along, -along, along**2))
    changed = replace(report, verdict="undetermined", findings=findings, evidence=evidence)
    page = html_page(changed, "KeyCLD/Pendulum-v0", "corrected.xml")
    shown = Page(page)
    cards = [(card["id"], card["data-effect"], card["data-place"]) for card in shown.all("article")]
    assert cards == [(f"finding-{i + 1}", f.effect, f.where["name"]) for i, f in enumerate(findings)]
    for card, finding in zip(cards, findings, strict=True):
        assert effect_name(finding.effect) in shown.texts[card[0]] and effect_name(finding.effect) in shown.texts[""]
    assert [rival["data-rival"] for rival in shown.all("span") if "data-rival" in rival] == ["coulomb_friction"]
    assert "0.25–0.50 s" in shown.texts["finding-1"] and "−1 to 0.5" in shown.texts["finding-4"]
    assert "> 99 %" in shown.texts["finding-4"] and len(shown.all("polyline", class_="middle")) == 2
    assert "physics.steps(data, 1)" in shown.texts["use"] and shown.all("p", class_="functions") == []
    assert embedded(page, "data")["when"][0]["intervals"] == {"*": [[0.25, 0.5]]}


@pytest.mark.parametrize("name", ["</script><b>", '"><img src=x onerror=alert(1)>', "a & b's", "{{ 7 * 7 }}"])
def test_names_of_users_stay_words(report, name):
    """In the drawing, cards, tables, code and data."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name=name)
    body.add_joint(name=name, axis=[0, 1, 0])
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[0, 0, 0, 0, 0, -1], size=[0.1, 0, 0])
    model, viscous = spec.compile(), ViscousFriction(name, b=0.1)
    (finding,) = report.findings
    at = {"kind": "joint", "name": name}
    findings = [replace(finding, where=at), Finding("unknown", "unknown", at, {}, "", 0.7, ["spring"], [at])]
    findings.append(
        Finding(
            "unknown", "unknown", {"kind": "body", "name": name}, {}, name, 0.7, [], region={f"qpos:{name}": (0.0, 1.0)}
        )
    )
    along = np.linspace(-1, 1, 50)
    evidence = replace(
        report.evidence, nominal=model, refitted=model, effects=(viscous,), channels=(name,),
        shape=Shape(name, True, along, along, along),
    )  # fmt: skip
    experiment = Experiment(at, "release it", {name: 0.1}, ["nothing"], 20.0, True)
    hostile = replace(
        report, headline=name, findings=findings, evidence=evidence, next_experiment=experiment, held_out=[name],
        nuisance={f"zero of {name}": report.nuisance["zero of hinge"]}, unexplained=Unexplained(True, 0.1, name, name),
        fit=replace(report.fit, metric=f"of {name}"), details={name: [name]},
    )  # fmt: skip
    page = html_page(hostile, name, name)
    shown, plain = Page(page), Page(html_page(report))
    assert shown.loads == [] and {tag for tag, _ in shown.elements} - {tag for tag, _ in plain.elements} <= {
        "code", "desc", "polyline", "text", "button", "pre", "b", "msub",
    }  # fmt: skip
    assert not [given for _, given in shown.elements if "onerror" in given]
    assert [card["data-place"] for card in shown.all("article")] == [name] * 3
    for id in (
        "headline",
        "errors",
        "unexplained",
        "next",
        "nuisances",
        "details",
        "finding-1",
        "finding-3",
        "described",
    ):
        assert name in shown.texts[id], id
    assert json.dumps(name) in shown.texts["use"] and shown.one("tr", data_name=f"zero of {name}")
    assert embedded(page, "data")["channels"][0]["name"] == embedded(page, "report")["headline"] == name


def test_a_fitted_function_is_not_spelled_out(report):
    state = np.zeros((4, 1)), np.zeros((4, 1)), np.zeros((4, 1))
    features = Features.draw(np.array([True]), *state, width=1.0, seed=0)
    number = features(*state).shape[-1]
    force = ResidualForce("hinge", features, np.ones((number, 1)), np.ones(number))
    evidence = replace(report.evidence, effects=(*report.evidence.effects, force))
    shown = Page(html_page(replace(report, evidence=evidence), "KeyCLD/Pendulum-v0", "corrected.xml"))
    assert shown.one("p", class_="functions") and "ResidualForce" not in shown.texts["use"]
    assert call(force) == 'ResidualForce("hinge", features=..., weights=..., precision=...)'


def test_nothing_missing_is_said_so(report):
    nothing = replace(report, verdict="no_mismatch", findings=[], evidence=replace(report.evidence, effects=()))
    page = html_page(nothing)
    shown = Page(page)
    assert shown.one("span", id="verdict")["class"] == "chip no_mismatch" and shown.one("p", class_="lead none")
    assert shown.all("article") == [] and embedded(page, "data")["differs"] is False
    assert "corrected" not in shown.bars() and shown.all("pre") == [] and "corrected.xml" not in page


@pytest.mark.parametrize("number", range(1, 7))
def test_the_headline_names_findings_and_counts_the_others(report, number):
    (one,) = report.findings
    findings = [replace(one, where={"kind": "joint", "name": f"j_{i}"}) for i in range(number)]
    said = headline("mismatch", findings, report.fit, report.unexplained)
    shown = number if number <= 4 else 4
    assert [f"j_{i}" in said for i in range(number)] == [i < shown for i in range(number)]
    assert (f"{number - shown} more" in said) == (number > shown)
    assert (measured(one.parameters["b"]) in said) == (number < 3)


def test_sixty_long_recordings_stay_below_the_limit(report):
    rollout, residuals = report.evidence.rollouts[0], report.evidence.residuals[0]
    long = {f: np.tile(getattr(rollout, f), (20, 1)) for f in ("measured", "refitted", "corrected")}
    long["poses"] = np.tile(rollout.poses, (1, 20, 1))
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
    root = draw(model, np.linspace(0, 2, 200), q, marks)
    words = [element.text for element in root.iter() if element.tag == "text"]
    assert {*joints, "Coulomb friction", "0.1 N·m", "Gravity tilt"} <= set(words)
    carts = [element for element in root.iter() if element.get("class") == "cart"]
    assert len(carts) == np.sum(model.jnt_type == int(mujoco.mjtJoint.mjJNT_SLIDE))
    halo = next(element for element in root.iter() if element.get("class") == "halo")
    found = next(element for element in root.iter() if element.get("class") == "joint found")
    assert (halo.get("cx"), halo.get("cy")) == (found.get("cx"), found.get("cy"))
    numbers = [float(element.get(name, 240)) for element in root.iter() for name in ("cx", "x1", "x2")]
    assert min(numbers) > 0 and max(numbers) < 480


def test_the_drawing_is_as_wide_as_its_longest_words():
    model = get_system("pendulum").compile()
    widths = []
    for value in ("0.1 N·m", "0.02003 ± 0.00011 N·m·s/rad"):
        root = draw(model, np.zeros(1), np.zeros((1, 1)), [Mark(1, "joint", "hinge", "Viscous friction", value)])
        widths.append(float(root.get("viewBox", "").split()[2]))
    assert widths[0] == 480 < widths[1]


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=lambda effect: effect.id)
def test_every_equation_is_typeset(effect):
    root = mathml(effect.equation)
    assert (root.tag, root.get("aria-label")) == ("math", effect.equation)
    assert ElementTree.fromstring(str(markup(root))).tag == "math"
    letters = {character for node in root.iter() for character in node.text or ""}
    assert {"=", *(p.name[0] for p in effect.parameters() if p.name in effect.equation.split())} - letters <= {
        *"abgdetlmpsow"
    }


@pytest.mark.parametrize(
    "equation, shown",
    [
        ("a + b*(c - d)", "a+b⁢(c−d)"),
        ("-(a/b)^2", "−(a/b)2"),
        ("|x|*sin(y)", "|x|⁢sin⁡(y)"),
        ("J'*w for q_1 >= 0", "J⊤⁢ω\u2003for\u00a0q1≥0"),
        ("x if y < z else 0", "x\u00a0if\u00a0y<z\u00a0else\u00a00"),
    ],
)
def test_an_equation_reads_as_it_is_written(equation, shown):
    assert "".join(mathml(equation).itertext()) == shown


def test_what_is_no_expression_is_shown_as_it_is():
    root = mathml("tau = M(q) x'' <b>")
    assert (root.tag, root.text, len(root)) == ("code", "tau = M(q) x'' <b>", 0)
    assert "&lt;b&gt;" in markup(root)


def test_text_of_an_element_comes_first():
    with pytest.raises(ValueError, match="first"):
        element("p", element("b"), "text")


def test_a_page_of_images_that_could_not_be_read():
    model, none = get_system("pendulum").compile(), float("nan")
    sentence = "Only 0 % of the frames show the simulator."
    unread = Report(
        verdict="undetermined",
        headline=sentence,
        findings=[],
        nuisance={},
        unexplained=Unexplained(True, 1.0, None, sentence),
        fit=FitErrors("not measured", "", none, none, none),
        held_out=[],
        details={"images": {"trusted_frames": 0.0}},
        evidence=Evidence(model, model, (), (), (), np.zeros(0), (), (), of_sensors=False),
    )
    text = html_page(unread)
    assert sentence in text and "undetermined" in text
    assert 'id="errors"' not in text and 'id="rollouts"' not in text and 'id="residuals"' not in text


def test_frames_of_a_film_move_with_their_links_drawn_over_them(report, tmp_path):
    others = [[[16.0, 16], [4, 28]]]
    links = [np.array([[[[16.0, 16], [16 + k, 28]]], others, others]) for k in range(12)]
    links[5][0] = np.nan  # not seen
    frames = tuple(Picture("run-0", 0.02 * k, np.zeros((32, 48, 3), np.uint8), ends) for k, ends in enumerate(links))
    assert report.evidence is not None
    page = html_page(replace(report, evidence=replace(report.evidence, pictures=frames), details={"images": SEEN}))
    assert page.count('<figure><svg viewBox="0 0 48 32"') == NUMBER
    ((_, clip),) = [(tag, given) for tag, given in Page(page).elements if tag == "video"]
    path = tmp_path / "film.mp4"
    path.write_bytes(base64.b64decode(clip["src"].removeprefix("data:video/mp4;base64,")))
    shown = np.stack(list(decode(path)))
    assert shown.shape == (12, 256, 384, 3)
    yellow = (shown[..., 0] > 150) & (shown[..., 2] < 120)
    assert [bool(frame.any()) for frame in yellow] == [k != 5 for k in range(12)]
    right = [np.flatnonzero(frame[220:228].any(0)).mean() / 8 for k, frame in enumerate(yellow) if k != 5]
    assert (shown[:, 160:216, 40:120, 2] > 150).any((1, 2)).all()  # blue
    assert right == pytest.approx([16.5 + k * 11.5 / 12 for k in range(12) if k != 5], abs=0.5)


def test_the_headline_says_where_the_simulator_did_better_as_it_was(report):
    astray = "As it was handed in, the simulator does better"
    worse = replace(report.fit, nominal=0.5 * report.fit.corrected)
    assert f"{astray}, {error(worse.nominal)} mrad" in headline(
        "undetermined", report.findings, worse, report.unexplained
    )
    assert astray not in report.headline
