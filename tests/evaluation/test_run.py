"""One tracker on one sequence: what is recorded, kept and refused."""

from __future__ import annotations

import json
import re
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from evaluation import tiny
from evaluation.tiny import FRAMES, Known, Still, angles_deg, face68, head_rotations
from mien.errors import MienError, MienWarning
from mien.evaluation import worst
from mien.evaluation.datasets import load_dataset
from mien.evaluation.datasets.sequence import Sequence, Truth
from mien.evaluation.protocols import Protocol
from mien.evaluation.results import SequenceResult, Timing, TrackTable
from mien.evaluation.run import _warn_of_signs, count_frames, run_sequence, time_sequence
from mien.evaluation.scores import Score
from mien.evaluation.worst import frame_errors, worst_frames
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import FACING, matrix_from_euler
from mien.initialization.landmarks import Landmarks
from mien.registry import create_tracker
from mien.tracking.state import Estimate, Status, TrackedLandmarks, Tracker

FIRST = Landmarks(face68(), "ibug68")


@pytest.fixture
def sequence(tmp_path: Path) -> Sequence:
    return load_dataset("rendered", tiny.rendered(tmp_path, angles=angles_deg()))[0]


def _perfect() -> Known:
    return Known(FACING @ head_rotations(angles_deg()))


def _score(tracker: Tracker, sequence: Sequence) -> Score:
    return Score(run_sequence(tracker, sequence, FIRST), Protocol.REBASED, 30.0)


def test_a_result_is_read_as_it_was_written(sequence: Sequence, tmp_path: Path) -> None:
    tracker = _perfect()
    tracker.rotations[3] = np.nan
    result = replace(run_sequence(tracker, sequence, FIRST, "known", "rendered", {"a": 1}), warnings=("poor light",))
    result.save(tmp_path / "deep" / "r.npz")
    again = SequenceResult.load(tmp_path / "deep" / "r.npz")
    assert again.settings == {"a": 1}
    assert again.warnings == ("poor light",)
    assert again.track is not None
    assert again.truth is not None
    assert result.track is not None
    assert again.track.status == ("initialized", "tracked", "tracked", "lost", "tracked", "tracked")
    assert again.track.reasons[3] == "behind a hand"
    assert again.truth.expression_names == ("jawOpen", "browDown_L")
    np.testing.assert_array_equal(again.track.rotation, result.track.rotation)
    np.testing.assert_array_equal(again.track.landmarks, result.track.landmarks)
    assert again.track.landmark_names == result.track.landmark_names
    np.testing.assert_array_equal(again.track.lost, np.arange(FRAMES) == 3)
    assert set(again.pictures) == set(result.pictures)


def test_a_failure_is_read_as_it_was_written(tmp_path: Path) -> None:
    result = SequenceResult("t", "buft", "jam1", "uniform-light", failure="it rained")
    result.save(tmp_path / "r.npz")
    assert SequenceResult.load(tmp_path / "r.npz") == result
    (tmp_path / "r.npz").write_bytes(b"PK no")
    with pytest.raises(MienError, match="not a result"):
        SequenceResult.load(tmp_path / "r.npz")


def test_a_result_from_before_warnings_were_kept_is_read(tmp_path: Path) -> None:
    result, file = SequenceResult("t", "buft", "jam1", "uniform-light", failure="it rained"), tmp_path / "r.npz"
    result.save(file)
    with np.load(file) as values:
        meta = json.loads(str(values["meta"]))
    del meta["warnings"]
    np.savez(file, meta=json.dumps(meta))
    assert SequenceResult.load(file) == result


@pytest.mark.parametrize("damaged", [0, 1, 3])
def test_images_that_cannot_be_read_are_not_passed_over(damaged: int, tmp_path: Path) -> None:
    """Rows of the truth would be those of other frames, or be taken to be counted from 1."""
    for index in range(4):
        cv2.imwrite(str(tmp_path / f"{index}.png"), np.zeros((48, 64, 3), np.uint8))
    assert count_frames(tmp_path) == 4
    (tmp_path / f"{damaged}.png").write_bytes(b"no image")
    with pytest.warns(MienWarning), pytest.raises(MienError, match="has images that cannot be read"):
        count_frames(tmp_path)


def test_the_worst_frames_are_those_with_the_largest_error(sequence: Sequence) -> None:
    tracker = _perfect()
    tracker.rotations[2] = tracker.rotations[2] @ head_rotations(np.array([[9.0, 0, 0]]))[0]
    tracker.rotations[4] = tracker.rotations[4] @ head_rotations(np.array([[5.0, 0, 0]]))[0]
    result = run_sequence(tracker, sequence, FIRST)
    assert result.track is not None
    assert result.truth is not None
    assert worst_frames(result.track, result.truth)[:2] == (2, 4)
    assert len(result.pictures) == FRAMES
    np.testing.assert_allclose(frame_errors(result.track, result.truth)[[2, 4]], [9, 5], atol=1e-6)


