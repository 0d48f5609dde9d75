import sys

import pytest

from keycld_control.benchmarks.envs import SYSTEMS, frames_per_second
from keycld_envs import InputError


@pytest.mark.render
@pytest.mark.usefixtures("dm_control")
def test_frames_per_second() -> None:
    """Far below the measured 5 to 7 and 1.1 to 1.3, since other processes may disturb; `keycld bench` prints those."""
    measured = frames_per_second(repeats=3, steps=5)
    assert set(measured) == set(SYSTEMS)
    for figures in measured.values():
        assert figures["ratio_fast"] > 2 and figures["ratio_full"] > 0.5
        assert figures["fps_fast"] > figures["fps_full"] > 0 and figures["fps_dm_control"] > 0


def test_without_dm_control_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dm_control.suite.wrappers", None)
    with pytest.raises(InputError, match=r"no dm_control to compare with .* Python 3\.11 or 3\.12"):
        frames_per_second(repeats=1, steps=1)
