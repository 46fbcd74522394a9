"""Where tracking starts: the camera, and a first frame with its landmarks.

In a file, the first frame is the one from which the face is learned best, out of those between the first detection and
ten seconds after the face first looks into the camera; tracking runs forwards and backwards from there. With a live
camera, it is the first frame in which the face looks into the camera.
"""
