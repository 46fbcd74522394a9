"""Videos for tests: small ones of every kind that a reader may meet, and the portrait in motion."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from mien.arrays import Pixels
from mien.frame import Frame
from mien.initialization.landmark_files import write_landmarks
from mien.lens import Lens
from mien.synthetic import make_sequence, moved
from mien.video import open_video
from small_motion import face

MILLISECONDS = Fraction(1, 1000)


def gradient(index: int, width: int = 64, height: int = 48) -> Pixels:
    """(H, W, 3) red grows to the right, green downwards, blue is the index times ten."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.linspace(0, 250, width)[None, :]
    image[..., 1] = np.linspace(0, 250, height)[:, None]
    image[..., 2] = 10 * index % 256
    return image


def write_video(
    path: Path,
    images: Iterable[NDArray[np.generic]],
    *,
    codec: str = "ffv1",
    pix_fmt: str = "bgr0",
    of: str = "rgb24",
    times_ms: Sequence[int] | None = None,
    fps: int = 25,
    options: dict[str, str] | None = None,
    aspect: Fraction | None = None,
) -> Path:
    """Encode images of the format `of`, with options of the encoder; FFV1 in Matroska or AVI keeps every bit."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps, options=options or {})
        stream.pix_fmt = pix_fmt
        if times_ms is not None:
            stream.codec_context.time_base = MILLISECONDS
        for index, image in enumerate(images):
            if index == 0:
                stream.height, stream.width = image.shape[:2]
                if aspect is not None:
                    stream.codec_context.sample_aspect_ratio = aspect
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=of)
            frame.pts, frame.time_base = (
                (index, Fraction(1, fps)) if times_ms is None else (times_ms[index], MILLISECONDS)
            )
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def write_images(folder: Path, images: Iterable[Pixels]) -> Path:
    """Write images (H, W, 3) into a new folder, named by their numbers."""
    folder.mkdir()
    for index, image in enumerate(images):
        cv2.imwrite(str(folder / f"{index}.png"), image[..., ::-1])
    return folder


def bent(image: Pixels, lens: Lens) -> Pixels:
    """An image (H, W, 3) of a pinhole camera as a lens would show it; its border is repeated."""
    height, width = image.shape[:2]
    K, skew = np.array(lens.camera_matrix), lens.camera_matrix[0][1]
    pixels = np.stack(np.meshgrid(np.arange(float(width)), np.arange(float(height))), axis=-1)
    pixels[..., 0] -= skew / K[1, 1] * (pixels[..., 1] - K[1, 2])
    coefficients = np.array(lens.dist_coeffs or (0.0,) * 4)
    precise = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    plain = K * [[1, 0, 1], [1, 1, 1], [1, 1, 1]]  # without its skew
    points, straight = pixels.reshape(-1, 1, 2), np.array(lens.straight_matrix)
    if lens.fisheye:
        of_straight = cv2.fisheye.undistortPoints(points, plain, coefficients, None, np.eye(3), straight, precise)
    else:
        of_plain = cv2.undistortImagePoints(points, plain, coefficients, None, precise)
        of_straight = cv2.perspectiveTransform(of_plain, straight @ np.linalg.inv(plain))
    columns, rows = of_straight.reshape(height, width, 2).astype(np.float32).transpose(2, 0, 1)
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)


class Device:
    """A camera, as OpenCV opens it, that shows images (H, W, 3) and that somebody then unplugs."""

    def __init__(self, images: Iterable[Pixels]) -> None:
        self.images, self.released = [image[..., ::-1] for image in images], False

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, Pixels | None]:
        return (True, self.images.pop(0)) if self.images else (False, None)

    def release(self) -> None:
        self.released = True


def turn_by_metadata(path: Path, shown: tuple[int, int, int, int] = (0, 1, -1, 0)) -> None:
    """Say in an MP4's track header that what is at (x, y) is to be shown at (a x + c y, b x + d y), `shown` being a, b,
    c, d: turned clockwise by 90 degrees unless given."""
    a, b, c, d = (number << 16 for number in shown)
    content = bytearray(path.read_bytes())
    matrix = content.index(b"tkhd") + 44
    content[matrix : matrix + 36] = b"".join(
        value.to_bytes(4, "big", signed=True) for value in (a, b, 0, c, d, 0, 0, 0, 1 << 30)
    )
    path.write_bytes(content)


@cache
def portrait_images(count: int = 6) -> tuple[Pixels, ...]:
    """The portrait turning by one degree a frame, rendered: (240, 320, 3) each."""
    angles = np.zeros((count, 3))
    angles[:, 1] = np.arange(count)
    states = moved(face(), angles, np.zeros((count, 3)), np.zeros((count, 6)))
    return tuple(f.pixels for f in make_sequence(face(), states).frames)


def portrait_landmarks(path: Path) -> Path:
    """The landmarks of the first of `portrait_images`, written to `path`."""
    write_landmarks(path, face().landmarks)
    return path


def frames_of(path: Path) -> list[Frame]:
    """The frames of a video that is read without a warning."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return list(open_video(path))
