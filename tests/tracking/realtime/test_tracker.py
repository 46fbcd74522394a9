"""The tracker for use on a rendered face with known truth."""

from __future__ import annotations

import json
import math
import pickle
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import mien
from long_motion import gentle_sequence, in_order, sequence, shown, with_spectacles
from mien.appearance.regression import PoseRegression
from mien.arrays import Array
from mien.baselines.la_cascia import LaCasciaTracker
from mien.baselines.lefevre import LefevreTracker
from mien.baselines.morency import MorencyTracker
from mien.baselines.xiao import XiaoTracker
from mien.candide.model import TRACKED_UNITS
from mien.config import RealtimeSettings
from mien.config.realtime import RestSettings, ShapeSettings, ViewSettings, WeightSettings
from mien.errors import MienError
from mien.frame import Decoded, Frame
from mien.geometry.camera import Camera
from mien.geometry.rotation import angle_between
from mien.initialization.landmarks import LANDMARK_NAMES, LANDMARK_VERTICES, Landmarks, rows_reported
from mien.synthetic import SyntheticSequence, make_sequence, moved
from mien.tracking.abilities import FittedTracker, RepeatableTracker
from mien.tracking.paper import PaperTracker
from mien.tracking.realtime import RealtimeTracker, learning, person
from mien.tracking.realtime.misplacement import squared_misplacement
from mien.tracking.realtime.solution import Solution
from mien.tracking.state import Estimate, Status, Tracker
from mien.video import open_video
from small_motion import begun, errors_deg, face, run, small_motion
from videos import bent, portrait_images, turn_by_metadata, write_video

TRACKERS = (RealtimeTracker, PaperTracker, LefevreTracker, LaCasciaTracker, XiaoTracker, MorencyTracker)


@pytest.fixture(scope="module")
def estimates() -> list[Estimate]:
    return run(RealtimeTracker(), sequence())


def _covariance(estimate: Estimate) -> Array:
    assert estimate.covariance is not None
    return estimate.covariance


def test_the_face_is_followed(estimates: list[Estimate]) -> None:
    errors = errors_deg(estimates, sequence())
    assert errors.mean() < 2
    assert errors.max() < 4
    assert [e.status for e in estimates] == [Status.INITIALIZED] + [Status.TRACKED] * (len(estimates) - 1)
    assert [(e.index, e.time) for e in estimates] == [(f.index, f.time) for f in sequence().frames]


@pytest.mark.parametrize("new", TRACKERS)
def test_frames_that_the_camera_cannot_have_taken_are_refused(new: Callable[[], Tracker]) -> None:
    """They would be tracked, at angles that are wrong by tens of degrees; and so is what is no frame at all."""
    tracker: Any = new()
    first = small_motion().frames[0]
    with pytest.raises(MienError, match="call initialize first"):
        tracker.track(first)
    given = {"frame": first, "landmarks": face().landmarks, "camera": face().camera}
    for name, wrong in (("frame", first.pixels), ("landmarks", "face.json"), ("camera", None)):
        with pytest.raises(MienError, match=f"is no mien.{name.capitalize()}; initialize takes a frame, its landmarks"):
            tracker.initialize(**given | {name: wrong})
    tracker.initialize(**given)
    for nothing in (None, first.pixels):
        with pytest.raises(MienError, match=r"is no frame; give each as mien\.Frame\(pixels, index, time\)"):
            tracker.track(nothing)
    with pytest.raises(MienError, match=r"has the size \(320, 120\), the first had \(320, 240\)"):
        tracker.track(Frame(np.ascontiguousarray(first.pixels[:120]), 7))


@pytest.mark.parametrize("new", TRACKERS)
def test_a_tracker_that_could_not_learn_its_face_knows_none(new: Callable[[], Tracker]) -> None:
    """It would go on with the camera of one face and the look of another."""
    first, second, *_ = small_motion().frames
    impossible = replace(face().camera, cx=900.0, cy=-400.0)
    for starts in ([], [face().camera]):
        tracker = new()
        for camera in starts:
            tracker.initialize(first, face().landmarks, camera)
        with pytest.raises(MienError, match="no face fits the landmarks"):
            tracker.initialize(first, face().landmarks, impossible)
        with pytest.raises(MienError, match="call initialize first"):
            tracker.track(second)
        if isinstance(tracker, RepeatableTracker):
            with pytest.raises(MienError, match="call initialize first"):
                tracker.again()
        if isinstance(tracker, FittedTracker):
            with pytest.raises(MienError, match="call initialize first"):
                tracker.mesh(Estimate.lost(second, "nothing is known", 1.0))


