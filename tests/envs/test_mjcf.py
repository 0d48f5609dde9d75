from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import keycld_envs
from keycld_envs.mjcf import Change, EditError, Insert, edit, read_suite

XML = "<mujoco><worldbody><geom name='floor' size='1'/><geom name='rail' size='1'/></worldbody><actuator/></mujoco>"


def test_edits_apply_in_order() -> None:
    edited = edit(
        XML,
        Change("worldbody/geom[@name='floor']", {"size": ("1", "2"), "rgba": (None, "1 0 0 1")}),
        Change("worldbody/geom[@name='floor']", {"size": ("2", None)}),
        Insert("actuator", "motor", {"name": "late"}),
        Insert("actuator", "motor", {"name": "early"}, index=0),
    )
    assert '<geom name="floor" rgba="1 0 0 1" />' in edited
    assert edited.index("early") < edited.index("late")


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (Change("worldbody/geom[@name='roof']", {"size": ("1", "2")}), "0 elements match"),
        (Change("worldbody/geom", {"size": ("1", "2")}), "2 elements match"),
        (Change("worldbody/geom[@name='floor']", {"size": ("3", "2")}), "size='1', expected '3'"),
        (Change("worldbody/geom[@name='floor']", {"rgba": ("1 1 1 1", None)}), "rgba=None, expected '1 1 1 1'"),
        (Insert("sensor", "jointpos", {"name": "q"}), "0 elements match"),
        (Insert("worldbody", "geom", {"name": "rail"}), "already has a geom named 'rail'"),
    ],
)
def test_an_edit_that_does_not_fit_raises(wrong: Change | Insert, message: str) -> None:
    with pytest.raises(EditError, match=message):
        edit(XML, wrong)


def test_read_suite_is_what_dm_control_hands_out(domain: str, dm_control: Callable[[str], Any]) -> None:
    xml, assets = dm_control(f"suite.{domain}").get_model_and_assets()
    found, found_assets = read_suite(domain)
    assert found == (xml.decode() if isinstance(xml, bytes) else xml)
    assert found_assets == assets


def test_the_copies_of_dm_controls_files_are_exact(dm_control: Callable[[str], Any]) -> None:
    originals = Path(dm_control("suite").__file__).parent
    copies = Path(keycld_envs.__file__).parent / "assets"
    paths = [path.relative_to(copies) for path in copies.rglob("*.xml")]
    assert len(paths) == 6
    for path in paths:
        assert (copies / path).read_bytes() == (originals / path).read_bytes(), path
