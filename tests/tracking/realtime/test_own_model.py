"""A model of the user's own, read from a .wfm file, is tracked like the package's."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mien.candide.model import Candide
from mien.candide.wfm import Wfm, read_wfm, write_wfm
from mien.errors import MienError
from mien.initialization.fit import fit_first_frame
from mien.tracking.realtime import RealtimeTracker
from mien.tracking.state import Status
from small_motion import errors_of_all_deg, face, run, small_motion


def test_a_model_from_a_file_fits_and_tracks(tmp_path: Path) -> None:
    write_wfm(tmp_path / "own.wfm", Wfm.neutral(Candide.default()))
    model = read_wfm(tmp_path / "own.wfm").model
    ours = fit_first_frame(face().landmarks, face().camera)
    read = fit_first_frame(face().landmarks, face().camera, model)
    np.testing.assert_allclose(read.R, ours.R, atol=1e-3)
    sequence = small_motion()
    estimates = run(RealtimeTracker(model=model), sequence)
    assert [e.status for e in estimates[1:]] == [Status.TRACKED] * (len(estimates) - 1)
    assert errors_of_all_deg(estimates, sequence)[-1] < 2


def test_another_shape_gives_another_fit() -> None:
    wider = replace(Candide.default(), mean=Candide.default().mean * [1.1, 1, 1])
    ours, other = (fit_first_frame(face().landmarks, face().camera, m) for m in (None, wider))
    assert np.abs(other.shape - ours.shape).max() > 0.01


def test_a_model_without_the_units_is_refused() -> None:
    model = Candide.default()
    bare = replace(model, animation_unit_names=("frown",), animation_units=model.animation_units[:1])
    with pytest.raises(MienError, match="animation unit"):
        fit_first_frame(face().landmarks, face().camera, bare)
