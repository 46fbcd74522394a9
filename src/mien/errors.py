"""The one error and the one warning that mien raises for its users."""

import warnings


class MienError(ValueError):
    """Bad input: the message names the file or value and the remedy."""


class MienWarning(UserWarning):
    """Something was corrected or skipped: the message names the file or value and what was done."""


def warn(message: str) -> None:
    """Issue a `MienWarning`; the command line prints it as one sentence."""
    warnings.warn(message, MienWarning, stacklevel=3)


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
