"""Frames of one size."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mien.errors import MienWarning
from mien.frame import Frame
from mien.video import open_video


def test_frames_of_changing_size_are_fitted_into_the_first_with_a_warning(tmp_path: Path) -> None:
    """A wider frame keeps its proportions: black above and below, and only there."""
    images = [np.full((48, 64, 3), 200, np.uint8)] * 2 + [np.full((48, 128, 3), 200, np.uint8)] * 2
    path = tmp_path / "sizes.mjpeg"
    path.write_bytes(b"".join(cv2.imencode(".jpg", i)[1].tobytes() for i in images))
    with pytest.warns(MienWarning, match=r"sizes.mjpeg: frame 2 has 128x48 pixels and the first 64x48") as caught:
        frames = list(open_video(path))
    assert len(caught) == 1
    assert [f.pixels.shape for f in frames] == [(48, 64, 3)] * 4
    fitted = frames[2].pixels
    assert fitted[:12].max() == fitted[36:].max() == 0
    assert fitted[12:36].min() > 190


def test_a_taller_frame_is_in_the_middle() -> None:
    images = [np.full((48, 64, 3), 200, np.uint8), np.full((96, 64, 3), 200, np.uint8)]
    given = [Frame(image, k, 0.04 * k) for k, image in enumerate(images)]
    with pytest.warns(MienWarning, match="frame 1 has 64x96 pixels"):
        fitted = list(open_video(given))[1].pixels
    assert fitted.shape == (48, 64, 3)
    assert fitted[:, :16].max() == fitted[:, 48:].max() == 0
    assert fitted[:, 16:48].min() == 200
