"""Compile kernels to machine code, once for every state of the sources that they can see.

numba keys its cache on the file of the compiled function alone, so an edit in another file that the function
calls into would go unnoticed. Here the key is a hash of the function's module, of every module of our own
packages that it imports, directly or through others, and of numba's version. Each key has a directory of its
own; the ones used longest ago are removed.

The cache is in NUMBA_CACHE_DIR, else in $XDG_CACHE_HOME/longreach/kernels (~/.cache by default). Where it
cannot be written, kernels work all the same, compiled anew in every process that does not find them there.
"""

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import signal
import threading
import warnings
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple, TypeVar, overload

import numba
from numba.core import config, types
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator
from numba.extending import intrinsic
from numba.extending import overload as compiled_as

# The packages whose sources count; a kernel's own package always does. What others install has a version.
OUR_PACKAGES = frozenset(
    {
        "foundation",
        "structured_text",
        "controller_st",
        "protocol",
        "nominal_arm",
        "controller",
        "plant_emulator",
        "vision_pc",
        "longreach",
        "longreach_ros2",
        "conformance",
        "dissector",
        "testbed",
        "laboratory",
    }
)
KEYS_KEPT = 16  # of each module: the present one, those of other working copies, and a few to go back to

Function = TypeVar("Function", bound=Callable[..., Any])


@overload
def kernel(function: Function, /) -> Function: ...


@overload
def kernel(**options: Any) -> Callable[[Function], Function]: ...


def kernel(function: Any = None, /, **options: Any) -> Any:
    """Return ``function`` compiled to machine code at its first call, and cached.

    ``options`` are those of ``numba.njit``. Without a fast-math option, arithmetic is IEEE 754: a rerun
    repeats bit for bit.
    """
    if function is None:
        return lambda function: _compile(function, options)
    return _compile(function, options)


@overload
def allocation_free(function: Function, /) -> Function: ...


@overload
def allocation_free(**options: Any) -> Callable[[Function], Function]: ...


def allocation_free(function: Any = None, /, **options: Any) -> Any:
    """Return ``function`` as ``kernel`` compiles it, but without numba's memory allocator.

    numba counts every array that a function takes out of a tuple or slices; in kernels of a microsecond the
    counting took half of the time. Without its run-time system there is nothing to count with, and code that
    would allocate does not compile: the hot loop is free of allocation by construction. Such functions call
    each other and are called from Python, but not from a ``kernel``, which counts.
    """
    return kernel(function, **{"error_model": "numpy", **options, "_nrt": False})


def settled(function: Function, *arguments: Any) -> Function:
    """The kernel ``function`` as compiled for ``arguments``, to be called with others of their types alone.

    Called from Python, a kernel first tells the type of every array and number in every tuple, a fifth of a
    microsecond each. This does not, nor does it refuse other types: it takes their memory for its own.
    """
    dispatcher: Any = function
    if not hasattr(dispatcher, "compile"):  # plain Python, as in _compiled
        return function
    with interrupt_later():
        compiled: Function = dispatcher.compile(tuple(map(numba.typeof, arguments)))
    return compiled


def fused(a: float, b: float, c: float) -> float:
    """a·b + c, rounded once; in a kernel it is one instruction.

    Sums of products that come out the same on every processor, without BLAS.
    """
    try:
        return float(Fraction(a) * Fraction(b) + Fraction(c))
    except (OverflowError, ValueError):  # beyond the range, infinite or no number
        return a * b + c


def _fused_typing(context: Any, a: Any, b: Any, c: Any) -> tuple[Any, Callable[..., Any]]:
    def lowered(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*values)

    return types.float64(types.float64, types.float64, types.float64), lowered


_fused: Any = intrinsic(_fused_typing)
compiled_as(fused)(lambda a, b, c: lambda a, b, c: _fused(a, b, c))


def _compile(function: Any, options: dict[str, Any]) -> Any:
    """Return ``function`` compiled with ``options``, its cache keyed by the sources that it can see."""
    dispatcher = numba.njit(**options)(function)
    if hasattr(dispatcher, "enable_caching"):  # not when NUMBA_DISABLE_JIT leaves plain Python
        if cache_root() is None:
            _warn_unwritable("no home is known", "set HOME, XDG_CACHE_HOME or NUMBA_CACHE_DIR")
        else:
            dispatcher._cache = _KernelCache(function)  # type: ignore[no-untyped-call]
        dispatcher._compile_for_args = _without_interrupts(dispatcher._compile_for_args)
    return dispatcher


def _without_interrupts(compile_for_args: Callable[..., Any]) -> Callable[..., Any]:
    """The method that the native dispatcher calls for new types of arguments, safe from Ctrl-C."""

    def compiled(*arguments: Any, **named: Any) -> Any:
        with interrupt_later():
            return compile_for_args(*arguments, **named)

    return compiled


@contextlib.contextmanager
def interrupt_later() -> Iterator[None]:
    """Within the block Ctrl-C waits; it comes, as it would have, when the block ends.

    For native code that calls Python back and does not look whether that raised: the loading of compiled
    kernels loses such an exception, fails by something else, or crashes. Without effect in other threads than
    the main one, which get no signals, and where the signal is ignored.
    """
    usual = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(usual):
        yield
        return
    came: list[tuple[int, FrameType | None]] = []
    signal.signal(signal.SIGINT, lambda number, frame: came.append((number, frame)))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
        if came:
            usual(*came[-1])


class _Module(NamedTuple):
    """One source file: the hash of its text, and the dotted names that it imports."""

    digest: bytes
    imported: tuple[str, ...]


