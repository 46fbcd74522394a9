"""The moving head as glTF: what a player of it shows is the mesh of the track."""

from __future__ import annotations

import json
import re
from codeop import compile_command
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from mien._version import __version__
from mien.arrays import Array
from mien.candide.model import TRACKED_UNITS, Candide
from mien.errors import MienError, MienWarning
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.fit import tracked_model
from mien.output.gltf import is_gltf_of_mien
from mien.output.track import Track
from mien.tracking.state import Closing, Estimate, Status

SURFACES = Candide.default(168).triangles
SHOWN = np.unique(SURFACES)
"""The vertices of a track that are corners of a surface, as those of a file are."""
CAMERA, SIZE = Camera.from_fov(320, 240), (320, 240)
NAMES = [*TRACKED_UNITS, "eyes_closed", "brow_lowerer_eyes_closed"]
FLOAT = 1e-7
"""Metres by which 32-bit floats may move a point at a distance of one: a ten-thousandth of a millimetre."""


def estimate(index: int, R: Array = FACING, t_mm: tuple[float, ...] = (50, -25, 900), **others: Any) -> Estimate:
    given = {"animation": np.zeros(6), "mm_per_unit": 100.0, "confidence": 1.0} | others
    return Estimate(index, index / 25, Status.TRACKED, R, np.array(t_mm) / 100, **given)


def lost(index: int) -> Estimate:
    return Estimate.lost(Frame(np.zeros((4, 4, 3), np.uint8), index, index / 25), "gone")


def metadata(vertices: Array, units: Array, camera: Camera = CAMERA) -> dict[str, Any]:
    """What a track says of a face (V, 3) and its units (6, V, 3), in CANDIDE units, and of the video."""
    moved = {
        name: {"moved": np.flatnonzero(unit.any(axis=1)).tolist(), "by": (100 * unit[unit.any(axis=1)]).tolist()}
        for name, unit in zip(TRACKED_UNITS, units, strict=True)
    }
    video = dict(zip(("width", "height"), SIZE, strict=True))
    return {"mesh": {"vertices": (100 * vertices).tolist(), "units": moved}, "camera": asdict(camera), "video": video}


MODEL, _ = tracked_model(Candide.default())
FACE = metadata(MODEL.mean, MODEL.animation_units)


