"""The landmarks of a face at the side of the image, as a camera sees them that looks at it.

An image stretches what is far from its optical axis, and a detector, which knows faces from the middle of images, then
finds a wide one, turned by one or two degrees. So what is found there is found once more, in what a camera at the same
place would see, once it has turned towards the face.
"""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np

from mien.frame import Frame
from mien.geometry.camera import Camera, line_of_sight
from mien.geometry.rotation import ray_rotation
from mien.initialization.landmarks import Landmarks, place_of
from mien.initialization.upright import Upright, quarters_of, roll_of

_LEAST_DEG = 6.0
"""Angle between the optical axis and the face from which on the stretch matters."""
_SIDE, _MOST_PIXELS = 3.0, 640
"""Side of what the camera sees, in sizes of the face, and its maximum in pixels."""


def straightened(frame: Frame, face: Landmarks, camera: Camera) -> Landmarks:
    """The landmarks of a detected face, found once more by a camera that looks at it; the same ones near the optical
    axis, or where the face is not found so."""
    from mien.initialization.detector import detect

    sight = line_of_sight(face.points, camera)
    if math.degrees(math.acos(min(float(sight[2]), 1.0))) < _LEAST_DEG:
        return face
    side = _SIDE * place_of(face.points)[1]
    pixels = round(min(side, _MOST_PIXELS))
    scale = pixels / side
    # At this focal length a point at the face is as far from its middle as in the image, and depths are the same.
    turned = Camera.centred(scale * camera.focal_px / float(sight[2]), pixels, pixels)
    to_turned = turned.matrix @ ray_rotation(sight).T @ np.linalg.inv(camera.matrix)
    seen = cv2.warpPerspective(frame.pixels, to_turned, (pixels, pixels), borderMode=cv2.BORDER_REPLICATE)
    view = Upright(Frame(np.asarray(seen, np.uint8), frame.index, frame.time), quarters_of(roll_of(face)))
    found = detect(view.frame, (turned.cx, turned.cy))
    if not found or found[0].depths is None:
        return face
    points = cv2.perspectiveTransform(view.points_seen(found[0].points)[None], np.linalg.inv(to_turned))[0]
    depths = found[0].depths / scale
    straight = replace(face, points=points, depths=depths, scheme=found[0].scheme, disagreement=found[0].disagreement)
    return straight if straight.are_trackable(frame.width, frame.height) else face