@cache
def _module(path: Path, name: str) -> _Module:
    return _Module(hashlib.sha256(path.read_bytes()).digest(), tuple(imported_names(path, name)))


# Every service reads hundreds of sources at its start: a parser takes ten times as long.
_NO_CODE = re.compile(r"\\\n|#[^\n]*")
_IMPORT = re.compile(
    r"(?:^|[:;])[ \t]*(?:from[ \t]+(\.*)[ \t]*([\w.]*)[ \t]*import\b[ \t]*(\([^)]*\)|[^\n;]*)"
    r"|import[ \t]+([^\n;]*))",
    re.MULTILINE,
)


def imported_names(path: Path, name: str) -> Iterator[str]:
    """Yield what the module ``name`` at ``path`` imports, also inside of functions: dotted names of modules,
    and of functions, classes and words that look like imports.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    package = name.split(".") if path.name == "__init__.py" else name.split(".")[:-1]
    for dots, base, names, modules in _IMPORT.findall(_NO_CODE.sub(" ", text)):
        if modules:
            yield from re.findall(r"[\w.]+", modules)
            continue
        above = package[: len(package) - len(dots) + 1] if dots else []
        start = ".".join([*above, *(base.split(".") if base else [])])
        yield start
        yield from (f"{start}.{word}" for word in re.findall(r"\w+", names))


def _home(path: Path) -> tuple[Path, str]:
    """Return the folder that holds the top package of the module at ``path``, and the module's name."""
    root = path.parent
    while (root / "__init__.py").exists():
        root = root.parent
    return root, ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def sources(path: Path) -> dict[str, Path]:
    """Return the module at ``path`` and all modules of our own that it imports, by dotted name."""
    root, name = _home(path)
    ours = OUR_PACKAGES | {name.split(".")[0]}
    found: dict[str, Path] = {}
    waiting = [name]
    while waiting:
        parts = waiting.pop().split(".")
        if parts[0] not in ours:
            continue
        for length in range(1, len(parts) + 1):  # a package's __init__ runs before its modules
            module = ".".join(parts[:length])
            if module in found:
                continue
            place = root.joinpath(*parts[:length])
            for file in (place.with_suffix(".py"), place / "__init__.py"):
                if file.exists():
                    found[module] = file
                    waiting.extend(_module(file, module).imported)
    return found


@cache
def sources_key(path: Path) -> str:
    """Return a hash of all that a kernel in the module at ``path`` can depend on."""
    digest = hashlib.sha256(numba.__version__.encode())
    for name, file in sorted(sources(path).items()):
        digest.update(name.encode() + b"\0" + _module(file, name).digest)
    return digest.hexdigest()[:20]


def cache_root() -> Path | None:
    """Return the directory under which every key has its own; None where nobody has told of a home."""
    named = getattr(config, "CACHE_DIR", "")  # NUMBA_CACHE_DIR
    if named:
        return Path(named)
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return None if home.startswith("~") else Path(home) / "longreach" / "kernels"


class _SourcesLocator(_CacheLocator):
    """Where the kernels of one module are kept."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        path = Path(file).resolve()
        self._py_file = file  # numba names it in a warning
        self._line = function.__code__.co_firstlineno
        self._module = _home(path)[1]
        self._key = sources_key(path)
        root = cache_root()
        assert root is not None  # _compile gives no cache without one
        self.directory = root / f"{self._module}-{self._key}"

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> "_SourcesLocator":
        return cls(py_func, py_file)

    def get_cache_path(self) -> str:
        return str(self.directory)

    def get_source_stamp(self) -> str:
        return self._key

    def get_disambiguator(self) -> str:
        return str(self._line)

    def ensure_cache_path(self) -> None:
        """Make the directory; when it is new, remove those of this module that were used longest ago."""
        try:
            self.directory.mkdir(parents=True)
        except FileExistsError:
            return
        old = sorted(self.directory.parent.glob(f"{self._module}-*"), key=_last_used, reverse=True)
        for directory in old[KEYS_KEPT:]:
            shutil.rmtree(directory, ignore_errors=True)


def _last_used(directory: Path) -> float:
    try:
        return directory.stat().st_mtime
    except OSError:  # another process removed it
        return 0.0


class _KernelCacheImpl(CompileResultCacheImpl):
    _locator_classes = [_SourcesLocator]  # noqa: RUF012 numba's attribute


class _KernelCache(FunctionCache):
    """numba's cache of one function, by our key; processes that compile at once wait for each other."""

    _impl_class = _KernelCacheImpl

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled code for ``sig`` if it is cached, else None."""
        _mark_used(self._impl.locator.directory)
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except OSError:  # saving will say why
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the compiled code for ``sig``.

        numba writes the index and then the file it names: of two processes with two signatures, one could
        name the other's file. Hence the lock.
        """
        directory = self._impl.locator.directory
        try:
            self._impl.locator.ensure_cache_path()
            with (directory / "lock").open("wb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except FileNotFoundError:  # another process has just removed this key
            return
        except OSError as error:
            _warn_unwritable(directory.parent, error.strerror)


@cache
def _mark_used(directory: Path) -> None:
    """Set the time that decides which keys are kept; once a process."""
    try:
        os.utime(directory)
    except OSError:  # not there yet, or read-only
        return


@cache
def _warn_unwritable(root: Path | str, reason: str | None) -> None:
    """Say once a process that its kernels will be compiled anew by the next one."""
    warnings.warn(f"compiled kernels are not kept: {root}: {reason}", RuntimeWarning, stacklevel=3)
