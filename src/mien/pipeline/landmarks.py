"""The first frame alone: its landmarks, and how the face model fits them."""

from __future__ import annotations

from contextlib import closing, suppress
from pathlib import Path

from mien.candide.model import Candide
from mien.errors import MienError, require
from mien.files import real_path, require_ending, user_path
from mien.geometry.camera import Camera
from mien.initialization.fit import FirstFrame, fit_first_frame
from mien.initialization.landmark_files import read_landmarks, write_landmarks
from mien.initialization.landmarks import Landmarks, Point
from mien.output.destination import is_json_of_track, require_free
from mien.start.first_frame import prepare
from mien.start.footage import Footage
from mien.threads import one_blas_thread
from mien.video import open_video


@one_blas_thread()
def write_first_frame(
    video: str | Path | int,
    output: str | Path,
    plot: str | Path | None = None,
    *,
    landmarks: Landmarks | str | Path | None = None,
    camera: Camera | str | Path | None = None,
    focal_px: float | None = None,
    fov_deg: float | None = None,
    start: float | None = None,
    fps: float | None = None,
    at_once: bool = False,
    face: Point | None = None,
) -> tuple[FirstFrame, list[Path]]:
    """Write the landmarks of the first frame, and a picture of the mesh fitted to them; return the fit, and the files
    that were written: landmarks that stand in `output` already are left as they are.

    output: a `.json`, or a `.pts` of given landmarks; plot: a `.png`, by default beside the landmarks. The other
    arguments are those of `mien.track`. Raises MienError for bad input, and if no face is found.
    """
    from mien.output.overlay import Mesh, draw_fit, save_png

    output = user_path(output)
    picture = output.with_suffix(".png") if plot is None else user_path(plot)
    require_ending(picture, (".png",))
    require_ending(output, (".json",) if landmarks is None else (".json", ".pts"))
    require_free((output, picture), (video, camera))  # the landmarks themselves may be the output
    is_given = isinstance(landmarks, (str, Path)) and real_path(user_path(landmarks)) == real_path(output)
    _require_own(output, picture, is_given, is_named=plot is not None)
    with closing(Footage(open_video(video, fps), camera, focal_px, fov_deg, start)) as footage:
        begin = prepare(footage, landmarks, at_once, face)
    fit = fit_first_frame(begin.landmarks, begin.camera, Candide.default().with_whole_brows())
    _, points, _ = begin.landmarks.correspondences()
    mesh = Mesh(fit.in_camera(), fit.model.triangles)
    is_new = not output.exists()
    if is_new:
        write_landmarks(output, begin.landmarks, (begin.first.width, begin.first.height))
    elif not is_given:
        _require_same(output, begin.landmarks)
    names, graphics = begin.landmarks.point_names, begin.landmarks.graphics
    save_png(picture, draw_fit(begin.first, mesh, begin.camera, points, names, graphics))
    return fit, [output, picture] if is_new else [picture]


def _require_own(output: Path, picture: Path, is_given: bool, is_named: bool) -> None:
    """Raise MienError if the landmarks would replace the settings of a track, or their picture one that is another's.
    is_given: whether the landmarks were read from `output`; is_named: whether the user has named the picture."""
    require(
        is_given or not is_json_of_track(output),
        f"{output} holds the settings of a track; choose another name for the landmarks with -o",
    )
    known = output.exists() and output.suffix.lower() == ".json"  # beside a .pts lies the image in which it was marked
    require(
        is_named or known or not picture.exists(),
        f"{picture} exists and is not the picture of {output}; name another with --plot, or move it away",
    )


def _require_same(output: Path, found: Landmarks) -> None:
    """Raise MienError if a file has other landmarks than were found, perhaps corrected by hand."""
    same = False
    with suppress(MienError):
        same = read_landmarks(output, found.frame_index, found.time).to_dict() == found.to_dict()
    require(
        same,
        f"{output} exists with other landmarks, which may have been corrected; pass it with --landmarks, choose "
        "another name with -o, or delete it and its picture",
    )
