"""Compiled texts: their functions are called from Python, their memory is read.

Machine code is stored in the folder of the kernels (``foundation.compiled.cache_root``), by a hash of the
texts, of this compiler and of LLVM's version, so that a second start does not compile.
"""

import contextlib
import ctypes
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as llvm

from foundation.compiled import KEYS_KEPT, cache_root
from structured_text.backend import MEMORY, Backend
from structured_text.checker import check
from structured_text.declarations import BUDGET, FAULT, Declarations
from structured_text.errors import Place, ProgramFaulted, RuntimeFault, TextErrors
from structured_text.memory import MemoryView, ctype_of, new, read, write
from structured_text.parser import Parser
from structured_text.types import ELEMENTARY, Type, is_scalar
from structured_text.values import REASONS

LOOPS = 10_000_000
"""Rounds that all loops of a call without a bound of their own may take together."""

_FOLDER = "structured_text"
_DIGEST = hashlib.sha256().digest_size


class Called(NamedTuple):
    """What a function returned, and its outputs by name."""

    result: Any
    outputs: dict[str, Any]


class CompiledProgram:
    """Texts as one program.

    ``memory`` has a part for every PROGRAM and global variable. Calls are not to be made from two threads.
    """

    def __init__(self, texts: Mapping[str, str]) -> None:
        """``texts``: by the name that errors give.

        Raises StructuredTextError for a text that is not of the language.
        """
        self._names = _checked(texts)
        self._files = sorted({unit.file for unit in self._names.units.values()})
        self._engine = _engine(self._names, texts)
        address = self._engine.get_global_value_address(MEMORY)
        self.memory = MemoryView(self._names.memory, address, self._engine)
        self.memory.clear()
        parts = self._names.memory.fields
        self._fault = ctypes.c_uint64.from_address(address + parts[FAULT.upper()].offset)
        self._budget = ctypes.c_int64.from_address(address + parts[BUDGET.upper()].offset)
        self._entries: dict[str, Any] = {}

    def new(self, name: str) -> MemoryView:
        """Memory for a value of the type ``name``, with initial values. Raises StructuredTextError."""
        return new(self._names.named_type(name, Place("", 0)))

    @property
    def types(self) -> dict[str, Type]:
        """All declared types and function blocks, by name in capitals."""
        return {n: of for n, of in self._names.types.items() if n not in ELEMENTARY}

    def constant(self, name: str) -> Any:
        """The value of a global constant: a number, or a list of them. Raises KeyError."""
        return self._names.globals[name.upper()].constant

    def run(self, name: str) -> None:
        """Call the PROGRAM ``name`` once. Raises ProgramFaulted when a run-time check ends the call."""
        if name not in self._entries:
            instance = self._names.memory.fields[name.upper()]
            entry = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self._address(name))
            self._entries[name] = entry, self.memory.address + instance.offset
        entry, place = self._entries[name]
        self._begin()
        entry(place)
        self._end()

    def call(self, name: str, instance: MemoryView | None = None, **given: Any) -> Called:
        """Call a FUNCTION, or a FUNCTION_BLOCK on its ``instance``, with parameters by name.

        Whole variables are handed over as views. Raises ProgramFaulted when a run-time check ends the call.
        """
        unit = self._names.units[name.upper()]
        passed: list[Any] = [] if instance is None else [instance.address]
        kinds: list[Any] = [] if instance is None else [ctypes.c_void_p]
        outputs: dict[str, MemoryView] = {}
        held: list[MemoryView] = []  # lest their memory goes before the call
        for parameter in unit.parameters():
            if parameter.section == "VAR_INPUT" and is_scalar(parameter.type):
                kinds.append(ctype_of(parameter.type))
                passed.append(given.pop(parameter.name))
                continue
            kinds.append(ctypes.c_void_p)
            place = given.pop(parameter.name, None)
            if is_scalar(parameter.type) or place is None:
                outputs[parameter.name] = cell = new(parameter.type)
                write(parameter.type, cell.address, cell.data if place is None else place)
                place = cell
            held.append(place)
            passed.append(place.address)
        if given:
            raise TypeError(f"{name} has no parameter {', '.join(given)}")
        returns = None if unit.result is None else ctype_of(unit.result)
        self._begin()
        result = ctypes.CFUNCTYPE(returns, *kinds)(self._address(name))(*passed)
        self._end()
        return Called(result, {key: read(view.type, view.address, view) for key, view in outputs.items()})

    def _address(self, name: str) -> int:
        return int(self._engine.get_function_address(f"st_{name.upper()}"))

    def _begin(self) -> None:
        self._fault.value, self._budget.value = 0, LOOPS

    def _end(self) -> None:
        fault = self._fault.value
        if fault:
            place = Place(self._files[fault >> 32 & 0xFFFF], fault & 0xFFFFFFFF)
            raise ProgramFaulted(RuntimeFault(place, REASONS[fault >> 48]))


def _checked(texts: Mapping[str, str]) -> Declarations:
    refusals = TextErrors()
    parsed = [each for file, text in texts.items() for each in Parser(file, text, refusals).declarations()]
    return check(parsed, refusals)


def _engine(names: Declarations, texts: Mapping[str, str]) -> Any:
    """An engine that holds the machine code of ``names``."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=2, codemodel="jitdefault")
    place = _place(texts, machine.triple)
    code = _read(place)
    empty = llvm.parse_assembly(f'target triple = "{machine.triple}"\n')
    engine = llvm.create_mcjit_compiler(empty, machine)
    if code is None:
        code = _compiled(names, machine)
        _write(place, code)
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _compiled(names: Declarations, machine: Any) -> bytes:
    module = Backend(names, machine.triple, str(machine.target_data)).module
    parsed = llvm.parse_assembly(str(module))
    parsed.verify()
    options = llvm.create_pipeline_tuning_options(speed_level=2)
    # Vectors of six gain nothing here, and looking for them takes ten times as long as all the rest.
    options.loop_vectorization = options.slp_vectorization = False
    options.inlining_threshold = 60
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(parsed, builder)
    code: bytes = machine.emit_object(parsed)
    return code


def _place(texts: Mapping[str, str], triple: str) -> Path:
    """Where the machine code of ``texts`` is stored; nowhere if there is no such folder."""
    digest = hashlib.sha256(f"{llvmlite.__version__} {triple}".encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    for name, text in sorted(texts.items()):
        digest.update(name.encode() + b"\0" + text.encode() + b"\0")
    return (cache_root() or Path(os.devnull)) / _FOLDER / f"{digest.hexdigest()[:32]}.o"


def _read(place: Path) -> bytes | None:
    try:
        stored = place.read_bytes()
        os.utime(place)
    except OSError:
        return None
    code = stored[_DIGEST:]
    return code if hashlib.sha256(code).digest() == stored[:_DIGEST] else None  # LLVM crashes on a spoilt one


def _write(place: Path, code: bytes) -> None:
    """Keep ``code``, whole or not at all, and remove what was used longest ago."""
    with contextlib.suppress(OSError):
        place.parent.mkdir(parents=True, exist_ok=True)
        part = place.with_suffix(f".{os.getpid()}")
        part.write_bytes(hashlib.sha256(code).digest() + code)
        part.replace(place)
        old = sorted(place.parent.glob("*.o"), key=lambda path: path.stat().st_mtime, reverse=True)
        for each in old[4 * KEYS_KEPT :]:
            each.unlink()
