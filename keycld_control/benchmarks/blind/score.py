"""Opens the answers and compares them with the reports of every method that ran."""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from keycld_control.benchmarks.blind.make import name
from keycld_control.benchmarks.blind.match import CaseResult, Key
from keycld_control.benchmarks.blind.measures import REQUIRED, Required, measures
from keycld_control.benchmarks.blind.run import read_manifest, read_report, reports
from keycld_control.benchmarks.blind.tables import markdown
from keycld_envs.errors import InputError
from keycld_envs.files import atomic_file


def score(out: Path, partial: bool = False) -> dict[str, Any]:
    """Score all methods, and write `score.md`.

    Args:
        out: folder of the benchmark.
        partial: leave out cases that have no report yet, and say how many.

    Returns:
        Per method its rows, the confusion of truth and findings, and the cases that it got wrong.

    Raises:
        InputError: if the answers are not those that the manifest sealed, or no method has run on all cases.
    """
    manifest = read_manifest(out)
    answers = read_answers(out, manifest)
    methods = ["diagnose"] if (out / "reports").is_dir() else []
    methods += [p.name.removeprefix("reports-") for p in out.glob("reports-*")]
    if not methods:
        raise InputError(f"{out} has no reports; run `keycld blind run {out}` first.")
    methods.sort(key=lambda m: (m != "diagnose", m))
    required = REQUIRED[manifest.get("observe", "states")]
    scored = {method: _score(_results(out, method, answers, partial), required) for method in methods}
    result = {"manifest": manifest, "methods": scored}
    with atomic_file(out / "score.md", "w") as file:
        file.write(markdown(result))
    return result


def read_answers(out: Path, manifest: dict[str, Any]) -> list[dict[str, Any]]:
    """The answers that a manifest sealed.

    Raises:
        InputError: if they are missing, or others.
    """
    path = out / "answers.json"
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read; put the answers back that were made with the cases.") from error
    if hashlib.sha256(content).hexdigest() != manifest["answers_sha256"]:
        raise InputError(f"{path} is not what manifest.json sealed (answers_sha256 differs); put the original back.")
    return json.loads(content)


def _results(out: Path, method: str, answers: Sequence[dict[str, Any]], partial: bool) -> list[CaseResult]:
    folder, results = reports(out, method), []
    for i, answer in enumerate(answers):
        path = folder / f"{name(i)}.json"
        if partial and not path.exists():
            continue
        results.append(CaseResult(answer, read_report(out, method, i)))
    return results


def _score(results: Sequence[CaseResult], required: Required) -> dict[str, Any]:
    single = [t for t in results if len(t.truth) < 2]
    confusion: dict[str, Counter[str]] = {}
    for t in single:
        truth = t.truth[0][0] if t.truth else "nothing"
        confusion.setdefault(truth, Counter())[" + ".join(sorted(e for e, _ in t.said)) or "nothing"] += 1
    return {
        "cases": len(results),
        "rows": [row.to_dict() for row in measures(results, required)],
        "confusion": {truth: dict(said.most_common()) for truth, said in sorted(confusion.items())},
        "wrong": [_wrong(t) for t in results if not _correct(t)],
    }


def _correct(result: CaseResult) -> bool:
    """What a case should come to; effects that are not clear are nobody's fault."""
    if result.output["failure"] is not None:
        return False
    if result.answer["category"] == "null":
        return result.verdict == "no_mismatch" and not result.said
    if not result.clear:
        return True
    return result.says_outside if result.answer["category"] == "outside" else result.right


def _wrong(result: CaseResult) -> dict[str, Any]:
    answer = result.answer
    return {
        "case": answer["case"],
        "system": answer["system"],
        "excitation": answer["excitation"],
        "truth": [
            f"{_text(key)}{' ' + str(t['parameters'].get('kind', '')) if key[0] == 'unknown' else ''}"
            for key, t in zip(result.truth, answer["truth"], strict=True)
        ],
        "said": [_text(key) for key in result.said],
        "rivals": sorted({str(r) for f in result.report.get("findings", ()) for r in f.get("rivals", ())}),
        "verdict": result.verdict,
        "grade": answer["grade"],
        "gain_nats": [round(t["gain_nats"], 1) for t in answer["truth"]],
        "recovery": result.recovery,
        "failure": result.output["failure"],
    }


def _text(key: Key) -> str:
    return key[0] if key[1] == "*" else f"{key[0]} at {key[1]}"
