import re
import sys

import pytest

from keycld_control.benchmarks.envs import speed_figures
from keycld_envs import REFERENCE_SYSTEMS, SYSTEMS

DOMAINS = [name for name in REFERENCE_SYSTEMS if f"{name}-stock" in SYSTEMS]
"""Systems of dm_control."""


@pytest.mark.render
@pytest.mark.usefixtures("dm_control")
def test_frames_per_second() -> None:
    """Far below the measured 5 to 7 and 1.1 to 1.3, since other processes may disturb; `keycld bench` prints those."""
    figures = list(speed_figures(DOMAINS, repeats=3, steps=5))
    assert [(f.system, f.required) for f in figures] == [(s, r) for s in DOMAINS for r in (5.0, 1.0)]
    for figure in figures:
        assert figure.reached is not None and figure.reached > 0.4 * (figure.required or 0)
        fps = figure.details
        assert fps["fps_fast"] > fps["fps_full"] > 0 and fps["fps_dm_control"] > 0


def test_without_dm_control_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dm_control.suite.wrappers", None)
    for figure in speed_figures(DOMAINS[:1]):
        assert figure.reached is None
        assert re.search(r"no dm_control to compare with .* Python 3\.11 or 3\.12", figure.details["reason"])
