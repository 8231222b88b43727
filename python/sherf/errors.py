"""What the library's statuses are in Python: one exception each, with the library's line as its text."""

from __future__ import annotations


class Error(Exception):
    """Something failed in the library; the text says what, where and why."""


class NoMemory(Error, MemoryError):
    """An allocation failed."""


class BadArgument(Error, ValueError):
    """A value is out of range or of the wrong shape."""


class BadFile(Error, ValueError):
    """A file is truncated, hostile or not what it should be."""


class NoFile(Error, OSError):
    """A file or folder cannot be opened."""


class WriteFailed(Error, OSError):
    """A file cannot be written: the disk is full, or it is not permitted."""


class Unsupported(Error):
    """It is valid, but this build or device cannot do it."""


class Mismatch(Error, ValueError):
    """Two inputs do not belong together, or nobody is found in a photo."""


class Cancelled(Error):
    """The work was stopped."""


class Closed(Error, ValueError):
    """The object was closed before."""


# By sherf_status.
BY_STATUS = (None, NoMemory, BadArgument, BadFile, NoFile, WriteFailed, Unsupported, Mismatch, Cancelled)


def error_of(status: int, message: str) -> Error:
    """The exception for a status that is not SHERF_OK."""
    kind = BY_STATUS[status] if 0 < status < len(BY_STATUS) else None
    return (kind or Error)(message or f"sherf: status {status}")
