"""Track all faces in a video, one after the other, each as if it were alone.

There is no face recognition. Faces are detected twice a second throughout the video. Consecutive detections in about
the same place, or where a moving face goes on, are one appearance; the first appearance that no track covers, at least
for a second, is tracked next, from there to the end of the video, as the face may appear again. A tracker that has lost
its face may lock on to another one: where two tracks have the same face, the less confident one counts as lost.
"""

from mien.faces.track import track_faces

__all__ = ["track_faces"]
