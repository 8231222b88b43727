"""Contexts do the computing. Every library call goes through a context and runs on that context's own thread."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from ctypes import byref, c_char_p, c_void_p, cast, create_string_buffer
from typing import Any

from ._handle import Object
from ._library import DEVICES, LIBRARY, LOG_FUNCTION, PRECISIONS, PROGRESS_FUNCTION, Options
from .errors import Error, error_of

Progress = Callable[[str, float, float], None]
_log = logging.getLogger("sherf")


def choice(value: str, names: tuple[str, ...], what: str) -> int:
    """The index of `value` in an enumeration's `names`. Raises ValueError for any other value."""
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{what}: {value!r} is none of {', '.join(names)}")
    return names.index(value)


class _Work:
    """State shared by a context's callbacks and its thread. It must not keep the context itself alive."""

    def __init__(self, progress: Progress | None) -> None:
        self.progress = progress
        self.lock = threading.Lock()
        self.running: object = None  # the call that is running
        self.pointer: int | None = None
        self.raised: BaseException | None = None  # raised by a progress function
        self.thread = 0

    def on_progress(self, _user: Any, text: bytes, done: float, total: float) -> None:
        """Called by the library with its progress, on the thread that computes."""
        if self.progress is None or self.raised is not None:
            return
        try:
            self.progress(text.decode("utf-8", "replace"), done, total)
        except BaseException as error:  # it cannot pass through C: cancel the call, which then raises it
            self.raised = error
            LIBRARY.sherf_cancel(self.pointer)

    def on_log(self, _user: Any, level: int, line: bytes) -> None:
        """Called by the library with a line of its log."""
        _log.log(logging.WARNING if level else logging.INFO, "%s", line.decode("utf-8", "replace"))

    def call(self, token: object, name: str, arguments: tuple[Any, ...]) -> None:
        """Runs one call on the context's thread. Raises the library's message if it fails."""
        with self.lock:
            self.running, self.raised, self.thread = token, None, threading.get_ident()
        try:
            status = getattr(LIBRARY, name)(self.pointer, *arguments)
            message = LIBRARY.sherf_message(self.pointer).decode("utf-8", "replace") if status else ""
        finally:
            with self.lock:
                self.running = None
                LIBRARY.sherf_cancel_reset(self.pointer)
        raised, self.raised = self.raised, None
        if raised is not None:
            raise raised
        if status:
            raise error_of(status, message)

    def cancel(self, token: object) -> None:
        """Asks the library to stop the call of `token` if it is the one that runs."""
        with self.lock:
            if self.running is token:
                LIBRARY.sherf_cancel(self.pointer)


