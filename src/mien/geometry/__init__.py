"""Rotations and the camera."""