def test_spectacles_are_followed() -> None:
    """Rims move more than the eyes behind them; with a shape that cannot learn this the largest error is 4 degrees."""
    errors = errors_deg(run(RealtimeTracker(), with_spectacles()), with_spectacles())
    assert errors.mean() < 1.5
    assert errors.max() < 3.2


def test_landmarks_are_those_of_the_first_frame_and_move_with_the_face() -> None:
    """Also where the fitted model does not reach them; those that an annotation lacks are the model's."""
    sequence = small_motion()
    rows = rows_reported(face().landmarks.scheme)
    known = [LANDMARK_NAMES.index(name) for name in rows]
    points = face().landmarks.points[list(rows.values())].mean(axis=1)
    assert len(known) > 20
    first, *_, last = run(RealtimeTracker(), sequence)
    assert first.landmarks is not None
    assert last.landmarks is not None
    np.testing.assert_allclose(first.landmarks.image[known], points, atol=0.1)  # lids that have moved since
    beside = points - sequence.landmarks[0, known]  # of the drawn head's own vertices
    assert np.linalg.norm(beside, axis=1).max() > 1
    off = last.landmarks.image[known] - sequence.landmarks[-1, known]
    assert np.linalg.norm(off - beside, axis=1).mean() < 0.7  # 0.9 with those of the model


def test_each_level_is_learned_from_as_many_views_as_are_set() -> None:
    face = begun(sequence().frames[0], RealtimeSettings(views=ViewSettings(per_angle=8, coarse_per_angle=5))).face
    for level, count in ((face.fine, 8), (face.coarse, 5)):
        assert [len(angles) for angles in level.views] == [count, count]
        assert len(level.appearance.lack_of_fit) == count**2


def test_light_is_in_the_covariance_and_not_in_the_mean() -> None:
    def learned(light_contrast: float) -> PoseRegression:
        tracker = begun(sequence().frames[0], RealtimeSettings(views=ViewSettings(light_contrast=light_contrast)))
        return tracker.face.fine.appearance

    dark, lit = learned(0.0), learned(0.6)
    np.testing.assert_array_equal(dark.coefficients, lit.coefficients)
    variance = [1 / (1e3 + a.gain) for a in (dark, lit)]  # I / floor + U^T diag(gain) U, the floor being 1e-3
    assert (variance[1] > variance[0]).mean() > 0.9


def test_what_the_nose_hides_is_hidden() -> None:
    """Of a face that turns away the inner corner of the further eye, and nothing from the front."""
    tracker = begun(sequence().frames[0])
    depth, right, left = (
        tracker.settings.visibility.hidden_depth,
        *(LANDMARK_NAMES.index(f"{side}_eye_inner_corner") for side in ("right", "left")),
    )
    level, n = tracker.face.fine, len(LANDMARK_NAMES)
    assert not (level.depth_behind(np.zeros(2)) > depth)[:n].any()
    away = np.radians(60.0)
    hidden = [level.depth_behind(np.array([0.0, pan])) > depth for pan in (-away, away)]
    assert sorted((bool(h[right]), bool(h[left])) for h in hidden) == [(False, True), (True, False)]


def test_what_the_mean_leaves_is_that_of_the_views_around() -> None:
    tracker = begun(sequence().frames[0])
    level = tracker.face.fine
    tilts, pans = level.views
    views = level.appearance.lack_of_fit.reshape(len(tilts), len(pans), -1)
    middle = np.array([tilts[3:5].mean(), pans[5:7].mean()])
    expected = (
        (np.array([tilts[3], pans[5]]), views[3, 5]),
        (middle, views[3:5, 5:7].mean(axis=(0, 1))),
        (np.radians([-90.0, 90.0]), views[0, -1]),
    )
    for angles, left in expected:
        np.testing.assert_allclose(level.trust(angles, 30.0), 1 / (1 + left / 30), rtol=1e-5)


