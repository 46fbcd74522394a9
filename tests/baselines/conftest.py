"""The surfaces that the trackers of a rigid head use, fitted to the portrait."""

from __future__ import annotations

import pytest

from mien.baselines.surface import Surface, cylinder, ellipsoid
from small_motion import face


@pytest.fixture(scope="module", params=[cylinder, ellipsoid])
def surface(request: pytest.FixtureRequest) -> Surface:
    made: Surface = request.param(face().fit)
    return made