def test_the_worst_frames_are_found_where_truth_begins_later_than_the_video(sequence: Sequence) -> None:
    """As of BUFT, and a tracker that has lost the face in the frame before the truth."""
    tracker, truth = _perfect(), sequence.read_truth(FRAMES)
    tracker.rotations[0] = np.nan
    assert truth.rotations is not None
    later = np.where(np.arange(FRAMES)[:, None, None] == 0, np.nan, truth.rotations)
    track = TrackTable.from_estimates([tracker.track(Frame(np.zeros((4, 4, 3), np.uint8), k)) for k in range(FRAMES)])
    errors = frame_errors(track, replace(truth, rotations=later, landmarks=None))
    np.testing.assert_allclose(errors[1:], 0, atol=1e-5)
    assert np.isnan(errors[0])


def test_of_neighbours_the_worst_frame_is_shown(sequence: Sequence, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 400 frames one in ten at most, for twenty pictures, of 40 any; lost truth is no error."""
    errors = np.concatenate([np.arange(20.0), np.arange(20.0)[::-1] / 2])
    errors[25:] = np.nan
    longer = np.pad(errors, (0, 360), constant_values=np.nan)
    result = run_sequence(_perfect(), sequence, FIRST)
    assert result.track is not None
    assert result.truth is not None
    monkeypatch.setattr(worst, "frame_errors", lambda track, truth: longer)
    assert worst_frames(result.track, result.truth) == (19, 9)
    monkeypatch.setattr(worst, "frame_errors", lambda track, truth: errors)
    assert worst_frames(result.track, result.truth)[:3] == (19, 18, 17)


def test_landmark_scores(sequence: Sequence) -> None:
    """Three pixels to the right in every frame: raw 3, without offset 0, normalised by the outer corners."""
    score = _score(tiny.Shifted(), sequence)
    np.testing.assert_allclose(score.frame_rms_px, 3, atol=1e-6)
    np.testing.assert_allclose(score.frame_rms_without_offset_px, 0, atol=1e-6)
    assert score.eye_distance_px == pytest.approx(float(np.linalg.norm(face68()[36] - face68()[45])))
    assert score.expression_moves is False
    np.testing.assert_array_equal(score.false_movement, [*np.zeros(6), np.nan])  # Still tells nothing of eyes


@pytest.mark.parametrize(("opening", "moves"), [(0.04, False), (0.06, True)])
def test_expressions_that_hardly_change_are_none(opening: float, moves: bool, sequence: Sequence) -> None:
    opened = np.linspace(0, opening, FRAMES)[:, None]
    truth = Truth(FRAMES, expression=opened, expression_names=("jawOpen",))
    assert _score(Still(), replace(sequence, read_truth=lambda frames: truth)).expression_moves is moves


def test_expressions_move_also_where_frames_have_no_truth(sequence: Sequence) -> None:
    opened = np.linspace(0, 0.5, FRAMES)[:, None]
    opened[1] = np.nan
    truth = Truth(FRAMES, expression=opened, expression_names=("jawOpen",))
    assert _score(Still(), replace(sequence, read_truth=lambda frames: truth)).expression_moves is True


def test_jitter_is_that_of_tracked_frames(sequence: Sequence) -> None:
    """In a lost frame the last rotation is held, and the head goes on."""
    tracker = _perfect()
    tracker.rotations[3] = np.nan
    score = _score(tracker, sequence)
    assert np.abs(score.error_deg[3]).min() > 1
    assert score.jitter_deg == pytest.approx(0, abs=1e-9)


def test_truth_without_a_known_frame_has_no_figures(sequence: Sequence) -> None:
    unknown = Truth(FRAMES, landmarks=np.full((FRAMES, 68, 2), np.nan))
    assert "for any frame" in _score(Still(), replace(sequence, read_truth=lambda frames: unknown)).failure


def test_truth_without_the_corners_of_the_eyes_is_not_normalised(sequence: Sequence) -> None:
    points = np.tile(face68(), (FRAMES, 1, 1))
    points[:, 36] = np.nan
    partial = replace(sequence, read_truth=lambda frames: Truth(frames, landmarks=points))
    assert np.isnan(_score(Still(), partial).eye_distance_px)


def test_truth_of_another_length_is_refused(sequence: Sequence) -> None:
    longer = replace(sequence, read_truth=lambda frames: tiny.truth(angles_deg(frames + 1)))
    with pytest.raises(MienError, match="describes 7 frames and its video has 6"):
        run_sequence(Still(), longer, FIRST)


def test_a_reader_that_returns_no_truth_is_told(sequence: Sequence) -> None:
    def nothing(frames: int) -> Truth:
        return None  # type: ignore[return-value]

    file = re.escape(str(sequence.truth_files[0]))
    with pytest.raises(MienError, match=f"^{file}: the reader of the truth returned NoneType; it must return a Truth"):
        run_sequence(Still(), replace(sequence, read_truth=nothing), FIRST)


def test_truth_may_be_in_no_file(sequence: Sequence) -> None:
    assert run_sequence(_perfect(), replace(sequence, truth_files=()), FIRST).truth is not None


def test_scores_of_the_pose(sequence: Sequence) -> None:
    score = Score(run_sequence(_perfect(), sequence, FIRST), Protocol.SENSOR, 30.0)
    np.testing.assert_allclose(score.mean_errors, 0, atol=1e-9)
    assert score.jitter_deg == pytest.approx(0, abs=1e-9)
    np.testing.assert_array_equal(score.calibrated, np.arange(FRAMES) > 0)
    np.testing.assert_allclose(_score(Still(), sequence).mean_errors, np.abs(angles_deg()).mean(axis=0), atol=1e-9)


def test_a_tracker_without_a_first_pose_has_no_figures(sequence: Sequence) -> None:
    tracker = _perfect()
    tracker.rotations[0] = np.nan
    assert "no pose in the first frame" in _score(tracker, sequence).failure


class _Landmarks(Still):
    """Gives landmarks and no pose."""

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        return replace(tiny.estimate(frame), rotation=None)

    def track(self, frame: Frame) -> Estimate:
        return replace(tiny.estimate(frame), rotation=None)


def test_a_tracker_of_landmarks_alone_is_measured_by_them(sequence: Sequence) -> None:
    score = _score(_Landmarks(), sequence)
    assert score.failure == ""
    assert score.comparison is None
    np.testing.assert_allclose(score.frame_rms_px, 0, atol=1e-6)


def test_a_tracker_of_poses_alone_has_no_figures_beside_landmarks(sequence: Sequence) -> None:
    points = Truth(FRAMES, landmarks=np.tile(face68(), (FRAMES, 1, 1)))
    result = run_sequence(_perfect(), replace(sequence, read_truth=lambda frames: points), FIRST)
    track = result.track
    assert track is not None
    bare = replace(result, track=replace(track, landmarks=np.empty((FRAMES, 0, 2)), landmark_names=()))
    assert Score(result, Protocol.REBASED, 30.0).failure == ""
    assert "neither a pose nor the twelve landmarks" in Score(bare, Protocol.REBASED, 30.0).failure


class _Reorders(Still):
    """Gives its landmarks in another order after the first frame."""

    def track(self, frame: Frame) -> Estimate:
        known = tiny.estimate(frame)
        assert known.landmarks is not None
        names, image = known.landmarks.names, known.landmarks.image
        return replace(known, landmarks=TrackedLandmarks(names[::-1], image[::-1]))


def test_a_tracker_gives_the_same_landmarks_in_every_frame(sequence: Sequence) -> None:
    with pytest.raises(MienError, match=r"frame 1 has 12 landmarks, .* the same in every frame"):
        run_sequence(_Reorders(), sequence, FIRST)


class _Breaks(Still):
    """Gives what is no estimate of a frame."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
        return self.answer  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, "returned NoneType"),
        (Estimate(0, 0.0, Status.TRACKED, rotation=2 * np.eye(3)), "not a rotation matrix"),
        (Estimate(0, 0.0, Status.LOST, rotation=np.eye(3)), "belongs to a lost frame"),
    ],
)
def test_a_tracker_that_breaks_the_protocol_is_not_measured(sequence: Sequence, answer: object, message: str) -> None:
    with pytest.raises(MienError, match=message):
        run_sequence(_Breaks(answer), sequence, FIRST)


