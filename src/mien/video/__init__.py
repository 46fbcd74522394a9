"""Sources of frames: a file, a folder of images, a camera, or frames that a program reads itself.

Times are the container's time stamps in seconds since its start, even if the frame rate varies. Every frame becomes
8-bit RGB with square pixels, rotated and mirrored as the container says. A frame whose size differs from that of the
first is scaled to fit it, with black borders and a warning. Frames are decoded one at a time.

The rest of mien imports these names from here, whichever file they are in.
"""

from mien.video.container import VIDEO_SUFFIXES
from mien.video.folder import FOLDER_FPS, IMAGE_SUFFIXES, list_images, refuse_among_images
from mien.video.scaling import warn_of_another_size
from mien.video.selection import SAME_TIME, backwards, check_interval, decode_frame, expected_count, select
from mien.video.source import Source, Video, check_fps, open_video
from mien.video.straight import StraightVideo

__all__ = [
    "FOLDER_FPS",
    "IMAGE_SUFFIXES",
    "SAME_TIME",
    "VIDEO_SUFFIXES",
    "Source",
    "StraightVideo",
    "Video",
    "backwards",
    "check_fps",
    "check_interval",
    "decode_frame",
    "expected_count",
    "list_images",
    "open_video",
    "refuse_among_images",
    "select",
    "warn_of_another_size",
]