def test_views_from_aside_are_learned_when_the_face_turns_there() -> None:
    tracker = begun(sequence().frames[0])
    front, limit = tracker.face.fine, np.radians(tracker.settings.views.turned_limit_pan_deg)
    for frame in sequence().frames[1:5]:
        tracker.track(frame)
    assert front.at(np.radians([30.0, -49.0])) is front
    assert "_turned" not in vars(front)
    turned = front.at(np.radians([0.0, 51.0]))
    assert turned is front.at(np.radians([0.0, -60.0]))
    np.testing.assert_allclose(turned.appearance.limit[1], limit)
    assert set(front.views[1]) < set(turned.views[1])
    assert turned.views[1].max() == pytest.approx(limit)
    assert turned.behind.shape[:2] == (len(turned.views[0]), len(turned.views[1]))


def test_views_from_aside_are_learned_by_one_thread() -> None:
    """Or what is tracked would depend on the number of processors."""
    front, regress, threads = begun(sequence().frames[0]).face.fine, learning._regress, list[int]()

    def noted(*given: Any) -> Any:
        threads.extend(library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas")
        return regress(*given)

    with threadpool_limits(2, user_api="blas"), patch.object(learning, "_regress", noted):
        front.at(np.radians([0.0, 51.0]))
    assert set(threads) == {1}


def test_a_view_of_which_the_mean_leaves_much_says_less() -> None:
    tracker = begun(sequence().frames[0])
    lack_of_fit, frame = tracker.face.fine.appearance.lack_of_fit, sequence().frames[1]
    lack_of_fit[:] = 0
    _, sure = tracker._search(frame)
    lack_of_fit[:] = 3 * tracker.settings.covariance.lack_of_fit
    _, doubtful = tracker._search(frame)
    assert np.median(doubtful.d2 / sure.d2) == pytest.approx(1 / 4, rel=0.05)


def test_a_face_is_learned_alike_wherever_the_frame_has_it() -> None:
    first, landmarks, camera = sequence().frames[0], face().landmarks, face().camera
    left, top = 300, 170
    pixels = np.full((first.height + 2 * top, first.width + left, 3), round(float(first.gray.mean())), np.uint8)
    pixels[top : top + first.height, left:] = first.pixels

    def learned(frame: Frame, landmarks: Landmarks, camera: Camera) -> PoseRegression:
        tracker = RealtimeTracker()
        tracker.initialize(frame, landmarks, camera)
        return tracker.face.fine.appearance

    small = learned(first, landmarks, camera)
    large = learned(
        Frame(pixels, first.index, first.time),
        replace(landmarks, points=landmarks.points + np.array([left, top])),
        replace(camera, cx=camera.cx + left, cy=camera.cy + top),
    )
    np.testing.assert_allclose(large.coefficients, small.coefficients, atol=0.01)


def test_a_landmark_that_is_found_elsewhere_says_less() -> None:
    frames = sequence().frames[:8]
    tracker = begun(frames[0], RealtimeSettings(shape=ShapeSettings(learn=False)))
    misplaced = LANDMARK_NAMES.index("nose_base_mid")
    tracker.person.neutral[misplaced, 0] += 0.02
    for frame in frames[1:]:
        tracker.track(frame)
    variance = tracker.person.variance[:, 0]
    assert variance[misplaced] > 3 * np.median(variance)
    assert variance.min() >= 0.9 * tracker.settings.misplacement.least_sd**2


def test_a_second_pass_knows_the_relief() -> None:
    """The first frame's relief is taken to be flatter than it is, and a second pass begins with what the turns of the
    first have corrected."""
    depths = face().landmarks.depths
    assert depths is not None
    flat = replace(face().landmarks, depths=0.7 * depths)

    def mean_error(tracker: RealtimeTracker) -> float:
        first, *others = sequence().frames
        estimates = [tracker.initialize(first, flat, face().camera), *(tracker.track(f) for f in others)]
        return float(errors_deg(estimates, sequence()).mean())

    tracker = RealtimeTracker()
    before = mean_error(tracker)
    learned = tracker.person.shape.mean.copy()
    again = tracker.again()
    assert mean_error(again) < 0.75 * before
    assert again.person.face is tracker.person.face  # of the same first frame
    np.testing.assert_array_equal(tracker.person.shape.mean, learned)  # the second learns on its own


def test_lips_that_are_nearer_than_was_thought_soon_move_with_no_nod() -> None:
    """The first frame's depths put the mouth a quarter of its width too far back, so that a nod seems to raise the
    lip, until the shape has explained what every nod does."""
    landmarks, angles_deg, still = face().landmarks, np.zeros((121, 3)), np.zeros((121, 6))
    reported, depths = landmarks.reported(), landmarks.depths
    assert depths is not None
    right, left, middle = (
        np.array(reported[name]) for name in ("right_mouth_corner_outer", "left_mouth_corner_outer", "lower_lip_outer")
    )
    width = float(np.linalg.norm(left - right))
    across, down = ((landmarks.points - middle) / width).T
    behind = np.exp(-0.5 * ((across / 0.45) ** 2 + (down / 0.3) ** 2))
    angles_deg[1:, 0] = 15 * np.sin(2 * np.pi * np.arange(120) / 40)  # three nods
    nods = make_sequence(face(), moved(face(), angles_deg, still[:, :3], still), noise_sd=2)
    tracker = RealtimeTracker()
    first = tracker.initialize(nods.frames[0], replace(landmarks, depths=depths + width / 4 * behind), face().camera)
    lip = TRACKED_UNITS.index("upper_lip_raiser")
    moved_by = [tracker.track(frame).animation[lip] - first.animation[lip] for frame in nods.frames[1:]]
    raised = np.abs(np.reshape(moved_by, (3, 40))).max(axis=1)
    assert raised[0] > 0.2
    assert raised[2] < 0.5 * raised[0]


def test_what_an_expression_moves_says_less() -> None:
    tracker = begun(sequence().frames[0])
    level = tracker.face.fine
    rest = tracker.person.misplacement_variance(level, tracker.pose.animation)
    raised = tracker.pose.animation.copy()
    raised[TRACKED_UNITS.index("outer_brow_raiser")] += 1
    tracker.pose = replace(tracker.pose, animation=raised)
    more = (tracker.person.misplacement_variance(level, tracker.pose.animation) - rest)[:, 0]
    brow, nose = LANDMARK_NAMES.index("left_brow_outer"), LANDMARK_NAMES.index("nose_tip")
    pixels = (
        tracker.settings.misplacement.unit_error * 0.176 * level.descriptor.pixels_per_unit
    )  # CANDIDE: (0.022, 0.174, -0.022)
    assert np.sqrt(more[brow]) == pytest.approx(pixels, rel=0.1)
    assert more[nose] == pytest.approx(0, abs=0.05 * more[brow])


def test_the_rest_is_firm_while_the_face_hardly_moves() -> None:
    """So many times as firm at rest, half of that at `rest.within`, and next to nothing of it further away."""
    rest = RestSettings(animation=0.5, mouth=1.0, firmness=20.0, mouth_firmness=50.0, jaw_firmness=40.0, within=0.1)
    tracker = begun(sequence().frames[0], RealtimeSettings(rest=rest))
    moved_by = np.array([0.0, 0.0, 0.1, -0.1, 1.0, 0.3])
    tracker.pose = replace(tracker.pose, animation=tracker.fit.animation + moved_by)
    prior = tracker.prior.arrays(tracker.prior.prediction(tracker.pose, tracker.pose))
    np.testing.assert_array_equal(prior.rest, tracker.fit.animation)
    loose = np.array([1.0, 1.0, 1.0, 4.0, 1.0, 4.0])  # the second is jaw_drop, fourth and sixth are of the brows
    np.testing.assert_allclose(prior.rest_information, loose * [51, 41, 26, 11, 1 + 50 / 101, 3], rtol=1e-6)


def test_a_mouth_that_looks_strange_still_says_how_it_moves() -> None:
    """As long as nothing is before it: a landmark elsewhere that looks as strange says nothing, and neither says whose
    face it is."""
    frame = sequence().frames[0]
    tracker = begun(frame)
    view, found = tracker._search(frame)
    strange = replace(
        found,
        at=found.at._replace(d2=np.full_like(found.d2, 120.0), w=np.full_like(found.w, 0.01)),
        facing=np.full(len(found.w), True),
    )
    tracker._remember(frame, view, strange)
    mouth = tracker.person.mouth
    assert (tracker.motion.weight[mouth] > 0.9).all()
    assert (tracker.motion.weight[~mouth] < 0.1).all()
    *_, says_whose_face_it_is = tracker.identity.patches.frames[-1]
    assert (says_whose_face_it_is < 0.1).all()
    tracker._remember(frame, view, replace(strange, at=strange.at._replace(d2=np.full_like(found.d2, 1000.0))))
    assert (tracker.motion.weight < 0.1).all()


def test_a_mouth_that_was_lost_is_found_at_rest() -> None:
    """Where something took it along and has gone: too far from its place for the solver, as if by a hand."""
    frame = sequence().frames[0]
    tracker = begun(frame)
    rest = tracker.pose.animation
    taken = rest.copy()
    taken[TRACKED_UNITS.index("upper_lip_raiser")] += 1.4
    tracker.pose = replace(tracker.pose, animation=taken)
    tracker._remember(frame, *tracker.solver.refine(frame, tracker.prior.prediction(tracker.pose, tracker.pose)))
    tracker.track(frame)
    np.testing.assert_allclose(tracker.pose.animation, rest, atol=0.1)


def test_patches_are_small_at_the_corners_of_the_mouth() -> None:
    tracker = begun(sequence().frames[0])
    across = np.ptp(tracker.face.patches[:, :, 0], axis=1)
    corners = np.array(["mouth_corner" in name for name in person.TRACKED])
    assert across[corners] == pytest.approx(2 * tracker.settings.motion.corner, rel=0.25)
    assert across[~corners].min() > 2 * across[corners].max()


def test_what_noise_adds_to_distances_is_known() -> None:
    """So that a face in noise does not look like somebody else's."""
    at_rest = moved(face(), np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((8, 6)))
    clean, noisy = (make_sequence(face(), at_rest, noise_sd=sd) for sd in (0, 80))

    def distances(sequence: SyntheticSequence, least: float) -> tuple[Array, Array]:
        found = list[Solution]()
        with patch.object(learning, "_LEAST_NOISE", least):
            tracker = begun(sequence.frames[0])
        for frame in sequence.frames[1:]:
            found.append(tracker.solver.refine(frame, tracker.prior.prediction(tracker.pose, tracker.pose))[1])
        return np.mean([s.d2 for s in found], axis=0), np.mean([s.d2_without_noise for s in found], axis=0)

    usual, _ = distances(clean, 1.0)
    seen, removed = distances(noisy, 1.0)
    assert np.median(seen) > np.median(usual) + 30
    assert np.median(removed) < np.median(usual) + 10
    _, ignored = distances(noisy, math.inf)
    assert np.median(ignored) > np.median(usual) + 30


def test_a_face_that_holds_still_is_not_trusted_less_and_less() -> None:
    """The same frame, over and over, fits ever better; the scale of the robust weights stays above its floor."""
    frame = sequence().frames[0]
    tracker = begun(frame, RealtimeSettings(weights=WeightSettings(expectation_rate=0.3)))
    for _ in range(20):
        tracker.track(frame)
    assert tracker.person.expected.min() == tracker.settings.weights.least_distance


def test_misplacement_solves_each_landmark_alone() -> None:
    tracker = begun(sequence().frames[0])
    _, solution = tracker.solver.refine(sequence().frames[1], tracker.prior.prediction(tracker.pose, tracker.pose))
    seen = solution.facing
    expected = -np.linalg.solve(solution.at.M[seen, :2, :2], solution.at.g[seen, :2, None])[:, :, 0]
    assert 0 < (np.abs(expected) > 0.1).mean() < 0.9
    for most in (0.1, 100.0):
        squared = np.square(np.clip(expected, -most, most)).mean(axis=1)
        landmarks = zip(solution.at.M[seen], solution.at.g[seen], strict=True)
        found = [squared_misplacement(M, g, most) for M, g in landmarks]
        np.testing.assert_allclose(found, squared, rtol=1e-3)


def test_it_is_better_than_the_paper() -> None:
    truth = gentle_sequence()
    ours, papers = (errors_deg(run(tracker, truth), truth).mean() for tracker in (RealtimeTracker(), PaperTracker()))
    assert ours < 0.6 * papers


def test_place_and_landmarks_are_followed(estimates: list[Estimate]) -> None:
    for estimate, t, truth in zip(estimates, sequence().t, sequence().landmarks, strict=True):
        assert estimate.translation is not None
        assert estimate.landmarks is not None
        np.testing.assert_allclose(estimate.translation, t, atol=0.08)
        assert estimate.landmarks.names == LANDMARK_NAMES
        assert np.linalg.norm(estimate.landmarks.image - truth, axis=1).mean() < 2.5


def test_the_jaw_is_followed(estimates: list[Estimate]) -> None:
    jaw = TRACKED_UNITS.index("jaw_drop")
    found = [e.animation[jaw] for e in estimates if e.animation is not None]
    assert np.corrcoef(found, sequence().animation[:, jaw])[0, 1] > 0.95


def test_an_estimate_stays_what_it_was_while_tracking_goes_on() -> None:
    tracker = RealtimeTracker()
    first, *later = sequence().frames[:4]
    estimates = [tracker.initialize(first, face().landmarks, face().camera), *map(tracker.track, later[:1])]
    known = [(name, array) for e in estimates for part in (e, e.landmarks) for name, array in vars(part).items()]
    known = [(name, array, array.copy()) for name, array in known if isinstance(array, np.ndarray)]
    assert {"rotation", "translation", "animation", "covariance", "image"} <= {name for name, _, _ in known}
    for frame in later[1:]:
        tracker.track(frame)
    for name, array, before in known:
        np.testing.assert_array_equal(array, before, err_msg=name)


def test_visibility_and_confidence_are_in_their_range(estimates: list[Estimate]) -> None:
    for estimate in estimates:
        assert estimate.landmarks is not None
        assert estimate.landmarks.visibility is not None
        assert estimate.landmarks.distance is not None
        assert ((estimate.landmarks.visibility >= 0) & (estimate.landmarks.visibility <= 1)).all()
        unseen = estimate.landmarks.visibility == 0
        np.testing.assert_array_equal(np.isnan(estimate.landmarks.distance), unseen)
        assert 0 <= estimate.confidence <= 1


def test_most_landmarks_of_a_frontal_face_are_seen(estimates: list[Estimate]) -> None:
    visibility = [e.landmarks.visibility for e in estimates if e.landmarks is not None]
    assert np.mean(next(v for v in visibility if v is not None)) > 0.8


def test_the_covariance_is_one(estimates: list[Estimate]) -> None:
    for estimate in estimates:
        covariance = _covariance(estimate)
        assert covariance.shape == (12, 12)
        np.testing.assert_allclose(covariance, covariance.T, atol=1e-6 * np.abs(covariance).max())
        assert np.linalg.eigvalsh(covariance).min() > 0
        assert np.isfinite(np.asarray(estimate.euler_sd)).all()


def test_the_depths_of_an_earlier_estimate_are_those_of_the_shape_that_is_known_now() -> None:
    """Its landmarks then have one shape, whatever was learned in between."""
    tracker = RealtimeTracker()
    estimates = run(tracker, sequence())
    rigid = [k for k, name in enumerate(LANDMARK_NAMES) if "nose" in name or ("corner" in name and "eye" in name)]

    def spread(points: list[Array]) -> float:
        """Largest standard deviation of a distance between two of them."""
        distances = [np.linalg.norm(X[:, None] - X[None], axis=2) for X in points]
        return float(np.std(distances, axis=0).max())

    told, known = [], []
    for e in estimates:
        assert e.landmarks is not None
        assert e.landmarks.camera is not None
        assert e.model_rotation is not None
        assert e.translation is not None
        assert e.animation is not None
        depths = tracker.landmark_depths(e.model_rotation, e.translation, e.animation, 0.0)
        told.append(e.landmarks.camera[rigid])
        known.append((e.landmarks.camera * (depths / e.landmarks.camera[:, 2])[:, None])[rigid])
    assert spread(known) < 0.3 * spread(told)
    np.testing.assert_allclose(known[-1], told[-1], atol=1e-9)


def test_a_covered_landmark_is_reported_as_hidden() -> None:
    """A board before all of the mouth and the chin of a face at rest."""
    x0, y0 = sequence().landmarks[0][:, 0].min(), sequence().landmarks[0][LANDMARK_NAMES.index("nose_base_mid"), 1]
    box = (int(x0) - 10, int(y0) + 2, int(x0) + 140, 239)
    still = moved(face(), np.zeros((8, 3)), np.zeros((8, 3)), np.zeros((8, 6)))
    covered = make_sequence(face(), still, noise_sd=2, occluders={k: box for k in range(4, 8)})
    estimates = run(RealtimeTracker(), covered)
    below = covered.landmarks[0][:, 1] > box[1] + 4
    visible = [e.landmarks.visibility for e in estimates if e.landmarks is not None]
    before, after = visible[3], visible[-1]
    assert before is not None
    assert after is not None
    assert before[below].mean() > 0.7
    assert after[below].mean() < 0.3
    assert after[~below].mean() > 0.7
    assert np.nanmax(errors_deg(estimates, covered)) < 3


def test_repeated_frames_leave_the_pose_in_place() -> None:
    estimates = run(RealtimeTracker(), in_order([*range(11)] + [10] * 14))
    R = np.stack([e.rotation for e in estimates[11:] if e.rotation is not None])
    assert len(R) == 14
    assert np.degrees(angle_between(R[4:], R[3:-1])).max() < 0.1  # once the motion that was predicted is over
    assert np.degrees(angle_between(R[0], R[-1])) < 1


def test_a_black_frame_does_not_destroy_the_track() -> None:
    frames = list(sequence().frames)
    frames[20] = Frame(np.zeros_like(frames[20].pixels))
    estimates = run(RealtimeTracker(), shown(frames))
    assert estimates[20].status is Status.LOST
    assert estimates[20].reason
    assert estimates[20].rotation is None
    assert estimates[21].status is Status.RECOVERED
    assert np.nanmax(errors_deg(estimates, sequence())[21:]) < 4


def test_a_tracker_can_be_stored_and_go_on_elsewhere() -> None:
    frames = small_motion().frames
    tracker = begun(frames[0])
    tracker.track(frames[1])
    copy = pickle.loads(pickle.dumps(tracker))
    here, there = tracker.track(frames[2]), copy.track(frames[2])
    np.testing.assert_array_equal(here.rotation, there.rotation)
    np.testing.assert_array_equal(here.covariance, there.covariance)


def test_the_same_frames_give_the_same_numbers(estimates: list[Estimate]) -> None:
    again = run(RealtimeTracker(), in_order(range(10)))
    for a, b in zip(estimates, again, strict=False):
        np.testing.assert_array_equal(np.asarray(a.rotation), np.asarray(b.rotation))
        np.testing.assert_array_equal(_covariance(a), _covariance(b))


def test_the_mesh_is_the_fitted_face() -> None:
    tracker = RealtimeTracker()
    first = tracker.initialize(face().frame, face().landmarks, face().camera)
    mesh = tracker.mesh(first)
    assert mesh is not None
    np.testing.assert_allclose(mesh, face().fit.vertices() @ face().fit.R.T + face().fit.t, atol=0.05)
    assert tracker.mesh(Estimate.lost(face().frame, "gone")) is None


@pytest.mark.parametrize("new", TRACKERS)
def test_landmarks_of_another_video_are_refused(new: Callable[[], Tracker]) -> None:
    given = face().landmarks
    with pytest.raises(MienError, match="outside the image"):
        new().initialize(face().frame, Landmarks(given.points + 300, given.scheme), face().camera)


def test_few_landmarks_say_less_than_that_a_head_moves_little() -> None:
    tracker = begun(sequence().frames[0])
    predicted = tracker.pose
    _, found = tracker.solver.refine(sequence().frames[3], tracker.prior.prediction(tracker.pose, tracker.pose))
    assert found.seen_share > tracker.settings.hold.share
    assert tracker._damp(predicted, found) is found

    few = found.facing & (np.arange(len(found.facing)) < 5)
    pose = predicted.moved(np.array([0.1, 0, 0] + [0.0] * 9))
    turned = replace(found, facing=few, pose=pose, at=found.at._replace(H=1e-2 * found.at.H))
    held = tracker._damp(predicted, turned)
    assert 0 < predicted.step_to(held.pose)[0] < 0.05  # most of the way back
    sure = tracker._damp(predicted, replace(turned, at=found.at._replace(H=1e6 * found.at.H)))
    np.testing.assert_allclose(predicted.step_to(sure.pose), predicted.step_to(turned.pose), atol=1e-4)


@pytest.mark.parametrize("rotated", [False, True])
def test_of_what_a_video_decodes_the_luma_is_enough(
    rotated: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tracking decoded frames never asks for their colours, and finds what it finds in the same frames as RGB."""
    images = [np.ascontiguousarray(np.rot90(image)) if rotated else image for image in portrait_images()]
    path = write_video(tmp_path / "portrait.mp4", images, codec="libx264", pix_fmt="yuv420p", options={"crf": "10"})
    if rotated:
        turn_by_metadata(path)

    def angles_deg(frames: Iterable[Frame]) -> Array:
        first, *later = frames
        tracker = begun(first)
        return np.degrees([np.asarray(tracker.track(frame).euler) for frame in later])

    of_colours = angles_deg(Frame(f.pixels, f.index, f.time) for f in open_video(path))
    monkeypatch.delattr(Decoded, "rgb")
    of_luma = angles_deg(open_video(path))
    np.testing.assert_allclose(of_luma, of_colours, atol=0.1)
    assert np.ptp(of_luma[:, 1]) > 3


def test_what_is_tracked_beside_the_landmarks_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """No anchors at all: the face is followed, if less well."""
    monkeypatch.setattr(person, "TRACKED", LANDMARK_VERTICES)
    estimates = run(RealtimeTracker(), sequence())
    assert errors_deg(estimates, sequence()).mean() < 3


def test_a_camera_that_would_be_inside_the_face_is_refused() -> None:
    camera = replace(face().camera, focal_px=60.0)
    with pytest.raises(MienError, match=r"focal length of 60 pixels .* mm from the camera; give the camera's own"):
        RealtimeTracker().initialize(face().frame, face().landmarks, camera)


def test_a_face_behind_a_lens_that_bends_is_followed_as_one_without(tmp_path: Path) -> None:
    """If its calibration is given; the face is beside the middle of the lens."""
    of_face, sequence = face().camera, small_motion()
    K = [[of_face.focal_px, 0, 20], [0, of_face.focal_px, of_face.cy], [0, 0, 1]]
    camera = Camera.from_matrix(K, [-0.3, 0, 0, 0])
    assert camera.lens is not None
    images = [bent(frame.pixels, camera.lens) for frame in sequence.frames]
    (tmp_path / "lens.json").write_text(json.dumps({"camera_matrix": K, "dist_coeffs": [-0.3, 0, 0, 0]}))
    pinhole = Camera(camera.focal_px, camera.cx, camera.cy)

    def angles_deg(frames: Iterable[Frame], camera: Camera | Path) -> Array:
        return mien.track(list(frames), camera=camera, landmarks=face().landmarks).euler_deg

    without = angles_deg(sequence.frames, pinhole)
    known = angles_deg((Frame(image, k, k / 25) for k, image in enumerate(images)), tmp_path / "lens.json")
    unknown = angles_deg((Frame(image, k, k / 25) for k, image in enumerate(images)), pinhole)
    assert np.ptp(without[:, 1]) > 3
    turn = [angles - angles[0] for angles in (without, known, unknown)]
    np.testing.assert_allclose(turn[1], turn[0], atol=0.3)
    assert np.abs(turn[2] - turn[0]).max() > 0.6