def test_an_annotation_of_larger_images_is_refused(sequence: Sequence) -> None:
    truth = sequence.read_truth(FRAMES)
    assert truth.landmarks is not None
    largest = truth.landmarks.max(axis=(0, 1)) / [64, 48]
    for share in ([1.4, 1.4], [1.6, 1.4], [1.4, 1.6]):
        points = truth.landmarks * share / largest
        large = replace(sequence, read_truth=lambda frames, points=points: replace(truth, landmarks=points))
        fits = max(share) < 1.5
        with nullcontext() if fits else pytest.raises(MienError, match="images of another size"):
            run_sequence(Still(), large, FIRST)


@pytest.mark.parametrize(("signs", "named"), [((1, 1, 1), []), ((1, -1, 1), ["yaw"]), ((-1, 1, -1), ["pitch", "roll"])])
def test_truth_that_runs_against_the_tracker_is_told(
    sequence: Sequence, signs: tuple[int, int, int], named: list[str], recwarn: pytest.WarningsRecorder
) -> None:
    true = np.radians(np.random.default_rng(0).normal(0, 8, (FRAMES, 3)))
    turned = np.stack([matrix_from_euler(angles) for angles in true])
    status = (Status.TRACKED.value,) * FRAMES
    nothing = np.full((FRAMES, 1), np.nan)
    track = TrackTable(np.arange(FRAMES), status, FACING @ turned, nothing, nothing, nothing, nothing)
    told = np.stack([matrix_from_euler(angles) for angles in true * signs])
    _warn_of_signs(track, replace(sequence.read_truth(FRAMES), rotations=FACING @ told), sequence)
    assert [str(w.message).split(": ")[1].split()[0] for w in recwarn] == named


