"""The first frame alone: its landmarks, and how the face model fits them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from mien.candide.model import Candide
from mien.errors import MienError, require
from mien.files import real_path, require_ending
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import Landmarks, Point
from mien.output.destination import require_free
from mien.start.first_frame import prepare
from mien.start.footage import Footage
from mien.threads import one_blas_thread
from mien.video import open_video


@one_blas_thread()
def write_first_frame(
    video: str | Path | int,
    output: str | Path,
    plot: str | Path,
    *,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    fps: float | None = None,
    at_once: bool = False,
    face: Point | None = None,
) -> FirstFrame:
    """Write the landmarks of the first frame, and a picture of the mesh fitted to them; return the fit.

    output: a `.json`, or a `.pts` of given landmarks; plot: a `.png`. The other arguments are those of `mien.track`.
    Raises MienError for bad input, and if no face is found.
    """
    from mien.output.overlay import draw_mesh, save_png

    require_ending(Path(plot), (".png",))
    require_ending(Path(output), (".json",) if landmarks is None else (".json", ".pts"))
    require_free((Path(output), Path(plot)), (video, camera))  # the landmarks themselves may be written again
    begin = prepare(Footage(open_video(video, fps), camera, focal_px, fov_deg, start), landmarks, at_once, face)
    fit = fit_first_frame(begin.landmarks, begin.camera, Candide.default().with_whole_brows())
    _, points, _ = begin.landmarks.correspondences()
    vertices = fit.model.pose(fit.vertices(), fit.R, fit.t)
    _require_no_corrections(Path(output), begin.landmarks, landmarks)
    write_landmarks(output, begin.landmarks)
    graphics = begin.landmarks.graphics
    save_png(Path(plot), draw_mesh(begin.first, vertices, fit.model.triangles, begin.camera, points, graphics))
    return fit


def _require_no_corrections(output: Path, found: Landmarks, given: object) -> None:
    """Raise MienError if a file has other landmarks than were found, perhaps corrected by hand, and was not given."""
    same = isinstance(given, (str, Path)) and real_path(Path(given)) == real_path(output)
    if same or not output.exists():
        return
    with suppress(MienError):
        same = read_landmarks(output, found.frame_index, found.time).to_dict() == found.to_dict()
    require(
        same,
        f"{output} exists with other landmarks, which may have been corrected; pass it with --landmarks, choose "
        "another name with -o, or delete it",
    )
