"""Settings of every test, and a short video."""

from __future__ import annotations

from pathlib import Path

import hypothesis
import pytest

from videos import gradient, write_video

# No test asserts a time: a busy machine, or a kernel that is compiled, is no failure.
hypothesis.settings.register_profile("mien", deadline=None)
hypothesis.settings.load_profile("mien")


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return write_video(tmp_path / "plain.mkv", [gradient(i) for i in range(10)])
