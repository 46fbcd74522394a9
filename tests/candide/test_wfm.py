"""The `.wfm` format: there and back, the report's own style, and what is said of bad files."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from mien.candide.model import Candide
from mien.candide.wfm import Wfm, read_wfm, write_wfm
from mien.errors import MienError

TRIANGLE = """# A face model of one triangle
# VERTEX LIST:
3
0 0 0
1 0 0   # a comment behind a row
0 1 0.5

# FACE LIST:
1
0 2 1
# ANIMATION UNITS LIST:
1
# AUV11 Jaw drop (AU26/27)
2
0 0 -1 0
1 0 -0.5 0.25
# SHAPE UNITS LIST:
0
# ANIMATION PARAMETERS:
1
0 0.75
# SHAPE PARAMETERS:
0
# TEXTURE:
1
2 0.25 0.5
face.bmp
# GLOBAL MOTION:
0 0.1 0
1 1 1
0 0 2
# END OF FILE
"""


@pytest.mark.parametrize("surfaces", [184, 168])
def test_candide_there_and_back(tmp_path: Path, surfaces: int) -> None:
    model = Candide.default(surfaces)
    write_wfm(tmp_path / "candide3.wfm", Wfm.neutral(model))
    back = read_wfm(tmp_path / "candide3.wfm").model
    for f in fields(Candide):
        np.testing.assert_array_equal(getattr(back, f.name), getattr(model, f.name), err_msg=f.name)


def test_state_there_and_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    wfm = Wfm.neutral(Candide.default())
    wfm = replace(wfm, animation=rng.normal(size=wfm.animation.shape), shape=rng.normal(size=wfm.shape.shape))
    wfm = replace(wfm, texture={3: (0.25, 0.5)}, texture_file="face.png", rotation=(0.1, 0.2, 0.3))
    write_wfm(tmp_path / "state.wfm", wfm)
    back = read_wfm(tmp_path / "state.wfm")
    np.testing.assert_array_equal(back.animation, wfm.animation)
    np.testing.assert_array_equal(back.shape, wfm.shape)
    for name in ("texture", "texture_file", "rotation", "scale", "translation"):
        assert getattr(back, name) == getattr(wfm, name)


@pytest.mark.parametrize("name", ["", "face#1.png", "two\nlines.png", " "])
def test_a_texture_whose_file_cannot_be_named_is_not_written(name: str, tmp_path: Path) -> None:
    wfm = replace(Wfm.neutral(Candide.default()), texture={3: (0.25, 0.5)}, texture_file=name)
    with pytest.raises(MienError, match="cannot be the name of the texture's file"):
        write_wfm(tmp_path / "state.wfm", wfm)
    assert not (tmp_path / "state.wfm").exists()


def test_a_model_by_hand(tmp_path: Path) -> None:
    file = tmp_path / "triangle.wfm"
    file.write_text(TRIANGLE)
    wfm = read_wfm(file)
    assert wfm.model.vertex_names == ("vertex_0", "vertex_1", "vertex_2")
    assert wfm.model.triangles.tolist() == [[0, 1, 2]]  # turned to face outwards
    assert wfm.model.animation_unit_names == ("jaw_drop",)
    np.testing.assert_array_equal(wfm.model.animation_units[0], [[0, -1, 0], [0, -0.5, 0.25], [0, 0, 0]])
    assert wfm.model.shape_units.shape == (0, 3, 3)
    assert wfm.animation.tolist() == [0.75]
    assert wfm.texture == {2: (0.25, 0.5)}
    assert wfm.texture_file == "face.bmp"
    assert wfm.translation == (0, 0, 2)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("# VERTEX LIST:\n3", "# VERTEX LIST:\nthree", 3, "number of vertices"),
        ("# VERTEX LIST:\n3", "# VERTEX LIST:\n9999999999", 3, "number of vertices, with a line for each"),
        ("1 0 0 ", "1 0 ", 5, "3 numbers"),
        ("0 1 0.5", "0 1 nan", 6, "finite"),
        ("0 2 1", "0 3 1", 10, "one of 3 vertex entries and found 3"),
        ("0 2 1", "0 -1 1", 10, "one of 3 vertex entries and found -1"),
        ("1 0 -0.5 0.25", "1 0 -0.5", 16, "displacement of animation unit 0"),
        ("0 0.75", "1 0.75", 21, "one of 1 animation unit entries"),
        ("face.bmp\n", "", 31, "the global translation"),
        ("0 0 2\n", "", 31, "the end of the file"),
    ],
)
def test_bad_files_are_named_with_their_line(tmp_path: Path, old: str, new: str, line: int, said: str) -> None:
    file = tmp_path / "bad.wfm"
    assert TRIANGLE.count(old) == 1
    file.write_text(TRIANGLE.replace(old, new))
    with pytest.raises(MienError, match=said) as error:
        read_wfm(file)
    assert f"{file}, line {line}:" in str(error.value)
    assert "correct the file" in str(error.value)


def test_files_that_are_no_text_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(MienError, match=r"missing\.wfm.*check the path"):
        read_wfm(tmp_path / "missing.wfm")
    (tmp_path / "binary.wfm").write_bytes(bytes(range(128, 256)))
    with pytest.raises(MienError, match="line 1: expected the number of vertices"):
        read_wfm(tmp_path / "binary.wfm")
    with pytest.raises(MienError, match="choose another place"):
        write_wfm(tmp_path / "binary.wfm" / "no_folder.wfm", Wfm.neutral(Candide.default()))
