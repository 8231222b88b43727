"""The library's objects. Each is freed exactly once, and never while a call uses it."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

from .errors import Closed


class Handle:
    """A pointer to a library object, the number of calls that use it, and the function that frees it."""

    def __init__(self, pointer: int, free: Callable[[int], None], name: str) -> None:
        self._pointer, self._free, self._name = pointer, free, name
        self._lock = threading.Lock()
        self._users = 0
        self.closed = False

    @contextmanager
    def use(self) -> Iterator[int]:
        """Yields the pointer, which is not freed inside the block. Raises `sherf.Closed`."""
        with self._lock:
            if self.closed:
                raise Closed(f"this {self._name} is closed")
            self._users += 1
        try:
            yield self._pointer
        finally:
            self._leave()

    def _leave(self) -> None:
        """Ends a use; the last one frees an object that was closed meanwhile."""
        with self._lock:
            self._users -= 1
            last = self.closed and self._users == 0
        if last:
            self._free(self._pointer)

    def close(self) -> None:
        """Frees the object now, or when the last call that uses it returns."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            idle = self._users == 0
        if idle:
            self._free(self._pointer)


_Self = TypeVar("_Self", bound="Object")


class Object:
    """Base class of everything that owns memory of the library.

    The memory is freed by ``close()``, at the end of a ``with`` block, or when nothing refers to the object any more.
    Using a closed object raises :class:`sherf.Closed`. Objects cannot be pickled or copied.
    """

    _handle: Handle

    def __init__(self, *_: Any, **__: Any) -> None:
        """Raises TypeError: objects come from class methods, such as ``load``."""
        name = type(self).__name__
        raise TypeError(f"{name}() makes nothing; see the class methods of {name}")

    @classmethod
    def _of(cls: type[_Self], pointer: int, free: Callable[[int], None]) -> _Self:
        """A new object that owns `pointer`, which `free` frees."""
        self = object.__new__(cls)
        self._hold(pointer, free)
        return self

    def _hold(self, pointer: int, free: Callable[[int], None]) -> None:
        """Takes ownership of `pointer`, freed by `free` when the object is closed or collected."""
        self._handle = Handle(pointer, free, type(self).__name__)
        weakref.finalize(self, self._handle.close)

    @property
    def closed(self) -> bool:
        """Whether the object has been closed."""
        return self._handle.closed

    def close(self) -> None:
        """Frees the memory, after running calls return. Closing again does nothing."""
        self._handle.close()

    def __enter__(self: _Self) -> _Self:
        """Returns the object itself. Raises `sherf.Closed`."""
        with self._handle.use():
            return self

    def __exit__(self, *_: object) -> None:
        """Closes the object."""
        self.close()

    def __repr__(self) -> str:
        """The class, and whether the object is closed."""
        return f"<sherf.{type(self).__name__}{', closed' if self.closed else ''}>"

    def __reduce__(self) -> Any:
        """Raises TypeError: the memory belongs to the library and cannot be pickled or copied."""
        raise TypeError(f"sherf.{type(self).__name__} cannot be pickled or copied; save it to a file")


@contextmanager
def using(*objects: tuple[Object | None, type]) -> Iterator[list[int | None]]:
    """Yields the pointers of `objects`, pairs of an object and its required class; None gives None.

    The objects stay alive inside the block. Raises TypeError for a wrong class and `sherf.Closed` for a closed object.
    """
    with ExitStack() as stack:
        pointers: list[int | None] = []
        for thing, kind in objects:
            if thing is not None and not isinstance(thing, kind):
                raise TypeError(f"expected a sherf.{kind.__name__}, not {type(thing).__name__}")
            pointers.append(None if thing is None else stack.enter_context(thing._handle.use()))
        yield pointers
