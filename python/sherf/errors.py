"""The library's statuses as Python exceptions. Each carries the library's one-line message."""

from __future__ import annotations


class Error(Exception):
    """Base of all errors of the library. The text says what failed, where and why."""


class NoMemory(Error, MemoryError):
    """An allocation failed."""


class BadArgument(Error, ValueError):
    """A value is out of range or of the wrong shape."""


class BadFile(Error, ValueError):
    """A file is truncated, malicious or not of the expected kind."""


class NoFile(Error, OSError):
    """A file or folder cannot be opened."""


class WriteFailed(Error, OSError):
    """A file cannot be written: the disk is full, or permission is denied."""


class Unsupported(Error):
    """The request is valid, but this build or device does not support it."""


class Mismatch(Error, ValueError):
    """Two inputs do not match, or nobody was found in a photo."""


class Cancelled(Error):
    """The work was cancelled."""


class Closed(Error, ValueError):
    """The object has already been closed."""


# Indexed by sherf_status.
BY_STATUS = (None, NoMemory, BadArgument, BadFile, NoFile, WriteFailed, Unsupported, Mismatch, Cancelled)


def error_of(status: int, message: str) -> Error:
    """The exception for `status`, a sherf_status other than SHERF_OK."""
    kind = BY_STATUS[status] if 0 < status < len(BY_STATUS) else None
    return (kind or Error)(message or f"sherf: status {status}")
