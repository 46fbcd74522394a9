"""The one error and the one warning that mien raises for its users."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_noted: ContextVar[dict[str, None] | None] = ContextVar("_noted", default=None)
"""What was warned of since `warnings_noted`, in this thread; None where nobody asks."""


class MienError(ValueError):
    """Bad input: the message names the file or value and the remedy."""


class MienWarning(UserWarning):
    """Something was corrected or skipped: the message names the file or value and what was done."""


def warn(message: str) -> None:
    """Issue a `MienWarning`; the command line prints it as one sentence."""
    noted = _noted.get()
    if noted is not None:
        noted[message] = None
    warnings.warn(message, MienWarning, stacklevel=3)


@contextmanager
def warnings_noted() -> Iterator[None]:
    """Note what is warned of in the block, or in a function that is decorated with this, for `noted_warnings`."""
    before = _noted.set({})
    try:
        yield
    finally:
        _noted.reset(before)


def noted_warnings() -> list[str]:
    """What was warned of so far, each sentence once; see `warnings_noted`."""
    return list(_noted.get() or ())


def interruption(error: BaseException) -> BaseException:
    """The KeyboardInterrupt in the `__cause__` chain of an error, else the error itself.

    A compiled function that is interrupted raises a SystemError caused by the KeyboardInterrupt, and up to Python 3.11
    an import a RuntimeError.
    """
    cause: BaseException | None = error
    while cause is not None and not isinstance(cause, KeyboardInterrupt):
        cause = cause.__cause__
    return error if cause is None else cause


def require(condition: bool, message: str) -> None:
    """Raise `MienError(message)` unless the condition holds."""
    if not condition:
        raise MienError(message)
