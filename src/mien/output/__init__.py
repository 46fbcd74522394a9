"""Tracks on disk, overlays and plots."""