@dataclass(frozen=True)
class Played:
    """A file as a player reads it. time: (n,) seconds of the keys; t: (n, 3); q: (n, 4) x, y, z, w; weights: (n, K)."""

    content: dict[str, Any]
    binary: bytes

    @classmethod
    def read(cls, path: Path) -> Played:
        data = path.read_bytes()
        assert data[:8] == b"glTF" + (2).to_bytes(4, "little")
        assert int.from_bytes(data[8:12], "little") == len(data)
        end = 20 + int.from_bytes(data[12:16], "little")
        assert (data[16:20], data[end + 4 : end + 8]) == (b"JSON", b"BIN\0")
        return cls(json.loads(data[20:end]), data[end + 8 :])

    def values(self, accessor: int) -> Array:
        known = self.content["accessors"][accessor]
        view = self.content["bufferViews"][known["bufferView"]]
        part = self.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        values = np.frombuffer(part, {5126: "<f4", 5125: "<u4"}[known["componentType"]]).astype(float)
        values = values.reshape(known["count"], {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[known["type"]])
        np.testing.assert_array_equal([values.min(axis=0), values.max(axis=0)], [known["min"], known["max"]])
        return values

    @property
    def primitive(self) -> dict[str, Any]:
        return dict(self.content["meshes"][0]["primitives"][0])

    @property
    def time(self) -> Array:
        return self.values(self.content["animations"][0]["samplers"][0]["input"])[:, 0]

    @property
    def untracked(self) -> list[list[float]]:
        return list(self.content["animations"][0]["extras"]["untracked"])

    @property
    def triangles(self) -> NDArray[np.intp]:
        return self.values(self.primitive["indices"]).astype(np.intp).reshape(-1, 3)

    def keys(self, path: str) -> Array:
        """(n, k) what the node has at the keys."""
        (animation,) = self.content["animations"]
        (channel,) = (c for c in animation["channels"] if c["target"] == {"node": 0, "path": path})
        return self.values(animation["samplers"][channel["sampler"]]["output"]).reshape(len(self.time), -1)

    def vertices(self) -> Array:
        """(n, V, 3) metres at the keys: x right, y up, z towards the viewer."""
        base = self.values(self.primitive["attributes"]["POSITION"])
        targets = np.stack([self.values(target["POSITION"]) for target in self.primitive["targets"]])
        points = base + np.tensordot(self.keys("weights"), targets, axes=1)
        q = self.keys("rotation")[:, None]
        axis, w = q[..., :3], q[..., 3:]
        turned = points + 2 * np.cross(axis, np.cross(axis, points) + w * points)
        return np.asarray(turned + self.keys("translation")[:, None])


def played(track: Track, folder: Path) -> Played:
    return Played.read(track.save_gltf(folder / "head.glb"))


def assert_is_mesh(shown: Played, track: Track) -> None:
    """At every key, of which each known row has one, the vertices are those of the track; the last are held to its
    end."""
    meshes = [mesh for row in range(len(track)) if (mesh := track.mesh(row)) is not None]
    meshes += [meshes[-1]] * (track.status[-1] == "lost")
    assert shown.time[-1] == np.float32(track.time[-1])
    np.testing.assert_allclose(shown.vertices(), np.stack(meshes)[:, SHOWN] * [1, -1, -1] / 1000, rtol=0, atol=FLOAT)


@given(seed=st.integers(0, 10**6), lids=st.booleans())
def test_every_frame_is_the_mesh_of_the_track(seed: int, lids: bool, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Of any face, whose units move the lids or do not, in any pose, and with eyes that are sometimes unknown."""
    rng = np.random.default_rng(seed)
    units = MODEL.animation_units + (rng.normal(0, 0.05, (6, 113, 3)) if lids else 0)
    known = metadata(MODEL.mean + rng.normal(0, 0.05, (113, 3)), units)
    track = Track.from_estimates(
        [
            lost(k)
            if rng.random() < 0.2 and k > 0
            else estimate(
                k,
                matrix_from_euler(rng.uniform(-3, 3, 3)) @ FACING,
                (*rng.uniform(-300, 300, 2), rng.uniform(200, 900)),
                animation=rng.uniform(-1, 2, 6),
                closing=Closing(rng.uniform(-0.2, 1.1), 0.1) if rng.random() < 0.7 else None,
            )
            for k in range(5)
        ],
        known,
    )
    assert_is_mesh(played(track, tmp_path_factory.mktemp("gltf")), track)


def test_a_face_that_looks_into_the_camera_by_hand(tmp_path: Path) -> None:
    """It is as CANDIDE and glTF have it, upright and looking along z: 5 cm to the right, 2.5 up, 90 away."""
    shown = played(Track.from_estimates([estimate(0)], FACE), tmp_path)
    np.testing.assert_allclose(shown.keys("translation"), [[0.05, 0.025, -0.9]], atol=FLOAT)
    np.testing.assert_allclose(shown.keys("rotation"), [[0, 0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(
        shown.values(shown.primitive["attributes"]["POSITION"]), 0.1 * MODEL.mean[SHOWN], atol=FLOAT
    )
    assert shown.content["asset"] == {"version": "2.0", "generator": f"mien {__version__}"}
    (mesh,) = shown.content["meshes"]
    assert mesh["extras"]["targetNames"] == NAMES
    assert mesh["weights"] == [0] * len(NAMES)
    head, _ = shown.content["nodes"]
    np.testing.assert_allclose(head["translation"], [0.05, 0.025, -0.9], atol=FLOAT)


def test_every_face_of_a_video_has_names_of_its_own(tmp_path: Path) -> None:
    """Else a program renames those of the second face. The first has no number."""
    for face_id, number in ((0, ""), (1, "1"), (12, "12")):
        content = played(Track.from_estimates([estimate(0)], FACE | {"face_id": face_id}), tmp_path).content
        names = [part["name"] for kind in ("nodes", "meshes", "animations") for part in content[kind]]
        assert names == [f"head{number}", f"camera{number}", f"face{number}", f"track{number}"]


def test_normals_are_of_unit_length_and_point_out_of_the_face(tmp_path: Path) -> None:
    shown = played(Track.from_estimates([estimate(0)], FACE), tmp_path)
    normals = shown.values(shown.primitive["attributes"]["NORMAL"])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    a, b, c = MODEL.mean[SHOWN][shown.triangles].transpose(1, 0, 2)
    assert len(a) == 168
    assert (np.cross(b - a, c - a)[:, 2] >= 0).all()
    assert normals[SHOWN.tolist().index(5), 2] > 0.5  # the tip of the nose


def test_surfaces_lie_side_by_side_without_holes_but_between_the_lips(tmp_path: Path) -> None:
    """An edge has one on either side, or is one of the outline or of the lips; no vertex is in none."""
    shown = played(Track.from_estimates([estimate(0)], FACE), tmp_path)
    np.testing.assert_array_equal(SHOWN[shown.triangles], SURFACES)
    assert len(shown.vertices()[0]) == len(SHOWN) == 96
    edges = [tuple(edge) for corners in shown.triangles for edge in zip(corners, np.roll(corners, -1), strict=True)]
    assert len(set(edges)) == len(edges)
    border = {SHOWN[a] for a, b in edges if (b, a) not in edges}
    lips = {40, 81, 82, 83, 84, 87, 88, 89}
    outline = {0, 10, 11, 12, 14, 28, 29, 30, 32, 44, 45, 47, 61, 62, 63, 65}
    assert border == lips | outline


def test_the_weight_of_a_unit_is_its_column_and_lids_that_brows_move_have_the_product(tmp_path: Path) -> None:
    track = Track.from_estimates(
        [estimate(k, animation=np.arange(6) / 5 - 0.4 * k, closing=Closing(0.5 * k, 0.1)) for k in range(3)], FACE
    )
    weights = played(track, tmp_path).keys("weights")
    assert track.animation is not None
    assert track.eyes_closed is not None
    np.testing.assert_allclose(weights[:, :6], track.animation, atol=1e-6)
    np.testing.assert_allclose(weights[:, 6], track.eyes_closed, atol=1e-6)
    np.testing.assert_allclose(weights[:, 7], track.animation[:, 3] * track.eyes_closed, atol=1e-6)


def test_a_lost_frame_has_no_key_and_the_others_have_the_time_of_the_video(tmp_path: Path) -> None:
    track = Track.from_estimates([lost(0), estimate(1), lost(2), lost(3), estimate(4)], FACE)
    shown = played(track, tmp_path)
    np.testing.assert_allclose(shown.time, [1 / 25, 4 / 25], atol=1e-6)
    assert_is_mesh(shown, track)


def test_the_last_pose_is_held_to_the_end_of_the_track(tmp_path: Path) -> None:
    """So that the animation is as long as the video."""
    shown = played(
        Track.from_estimates([estimate(0), estimate(1, t_mm=(10, 0, 900)), lost(2), lost(3)], FACE), tmp_path
    )
    np.testing.assert_allclose(shown.time, [0, 1 / 25, 3 / 25], atol=1e-6)
    np.testing.assert_allclose(shown.keys("translation")[:, 0], [0.05, 0.01, 0.01], atol=FLOAT)


def test_an_unsure_frame_is_as_a_lost_one_and_the_file_says_when_nothing_is_tracked(tmp_path: Path) -> None:
    confidences = [0.2, 0.5, None, 0.49, 0.9, 0.9, None, 0.9, 0.1]
    estimates = [lost(k) if sure is None else estimate(k, confidence=sure) for k, sure in enumerate(confidences)]
    shown = played(Track.from_estimates(estimates, FACE), tmp_path)
    np.testing.assert_allclose(25 * shown.time, [1, 4, 5, 7, 8], atol=1e-5)
    assert shown.untracked == [[0, 0], [0.08, 0.12], [0.24, 0.24], [0.32, 0.32]]
    assert played(Track.from_estimates([estimate(0)], FACE), tmp_path).untracked == []


def test_a_track_without_a_sure_frame_shows_the_others(tmp_path: Path) -> None:
    """As of a tracker that does not say how sure it is."""
    track = Track.from_estimates([lost(0), estimate(1, confidence=0), estimate(2, confidence=0.4)], FACE)
    with pytest.warns(MienWarning, match=r"head\.glb: the confidence is below one half in all of the track"):
        shown = played(track, tmp_path)
    assert_is_mesh(shown, track)
    assert shown.untracked == [[0, 0.08]]


def test_a_head_that_rolls_round_twice_turns_the_short_way_between_frames(tmp_path: Path) -> None:
    angles = np.radians(np.arange(0, 720, 15))
    turning = [estimate(k, matrix_from_euler(np.array([0.2, 0.1, a])) @ FACING) for k, a in enumerate(angles)]
    q = played(Track.from_estimates(turning, FACE), tmp_path).keys("rotation")
    np.testing.assert_allclose((q[1:] * q[:-1]).sum(axis=1), np.cos(np.radians(7.5)), atol=1e-5)


def test_through_its_camera_the_head_is_seen_where_it_is_in_the_video(tmp_path: Path) -> None:
    track = Track.from_estimates([estimate(0, matrix_from_euler(np.array([0.1, 0.4, -0.2])) @ FACING)], FACE)
    shown = played(track, tmp_path)
    (camera,) = shown.content["cameras"]
    lens, X = camera["perspective"], shown.vertices()[0]
    up = X[:, 1] / -X[:, 2] / np.tan(lens["yfov"] / 2)  # -1 at the lower border of the picture, 1 at the upper one
    right = X[:, 0] / -X[:, 2] / np.tan(lens["yfov"] / 2) / lens["aspectRatio"]
    seen = 0.5 * np.column_stack([1 + right, 1 - up]) * SIZE - 0.5
    mesh = track.mesh(0)
    assert mesh is not None
    np.testing.assert_allclose(seen, CAMERA.project(mesh[SHOWN])[0], atol=1e-3)
    assert shown.content["nodes"][1] == {"name": "camera", "camera": 0}  # where it is, and along -z


def test_a_camera_that_does_not_look_through_the_middle_is_warned_of(tmp_path: Path) -> None:
    """And shifted in Blender, whose unit is the height of the picture: 4 pixels are a sixtieth of it."""
    camera = Camera(300, 159.5 + 4, 119.5 - 2)
    track = Track.from_estimates([estimate(0)], metadata(MODEL.mean, MODEL.animation_units, camera))
    with pytest.warns(MienWarning, match=r"\+4\.0 pixels right and -2\.0 down of the middle"):
        shown = played(track, tmp_path)
    size = dict(zip(("resolution_x", "resolution_y"), SIZE, strict=True))
    assert shown.content["cameras"][0]["extras"] == {"shift_x": -1 / 60, "shift_y": -1 / 120} | size
    centred = played(Track.from_estimates([estimate(0)], FACE), tmp_path)
    assert centred.content["cameras"][0]["extras"] == {"shift_x": 0, "shift_y": 0} | size


def test_the_block_for_blender_finds_what_it_asks_for(tmp_path: Path) -> None:
    """And its lines are commands, as its console takes them one by one."""
    usage = (Path(__file__).parents[2] / "docs" / "usage.md").read_text(encoding="utf-8")
    block = usage.split("## Animation")[1].split("```python\n")[1].split("```")[0]
    content = played(Track.from_estimates([estimate(0)], FACE), tmp_path).content
    assert re.findall(r'objects\["(.*?)"\]', block) == ["camera"] == [content["nodes"][1]["name"]]
    assert set(re.findall(r'lens\["(.*?)"\]', block)) == content["cameras"][0]["extras"].keys()
    waiting: list[str] = []
    for line in block.splitlines():
        waiting.append(line)
        if compile_command("\n".join(waiting)):
            waiting.clear()
    assert not waiting


def test_times_that_32_bit_floats_cannot_hold_are_counted_from_the_first(tmp_path: Path) -> None:
    known = Track.from_estimates([lost(0), estimate(1), estimate(2)], FACE)
    for begin in (1.7e9, -0.5):
        time = known.table["timestamp"].to_numpy() + begin
        column = known.table.column_names.index("timestamp")
        track = Track(known.table.set_column(column, "timestamp", [time]), FACE)
        with pytest.warns(MienWarning, match="counted from there"):
            shown = played(track, tmp_path)
        np.testing.assert_allclose(shown.time, [1 / 25, 2 / 25], atol=1e-6)


def test_frames_whose_times_32_bit_floats_do_not_tell_apart_are_left_out(tmp_path: Path) -> None:
    """As where a clock is set while a program tracks: the keys of an animation must be each later than the last."""
    known = Track.from_estimates([estimate(0), lost(1), *(estimate(k, t_mm=(k, 0, 900)) for k in range(2, 6))], FACE)
    time = np.array([0.0, 0.04, 0.08, 1.7e9, 1.7e9 + 0.04, 1.7e9 + 400])
    track = Track(known.table.set_column(known.table.column_names.index("timestamp"), "timestamp", [time]), FACE)
    with pytest.warns(MienWarning, match=r"head\.glb: 1 of 5 frames are left out, as glTF cannot tell their times"):
        shown = played(track, tmp_path)
    np.testing.assert_allclose(shown.time, time[[0, 2, 3, 5]], rtol=1e-7)
    assert (np.diff(shown.time) > 0).all()
    np.testing.assert_allclose(shown.keys("translation")[:, 0], [0.05, 0.002, 0.003, 0.005], atol=FLOAT)


def test_a_track_without_a_mesh_is_refused(tmp_path: Path) -> None:
    rigid = estimate(0, animation=None)
    for track in (Track.from_estimates([estimate(0)]), Track.from_estimates([rigid], FACE)):
        with pytest.raises(MienError, match=r"head\.glb: the track has no mesh\. .* record the video .* keep the JSON"):
            track.save_gltf(tmp_path / "head.glb")
    with pytest.raises(MienError, match="lost in every frame"):
        Track.from_estimates([lost(0)], FACE).save_gltf(tmp_path / "head.glb")
    whole = Track.from_estimates([estimate(0)], FACE)
    with pytest.raises(MienError, match=r"head\.glb: no row of the track has pose_Rx, .* track the video again"):
        Track(whole.table.drop_columns(["pose_Rx"]), FACE).save_gltf(tmp_path / "head.glb")
    numbers, size = {"focal_px": 500, "cx": 1, "cy": 1}, {"width": 320, "height": 240}
    for damaged in (
        {"camera": {}},
        {"camera": numbers | {"focal_px": 0}},
        {"camera": numbers | {"cx": float("nan")}},
        {"video": "b.mp4"},
        {"video": size | {"width": float("inf")}},
        {"video": size | {"height": 0}},
    ):
        with pytest.raises(MienError, match=r"head\.glb: the `camera` or the `video` of the track is not as mien"):
            Track(whole.table, FACE | damaged).save_gltf(tmp_path / "head.glb")
    with pytest.raises(MienError, match=r"head\.gltf: mien writes \.glb"):
        Track.from_estimates([estimate(0)], FACE).save_gltf(tmp_path / "head.gltf")
    assert list(tmp_path.iterdir()) == []


def test_files_of_mien_are_told_from_others(tmp_path: Path) -> None:
    path = Track.from_estimates([estimate(0)], FACE).save_gltf(tmp_path / "head.glb")
    assert is_gltf_of_mien(path)
    path.write_bytes(path.read_bytes().replace(b"mien", b"else"))
    assert not is_gltf_of_mien(path)
    path.write_text("no glTF")
    assert not is_gltf_of_mien(path)