class Context(Object):
    """The threads, precision and device that calls compute with. Most programs use only :func:`default_context`.

    Calls with the same context wait for each other, so threads may share a context. To render twice at the same time,
    give each thread its own context. Ctrl-C stops a call. Log lines go to ``logging.getLogger("sherf")``.

    threads: 0 means one per core; at most 4096.
    precision: "auto", "fp32" or "bf16".
    device: "auto", "cpu" or "cuda".
    progress: a function that is called as ``progress(text, done, total)`` on another thread during long work; total 0
        means unknown. An exception in it stops the work and is raised by the call.

    Raises ValueError or TypeError for invalid arguments, and `sherf.Error` if the device cannot be used.
    """

    def __init__(self, threads: int = 0, precision: str = "auto", device: str = "auto",
                 progress: Progress | None = None) -> None:
        if not isinstance(threads, int) or not 0 <= threads <= 4096:
            raise ValueError(f"threads: {threads!r} is not 0 to 4096")
        if progress is not None and not callable(progress):
            raise TypeError("progress: expected a function")
        work = _Work(progress)
        keep = (LOG_FUNCTION(work.on_log), PROGRESS_FUNCTION(work.on_progress))
        chosen = choice(device, DEVICES, "device")
        options = Options(threads, choice(precision, PRECISIONS, "precision"), keep[0], keep[1], None, chosen)
        out = c_void_p()
        status = LIBRARY.sherf_context_create(byref(options), byref(out))
        if status or not out.value:
            line = create_string_buffer(256)
            LIBRARY.sherf_device_find(chosen, line, len(line))
            raise error_of(status, f"no context on {device}: {line.value.decode('utf-8', 'replace')}")
        worker = ThreadPoolExecutor(1, "sherf")

        def free(pointer: int, keep: Any = keep) -> None:  # keeps the callbacks alive as long as the context
            worker.shutdown(wait=False)
            LIBRARY.sherf_context_free(pointer)

        work.pointer, self._work, self._worker, self._process = out.value, work, worker, os.getpid()
        self._hold(out.value, free)

    def run(self, name: str, *arguments: Any) -> None:
        """Calls the library's function `name` with this context as the first argument. Raises the library's error."""
        with self._handle.use():
            if self._process != os.getpid():
                raise Error("a Context does not go through a fork: make a new one in the new process")
            if self._work.running is not None and self._work.thread == threading.get_ident():
                raise Error("a progress function cannot call with the context that it reports of")
            token = object()
            future = self._worker.submit(self._work.call, token, name, arguments)
            try:
                future.result()
            except BaseException:
                self._stop(token, future)
                raise

    def _stop(self, token: object, future: Future[None]) -> None:
        """After Ctrl-C: waits until the library returns, because nothing it uses may be freed before."""
        while not future.done() and not future.cancel():
            self._work.cancel(token)
            try:
                wait([future], timeout=0.1)
            except KeyboardInterrupt:
                pass

    @property
    def precision(self) -> str:
        """The precision in use: "fp32" or "bf16"."""
        with self._handle.use() as pointer:
            return PRECISIONS[LIBRARY.sherf_precision_used(pointer)]

    @property
    def device(self) -> str:
        """The device in use: "cpu" or "cuda"."""
        with self._handle.use() as pointer:
            return DEVICES[LIBRARY.sherf_device_used(pointer)]


_default: Context | None = None
_default_lock = threading.Lock()


def default_context() -> Context:
    """The context of every call without one: all cores, with precision and device chosen by the library.

    It is created on first use, and again after it was closed or the process was forked.
    """
    global _default
    with _default_lock:
        if _default is None or _default.closed or _default._process != os.getpid():
            _default = Context()
        return _default


def context_or_default(context: Context | None) -> Context:
    """`context`, or the default context for None. Raises TypeError for anything else."""
    if context is None:
        return default_context()
    if not isinstance(context, Context):
        raise TypeError(f"context: expected a sherf.Context, not {type(context).__name__}")
    return context


def path_bytes(path: Any, what: str = "path") -> bytes:
    """A path as the bytes that the library takes. Raises TypeError or ValueError."""
    try:
        encoded = os.fsencode(path)
    except TypeError:
        raise TypeError(f"{what}: expected a path, not {type(path).__name__}") from None
    if not encoded or b"\0" in encoded:
        raise ValueError(f"{what}: {path!r} is no path")
    return encoded


def make(context: Context | None, name: str, *arguments: Any) -> int:
    """Calls a library function that creates an object. Returns the object's pointer, which the caller must free."""
    out = c_void_p()
    context_or_default(context).run(name, *arguments, byref(out))
    if not out.value:
        raise Error(f"{name} made nothing")
    return out.value


def text_of(context: Context | None, name: str, *arguments: Any) -> str:
    """Calls a library function whose last output is a text. Returns the text and frees the library's copy."""
    out = c_void_p()
    try:
        context_or_default(context).run(name, *arguments, byref(out))
        return bytes(cast(out, c_char_p).value or b"").decode("utf-8", "replace") if out.value else ""
    finally:
        LIBRARY.sherf_free(out)
