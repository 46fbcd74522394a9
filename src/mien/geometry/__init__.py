"""Rotations and the camera.

A matrix `R_a_b` (3, 3) brings vectors from the axes b to the axes a. Right-handed axes, all of them:

- camera: x right, y down, z forward, the origin in the camera;
- head: x to the person's left, y up, z out of the face, as the person holds it upright;
- model: those in which the tracker has its face model, which are the head's as far as the first frame shows them; what
  is learned later leads to better ones of the head, and the model stays (`mien.tracking.realtime.axes`);
- fit: those of CANDIDE-3, upright (`mien.initialization.fit.LEAN_DEG`), in which the shape is fitted.

`R` alone is head, or model, to camera.
"""
