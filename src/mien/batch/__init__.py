"""Many videos: which there are, what is made of each, and running them several at a time."""

from mien.batch.options import BatchOptions
from mien.batch.run import track_all
from mien.batch.videos import find_videos

__all__ = ["BatchOptions", "find_videos", "track_all"]