@pytest.mark.parametrize("unit", ["radians", "degrees"])
@pytest.mark.parametrize("signs", [(1, -1, -1), (1, 1, -1)])
def test_truth_in_degrees_is_told(
    unit: str, signs: tuple[int, int, int], tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    """Also of a head that turns so little that degrees could be radians, and with another sign."""
    turns = 0.4 * angles_deg()  # up to 6 degrees
    tiny.video(tmp_path / "own.avi")
    written = turns * signs if unit == "degrees" else np.radians(turns) * signs
    rows = [",".join(map(str, (k, *row))) for k, row in enumerate(written)]
    (tmp_path / "own.csv").write_text("\n".join(["frame,pose_Rx,pose_Ry,pose_Rz", *rows]))
    (own,) = load_dataset("video", tmp_path)
    leaning = head_rotations(np.array([[0.5, 4.0, -3.0]]))[0]
    run_sequence(Known(FACING @ head_rotations(1.1 * turns) @ leaning), own, FIRST)
    told = [str(warning.message) for warning in recwarn]
    assert all(text.startswith(f"{tmp_path / 'own.csv'}: its angles vary 5") for text in told)
    assert ["not in degrees" in text for text in told] == [True] * (unit == "degrees")


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (range(FRAMES), []),
        (range(FRAMES + 3), [f"9 rows and VIDEO has {FRAMES} frames, of which {FRAMES} have a row"]),
        (range(4), [f"4 rows and VIDEO has {FRAMES} frames, of which 4 have a row"]),
        (range(2, FRAMES + 2), [f"6 rows and VIDEO has {FRAMES} frames, of which 4 have a row"]),
    ],
)
def test_a_track_from_a_file_with_other_rows_than_there_are_frames_is_told(
    rows: range, told: list[str], sequence: Sequence, tmp_path: Path, recwarn: pytest.WarningsRecorder
) -> None:
    lines = "".join(f"{k},{k / 25},1,tracked,0,0,0\n" for k in rows)
    (tmp_path / "own.csv").write_text(f"frame,timestamp,success,status,pose_Rx,pose_Ry,pose_Rz\n{lines}")
    run_sequence(create_tracker(f"openface:{tmp_path / 'own.csv'}"), sequence, FIRST)
    texts = [str(w.message).replace(str(sequence.video), "VIDEO").partition(";")[0] for w in recwarn]
    assert texts == [f"{tmp_path / 'own.csv'} has {text}" for text in told]


def test_timing(sequence: Sequence, tmp_path: Path) -> None:
    made: list[Still] = []

    def make() -> Still:
        made.append(Still())
        return made[-1]

    timing = time_sequence(make, sequence, FIRST, "still")
    assert len(made) == 2  # one for the warm-up
    assert len(timing.frame_seconds) == FRAMES - 1
    assert timing.peak_mb > 10
    timing.save(tmp_path / "t.json")
    assert Timing.load(tmp_path / "t.json") == timing
    fast = replace(timing, frame_seconds=(0.1, 0.3))
    assert fast.frames_per_second == pytest.approx(5)


def test_the_cores_that_are_busy_are_those_of_all_threads(sequence: Sequence, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the frames after the first: here 1.5 seconds of the processors in each second."""
    clock = {"elapsed": 0.0, "processor": 0.0}

    class Works(Still):
        def initialize(self, frame: Frame, landmarks: Landmarks, camera: Camera) -> Estimate:
            clock["elapsed"] += 4
            clock["processor"] += 4
            return super().initialize(frame, landmarks, camera)

        def track(self, frame: Frame) -> Estimate:
            clock["elapsed"] += 2
            clock["processor"] += 3
            return super().track(frame)

    clocks = {"perf_counter": lambda: clock["elapsed"], "process_time": lambda: clock["processor"]}
    monkeypatch.setattr("mien.evaluation.run.time", SimpleNamespace(**clocks))
    timing = time_sequence(Works, sequence, FIRST)
    assert (timing.training_seconds, timing.frame_seconds) == (4, (2,) * (FRAMES - 1))
    assert timing.busy_cores == 1.5
