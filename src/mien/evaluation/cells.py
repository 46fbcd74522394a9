"""What the cells of the tables hold: numbers, shares and counts as text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Sized

import numpy as np

from mien.arrays import Array
from mien.evaluation import metrics
from mien.evaluation.datasets import buft
from mien.evaluation.scores import Score, Scores, pooled, pooled_errors, reliability, spread_of_errors, success_rate

NONE = "—"
"""A value that there is not."""


def listed(names: Iterable[str]) -> str:
    """The names, each once, with commas between."""
    return ", ".join(dict.fromkeys(names))


def sequences_of(chosen: Sized) -> str:
    """`1 sequence`, `2 sequences`."""
    return f"{len(chosen)} sequence{'s' if len(chosen) != 1 else ''}"


def table_1_cells(chosen: Sequence[Score], lost_deg: float) -> tuple[str, ...]:
    """P_s in per cent, E_pan, E_tilt, E_roll with their spread over the sequences, and E_m, degrees, as the paper's
    Table 1 has them."""
    tilt, pan, roll = pooled_errors(chosen)
    sd_tilt, sd_pan, sd_roll = spread_of_errors(chosen)
    angles = [with_spread(v, sd) for v, sd in ((pan, sd_pan), (tilt, sd_tilt), (roll, sd_roll))]
    p_s = percent(success_rate(chosen, lost_deg))
    return p_s, *angles, number((pan + tilt + roll) / 3)


def calibration_cells(chosen: Sequence[Score]) -> tuple[str, ...]:
    """Coverage of the intervals of all angles together and of each, the normalised squared error, and the gap of the
    confidence; all but the third in per cent."""
    error = pooled(chosen, lambda s: s.error_deg[s.calibrated])
    sd = pooled(chosen, lambda s: s.compared.sd_deg[s.calibrated])
    covariance = pooled(chosen, lambda s: s.compared.covariance_deg2[s.calibrated])
    nees = metrics.normalised_error_squared(error, covariance)
    return (
        *(percent(metrics.coverage(error, sd, level)) for level in metrics.COVERAGE_LEVELS),
        *(percent(metrics.coverage(error[:, k], sd[:, k], metrics.ANGLE_LEVEL)) for k in range(3)),
        number(mean(nees)),
        percent(reliability(chosen).gap),
    )


def coverage_of_buft(scores: Scores) -> str:
    """A sentence on which of the 45 uniform-light sequences of BUFT are present."""
    if scores.evaluation.dataset != "buft":
        return ""
    e = scores.evaluation
    named = zip(e.sequences, e.kinds_of_sequences, strict=True)
    names = tuple(name for name, kind in named if kind == buft.UNIFORM)
    absent = buft.missing(names)
    present = [n for n in buft.COMPLETE if n in names]
    if not absent:
        return "All 45 sequences of the uniform-light set are present."
    return f"Of the 45 sequences of the uniform-light set {len(present)} are present: {', '.join(present) or 'none'}."


def lost_of(chosen: Sequence[Score]) -> str:
    """How many of the frames with truth are lost."""
    return f"{sum(s.lost for s in chosen)} of {sum(s.frames for s in chosen)}"


def done_of(scores: Scores, tracker: str) -> str:
    """For how many of the sequences there is a pose of a tracker."""
    return f"{len(scores.with_pose(tracker))} of {len(scores.evaluation.sequences)}"


def mean(values: Array) -> float:
    """Mean of the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float("nan")


def number(value: float, digits: int = 2) -> str:
    """A number with so many decimals, `NONE` for NaN."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def percent(share: float) -> str:
    """A share in per cent, `NONE` for NaN."""
    return f"{100 * share:.1f}" if np.isfinite(share) else NONE


def with_spread(value: float, sd: float) -> str:
    """A number with its standard deviation, if that is known."""
    return f"{number(value)} ± {number(sd)}" if np.isfinite(sd) else number(value)


def sum_of(shapes: Mapping[str, float]) -> str:
    """`jawOpen - mouthFunnel`: the names of shapes that are added or subtracted, by their signs."""
    text = " ".join(f"{'+' if sign > 0 else '-'} {name}" for name, sign in shapes.items())
    return text.removeprefix("+ ")
