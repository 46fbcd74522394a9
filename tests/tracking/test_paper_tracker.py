"""The tracker of the paper on a rendered face with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from long_motion import gentle_sequence, leaving
from mien.config import DescriptorSettings, PaperSettings
from mien.geometry.rotation import angle_between
from mien.initialization.landmarks import LANDMARK_NAMES
from mien.synthetic import SyntheticSequence
from mien.tracking import paper
from mien.tracking.paper import PaperTracker, learn_views
from mien.tracking.state import Estimate, Status
from small_motion import errors_deg, errors_of_all_deg, face, run, small_motion

QUICK = PaperSettings(view_step_deg=30, simplex_evaluations=100)


@pytest.fixture(scope="module")
def gentle() -> list[Estimate]:
    return run(PaperTracker(), gentle_sequence())


def _first(sequence: SyntheticSequence, count: int) -> SyntheticSequence:
    return replace(sequence, frames=sequence.frames[:count])


def test_the_face_is_followed(gentle: list[Estimate]) -> None:
    errors = errors_deg(gentle, gentle_sequence())
    assert errors.mean() < 5
    assert errors.max() < 12
    assert [e.status for e in gentle] == [Status.INITIALIZED] + [Status.TRACKED] * (len(gentle) - 1)


def test_so_are_its_landmarks(gentle: list[Estimate]) -> None:
    for estimate, truth in zip(gentle, gentle_sequence().landmarks, strict=True):
        assert estimate.landmarks is not None
        assert estimate.landmarks.names == LANDMARK_NAMES
        assert np.linalg.norm(estimate.landmarks.image - truth, axis=1).mean() < 5


def test_one_row_a_frame(gentle: list[Estimate]) -> None:
    frames = gentle_sequence().frames
    assert [(e.index, e.time) for e in gentle] == [(f.index, f.time) for f in frames]


def test_the_mesh_carries_the_landmarks(gentle: list[Estimate]) -> None:
    tracker = PaperTracker(QUICK)
    estimate = tracker.initialize(face().frame, face().landmarks, face().camera)
    mesh = tracker.mesh(estimate)
    assert mesh is not None
    assert estimate.landmarks is not None
    nearest = np.linalg.norm(mesh[:, None] - estimate.landmarks.camera, axis=2).min(axis=0)
    np.testing.assert_allclose(nearest, 0, atol=1e-9)
    assert tracker.mesh(Estimate.lost(face().frame, "gone")) is None


def test_the_same_seed_gives_the_same_numbers() -> None:
    sequence = _first(gentle_sequence(), 5)
    first, again, other = (
        run(PaperTracker(QUICK.model_copy(update={"seed": seed})), sequence)[-1].rotation for seed in (0, 0, 1)
    )
    assert first is not None
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("kernel", ["mien", "opencv"])
@pytest.mark.parametrize("innovation", ["sum", "mean"])
def test_every_variant_follows_a_small_motion(kernel: str, innovation: str) -> None:
    settings = PaperSettings.model_validate(
        {"descriptor": DescriptorSettings().model_dump() | {"kernel": kernel}, "innovation": innovation}
        | {"view_step_deg": 30, "simplex_evaluations": 500}
    )
    sequence = small_motion()
    assert errors_of_all_deg(run(PaperTracker(settings), sequence), sequence)[-1] < 8


def test_the_database_has_a_descriptor_of_every_landmark_in_every_view() -> None:
    samples = learn_views(face().frame, face().fit, face().camera, PaperSettings())
    assert samples.shape == (343, 26, 128)
    np.testing.assert_allclose(np.linalg.norm(samples, axis=2), 1, atol=1e-3)


@pytest.mark.parametrize(("across", "down"), [(3.0, 0.0), (0.0, -2.5)])
def test_a_face_that_leaves_the_image_is_no_exception(across: float, down: float) -> None:
    truth = leaving(across, down)
    estimates = run(PaperTracker(QUICK), truth)
    assert len(estimates) == len(truth.frames)
    for estimate in estimates:
        assert estimate.rotation is None or np.isfinite(estimate.rotation).all()
        assert (estimate.status is Status.LOST) == (estimate.landmarks is None)


def test_what_was_observed_is_learned_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In the frame after it, and not in every frame in which the face is lost."""
    tracker = PaperTracker(QUICK)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    monkeypatch.setattr(paper, "in_view", lambda X, camera, frame: False)
    means = []
    for _ in range(3):
        assert tracker.track(face().frame).status is Status.LOST
        means.append(tracker.gaussians.mu)
    np.testing.assert_array_equal(means[1], means[0])
    np.testing.assert_array_equal(means[2], means[0])


@pytest.mark.parametrize("across", [4.0, -4.0])
def test_a_face_outside_the_image_is_lost_and_looked_for_where_it_was_first(across: float) -> None:
    tracker = PaperTracker(QUICK)
    tracker.initialize(face().frame, face().landmarks, face().camera)
    tracker.b = tracker.b + np.eye(12)[3] * across
    lost = tracker.track(face().frame)
    assert lost.status is Status.LOST
    assert lost.reason == "the face left the image"
    assert lost.rotation is None
    assert lost.landmarks is None
    again = tracker.track(face().frame)
    assert again.status is Status.RECOVERED
    assert again.rotation is not None
    assert np.degrees(angle_between(again.rotation, face().fit.R)) < 8


def test_black_frames_are_no_exception() -> None:
    estimates = run(PaperTracker(QUICK), small_motion(blank={1, 2, 3}))
    assert [e.status for e in estimates] == [Status.INITIALIZED] + [Status.TRACKED] * 3  # it has no test of loss
    assert all(e.rotation is not None and np.isfinite(e.rotation).all() for e in estimates)
