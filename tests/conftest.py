"""Settings of every test."""

from __future__ import annotations

import hypothesis

# No test asserts a time: a busy machine, or a kernel that is compiled, is no failure.
hypothesis.settings.register_profile("mien", deadline=None)
hypothesis.settings.load_profile("mien")
