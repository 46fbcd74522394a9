"""The part of a video to track, its camera, and the options that a run is asked for."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Generator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mien.arrays import Array
from mien.errors import MienError, require, warn
from mien.files import checksum, size_of, user_path
from mien.frame import Frame
from mien.geometry.camera import Camera
from mien.initialization.landmarks import Point
from mien.video import StraightVideo, Video, check_interval, expected_count, select, warn_of_another_size

_FISHEYE = ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4")
_NO_FISHEYE = ("plumb_bob", "rational_polynomial", "radtan", "brown_conrady", "pinhole", "opencv")
"""How calibration files name the model of a fisheye lens, whose coefficients have another meaning, and those that
OpenCV has for other lenses."""
_COEFFICIENTS = re.compile(r"d|dist|dist_?coeff.*|distortion(?!_model).*", re.IGNORECASE)
"""How they name the coefficients."""


@dataclass(frozen=True)
class Footage:
    """The part of a video to track, and what is known about its camera.

    camera: a camera or its JSON file; or focal_px; or fov_deg (horizontal); by default `Camera.unknown`. start, end:
    seconds, a half-open interval; fps: frames per second at which a folder of images was asked to be opened. Raises
    MienError for options that no video allows.
    """

    video: Video
    camera: Camera | str | Path | None = None
    focal_px: float | None = None
    fov_deg: float | None = None
    start: float | None = None
    end: float | None = None
    fps: float | None = None
    _read: list[Generator[Frame, None, None]] = field(default_factory=list, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        camera = check_options(self)
        if camera is not None and camera.lens is not None and not isinstance(self.video, StraightVideo):
            object.__setattr__(self, "video", StraightVideo(self.video, camera.lens))

    def frames(self) -> Generator[Frame, None, None]:
        """The frames of this part, decoded from the beginning; see `select`."""
        self._read.append(select(self.video, self.start, self.end))
        return self._read[-1]

    def close(self) -> None:
        """End the reading of frames: an error that somebody keeps would keep a camera open."""
        for frames in self._read:
            frames.close()

    def since(self, start: float) -> Footage:
        """The rest of it, from a time in seconds on, which is to be closed by itself."""
        return replace(self, start=start)

    @property
    def frame_count(self) -> int | None:
        """Expected number of frames, None if unknown."""
        return expected_count(self.video, self.start, self.end)

    @property
    def repeatable(self) -> bool:
        """Whether frames can be read again; a live camera yields each once: those before the face are gone."""
        return self.video.repeatable

    @cached_property
    def sha256(self) -> str | None:
        """The checksum of the file, all of which is read; None for what has no file, or no longer has."""
        with suppress(OSError):
            return None if self.video.path is None else checksum(self.video.path)
        return None

    @property
    def identity(self) -> dict[str, int | None]:
        """What else tells the file from another of the same name, "bytes" and "inode"; None as for `sha256`."""
        with suppress(OSError):
            if self.video.path is not None:
                return {"bytes": size_of(self.video.path), "inode": self.video.path.stat().st_ino}
        return {"bytes": None, "inode": None}

    def camera_of(self, frame: Frame) -> Camera:
        """The camera for images of the size of this frame. Raises MienError for a field of view that no lens has."""
        if self.focal_px is not None:
            camera = Camera.centred(self.focal_px, frame.width, frame.height)
        elif self.fov_deg is not None:
            camera = Camera.from_fov(frame.width, frame.height, self.fov_deg)
        elif self.camera is None:
            camera = Camera.unknown(frame.width, frame.height)
        else:
            camera = _given(self.camera, (frame.width, frame.height))
        camera.require_possible(frame.width)
        if not (0 <= camera.cx <= frame.width and 0 <= camera.cy <= frame.height):
            warn(
                f"the optical axis of the camera, at {camera.cx:g}, {camera.cy:g}, lies outside the image of "
                f"{frame.width}x{frame.height} pixels; if the video was scaled, scale focal_px, cx and cy alike"
            )
        return camera


class FootageOptions(Protocol):
    """Options that `Footage` and `mien batch` have in common."""

    @property
    def camera(self) -> Camera | str | Path | None: ...
    @property
    def focal_px(self) -> float | None: ...
    @property
    def fov_deg(self) -> float | None: ...
    @property
    def start(self) -> float | None: ...
    @property
    def end(self) -> float | None: ...


def check_options(options: FootageOptions) -> Camera | None:
    """The camera that the options give, None for none or a number alone. Raises MienError for options that no video
    allows, and for a file of a camera that cannot be read."""
    for name in ("start", "end", "focal_px", "fov_deg"):
        value = getattr(options, name)
        number = value is None or (isinstance(value, Real) and math.isfinite(value))
        require(number, f"{name} is {value!r}; give a number, or omit it")
    focal, fov = options.focal_px, options.fov_deg
    require(focal is None or focal > 0, f"the focal length must be positive, not {focal} pixels")
    require(fov is None or 0 < fov < 180, f"the field of view is {fov} degrees; give an angle between 0 and 180")
    check_interval(options.start, options.end)
    given = [v for v in (options.camera, options.focal_px, options.fov_deg) if v is not None]
    require(len(given) <= 1, "the camera is given in more than one way; give a file, a focal length or a field of view")
    return None if options.camera is None else _given(options.camera)


def requested_options(
    options: FootageOptions, at_once: bool, face: Point | None = None, fps: float | None = None
) -> dict[str, Any]:
    """The options of a run apart from the tracker, as plain values for NAME.json. fps: that of `Footage`."""
    camera = options.camera.to_dict() if isinstance(options.camera, Camera) else options.camera and str(options.camera)
    numbers = {
        "focal_px": options.focal_px,
        "fov_deg": options.fov_deg,
        "start": options.start,
        "end": options.end,
        "fps": fps,
    }
    plain = {name: value if value is None else float(value) for name, value in numbers.items()}
    return {"camera": camera, **plain, "at_once": bool(at_once), "face": face and list(face)}


def _given(camera: Camera | str | Path, size: tuple[int, int] | None = None) -> Camera:
    """A camera, or that of a file, see `read_camera`."""
    return camera if isinstance(camera, Camera) else read_camera(camera, size)


def read_camera(path: str | Path, size: tuple[int, int] | None = None) -> Camera:
    """Read a camera from JSON: {"focal_px": .., "cx": .., "cy": ..}, the latter by default the middle of the image; the
    NAME.json of a track; or the "camera_matrix" of a calibration, see `Camera.from_matrix`. "image_width" and
    "image_height" may say of which images.

    size: width and height of the images in pixels; warns if the file is of images of another size. Without it, a middle
    that the file does not have is 0, 0. Raises MienError that names the file.
    """
    require(isinstance(path, (str, Path)), f"the camera is {type(path)}; give mien.Camera or the name of a JSON file")
    path = user_path(path)
    try:
        values = json.loads(path.read_text(encoding="utf-8-sig"))
        stated = _size_stated(values)
        if size:
            warn_of_another_size(f"{path} has the camera", stated, size, "scale its numbers alike")
        if "camera_matrix" not in values:  # a calibration may have the camera's name
            values = values.get("camera", values)
        if "camera_matrix" in values:
            return _calibrated(values)
        bent = ", ".join(name for name, numbers in _coefficients(values).items() if numbers.any())
        require(not bent, f'{bent} needs the "camera_matrix" of the same calibration')
        log_sd = float(values.get("focal_log_sd", 0.0))
        if "cx" in values or "cy" in values:
            focal_px, cx, cy = (float(values[name]) for name in ("focal_px", "cx", "cy"))
            return Camera(focal_px, cx, cy, log_sd)
        return replace(Camera.centred(float(values["focal_px"]), *(size or (1, 1))), focal_log_sd=log_sd)
    except MienError as error:
        raise MienError(f"{path}: {error}") from error
    except OSError as error:
        raise MienError(f"{path} cannot be read ({error.strerror}); check the name") from error
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        raise MienError(
            f'{path} needs {{"focal_px": .., "cx": .., "cy": ..}} in pixels, or a "camera_matrix" ({error})'
        ) from error


def _size_stated(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """A JSON with the size of its images where a NAME.json has it, also if it has it as a calibration does."""
    if "video" in values:
        return values
    width, height = (_pixels(values.get(name), name) for name in ("image_width", "image_height"))
    return {"video": {"width": width, "height": height}}


def _pixels(stated: Any, name: str) -> int | None:
    """A number of pixels that a file states under this name, None if it does not. Raises MienError if it is none."""
    try:
        number = None if stated is None else round(float(stated))
    except (TypeError, ValueError, OverflowError):
        number = 0
    require(
        number is None or number > 0,
        f"{name} is {stated!r}; give image_width and image_height as positive numbers of pixels, or omit both",
    )
    return number


def _calibrated(values: Mapping[str, Any]) -> Camera:
    """The camera of a calibration, whose distortion coefficients are all that is named like "dist_coeffs"."""
    distortion = np.concatenate([[], *_coefficients(values).values()])
    model = str(values.get("distortion_model") or _NO_FISHEYE[0]).lower().replace(" ", "_").replace("-", "_")
    known = (*_FISHEYE, *_NO_FISHEYE)
    require(
        model in known or not distortion.any(),
        f"the distortion_model {model!r} is not known; mien knows {', '.join(known)}",
    )
    K = _flat(values["camera_matrix"]).reshape(3, 3)
    return Camera.from_matrix(K, distortion, fisheye=model in _FISHEYE)


def _coefficients(values: Mapping[str, Any]) -> dict[str, Array]:
    """The distortion coefficients of a calibration, by the names that they have there."""
    named = {name: value for name, value in values.items() if _COEFFICIENTS.fullmatch(name)}
    return {name: _flat(value) for name, value in named.items() if value is not None}


def _flat(values: Any) -> Array:
    """The numbers of a matrix in nested lists, or as OpenCV writes it, with its "data"."""
    return np.array(values["data"] if isinstance(values, Mapping) else values, float).ravel()
