"""Part of the fuzz suite (`make fuzz`), with hypothesis: what is damaged is refused, or is what was written."""

import random
import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from keycld_envs.errors import InputError

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parent.parent / "model")]

import damage  # noqa: E402

QUICK = [t for t in damage.TARGETS if t.name not in ("MATLAB", "MATLAB, compressed", "recording: video", "MJCF")]
LONG = ("checkpoint", "state of a training", "joint model", "LeRobot")
"""Of these, what builds a network or a video first."""
OFTEN = settings(
    max_examples=25,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.differing_executors],
)


@pytest.mark.parametrize(
    "target",
    [pytest.param(target, id=target.name, marks=[pytest.mark.long] if target.name in LONG else []) for target in QUICK],
)
@OFTEN
@given(how=st.sampled_from(sorted(damage.DAMAGES)), seed=st.integers(0, 2**32))
def test_damaged_files_are_refused_or_what_was_written(tmp_path_factory, target, how, seed):
    folder = tmp_path_factory.mktemp("damaged")
    path = target.make(folder)
    whole, before = path.read_bytes(), target.read(folder)
    content = damage.DAMAGES[how](whole, random.Random(seed))
    path.write_bytes(content)
    try:
        after = target.read(folder)
    except InputError as error:
        assert "\n" not in str(error) and len(str(error)) < 1100
    else:
        assert after == before or not target.sealed


@settings(OFTEN, max_examples=60)
@given(seed=st.integers(0, 2**32))
def test_odd_arguments_work_or_are_refused(tmp_path_factory, seed):
    damage.OPTIONS_FOLDER = str(tmp_path_factory.mktemp("options"))
    try:
        damage.try_options(random.Random(seed))
    except InputError as error:
        assert "\n" not in str(error)
