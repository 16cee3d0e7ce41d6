"""Machine code of the kernel that is kept on disk and runs without Numba.

Numba needs about a second to get ready, even if all that it has to do is to load what it
compiled before. So the functions that Python calls are compiled once, by Numba, to an object
file that needs the C library and nothing else; llvmlite, the part of Numba that knows LLVM,
loads it in milliseconds. The code runs without the GIL.
"""

from __future__ import annotations

import ctypes
import hashlib
import struct
import threading
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.metadata import version
from typing import Any

import numpy as np

from . import _compile
from ._native_call import Signature, receiver, sender

# What an object file may ask of the process: C's mathematics and moves of memory. Anything
# else means that the code allocates or raises, for which it needs Numba.
_C_LIBRARY = {
    "acos",
    "acosh",
    "asin",
    "asinh",
    "atan",
    "atan2",
    "atanh",
    "cbrt",
    "ceil",
    "cos",
    "cosh",
    "erf",
    "erfc",
    "exp",
    "exp2",
    "expm1",
    "fabs",
    "floor",
    "fma",
    "fmax",
    "fmin",
    "fmod",
    "hypot",
    "log",
    "log10",
    "log1p",
    "log2",
    "memcpy",
    "memmove",
    "memset",
    "pow",
    "rint",
    "round",
    "sin",
    "sincos",
    "sinh",
    "sqrt",
    "tan",
    "tanh",
    "trunc",
}


class Entry:
    """A compiled function that Python calls; made by `Library.entry`."""

    def __init__(self, library: Library, module: str, name: str, signature: Signature) -> None:
        self.library = library
        self.module = module
        self.name = name
        self.signature = signature
        self._call: Callable[..., Any] | None = None

    def __call__(self, *arguments: Any) -> Any:
        """Call the function, loaded or compiled on the first call."""
        if self._call is None:
            self._call = self._made()
        return self._call(*arguments)

    def dispatcher(self) -> Any:
        """Return the function as Numba calls it."""
        function = getattr(import_module(f".{self.module}", __package__), self.name)
        if not isinstance(function, _compile.Compiled):
            function = _compile.compiled(function)
        return function.dispatcher

    def _made(self) -> Callable[..., Any]:
        address = self.library.address(self.name)
        if address is None:
            dispatcher: Callable[..., Any] = self.dispatcher()
            return dispatcher
        pointers = [ctypes.c_void_p] * len(self.signature.arrays)
        prototype = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_char_p, *pointers, ctypes.c_void_p)
        names = {
            "function": prototype(address),
            "pack": struct.Struct(f"{self.signature.numbers}d").pack,
            "pointer": (ctypes.c_char * 0).from_buffer,  # refuses what is not C-contiguous
            "space": ctypes.c_double * self.signature.results,
            "returns": self.signature.returns,
            "float64": np.dtype(np.float64),
            "int64": np.dtype(np.int64),
        }
        exec(sender(self.signature), names)
        call: Callable[..., Any] = names["send"]
        return call


class Library:
    """Functions that are compiled together, to one object file.

    Only functions that neither allocate nor raise make an object file; if one of them does,
    they all are left to Numba.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.entries: list[Entry] = []
        self._lock = threading.Lock()
        self._engine: Any = None  # holds the machine code in memory
        self._is_loaded = False

    def entry(self, module: str, name: str, *parameters: Any, returns: Any = None) -> Entry:
        """Add a function.

        Parameters
        ----------
        module, name : str
            Module of the package, and function in it, compiled or not.
        parameters : type
            ``float``, ``int``, a NamedTuple of those and ``bool``, or an `Array`.
        returns : type
            ``int``, ``None``, or a NamedTuple of ``float`` and ``int``.
        """
        self.entries.append(Entry(self, module, name, Signature(parameters, returns)))
        return self.entries[-1]

    def address(self, name: str) -> int | None:
        """Address of a function; None if it needs Numba."""
        with self._lock:
            if not self._is_loaded:
                try:
                    self._engine = self._made()
                except (AttributeError, RuntimeError) as error:  # of a llvmlite not known here
                    warnings.warn(
                        f"the compiled plant cannot be kept on disk with llvmlite "
                        f"{version('llvmlite')} ({error}): each process compiles it anew",
                        RuntimeWarning,
                        stacklevel=2,
                    )
                self._is_loaded = True
            if self._engine is None:
                return None
            address: int = self._engine.get_function_address(name)
            return address

    def _made(self) -> Any:
        """Load the machine code, compiled first if it is not on disk; None if it needs Numba."""
        file = f"{self.name}-{_target_key()}.o"
        code = _compile.read(file)
        if code is None:
            code = self.object_code()
            _compile.store(file, code)
        return _loaded(code) if code else None

    def object_code(self) -> bytes:
        """Compile; empty if the code needs more than the C library."""
        numba: Any = import_module("numba")
        llvm, types = _llvm(), numba.types

        number = types.CPointer(types.float64)
        unit = llvm.parse_assembly("")
        for entry in self.entries:
            pointers = [types.CPointer(getattr(types, a.dtype)) for a in entry.signature.arrays]
            names = {"function": entry.dispatcher(), "carray": numba.carray}
            names |= {f"type_{i}": kind for i, kind in enumerate(entry.signature.parameters)}
            exec(receiver(entry.signature), names)
            # Numba infers every type: an entry that is described wrongly does not compile.
            c_type = types.int64(number, *pointers, number)
            function = numba.cfunc(c_type, error_model="numpy")(names["receive"])
            part = llvm.parse_assembly(function.inspect_llvm())
            part.get_function(function.native_name).name = entry.name
            unit.link_in(part)
        wanted = {entry.name for entry in self.entries}
        for item in (*unit.functions, *unit.global_variables):
            if not item.is_declaration and item.name not in wanted:
                item.linkage = "internal"
        machine = _machine()
        builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(3))
        builder.getModulePassManager().run(unit, builder)  # drops what nothing reaches any more
        items = (*unit.functions, *unit.global_variables)
        needed = {item.name for item in items if item.is_declaration}
        needed = {name for name in needed if not name.startswith("llvm.")}
        return machine.emit_object(unit) if needed <= _C_LIBRARY else b""


def _llvm() -> Any:
    return import_module("llvmlite.binding")  # only when it is needed


def _loaded(code: bytes) -> Any:
    llvm = _llvm()
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return engine


def _machine() -> Any:
    """Return LLVM's description of this processor."""
    llvm = _llvm()
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="default",
        codemodel="jitdefault",
        jit=True,
    )


@cache
def _target_key() -> str:
    """Name of what object code depends on besides its source."""
    llvm = _llvm()
    target = (
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        llvm.get_host_cpu_features().flatten(),
        version("numba"),
        version("llvmlite"),
    )
    return hashlib.sha256("\n".join(target).encode()).hexdigest()[:16]
