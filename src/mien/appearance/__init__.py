"""Texture, rendered views, descriptors and their Gaussians, section 3.1 of the paper."""
