"""Machine code made once for each function that Python calls, not for every function that it calls in turn.

Numba optimises each compiled function by itself and makes machine code of it, then links that into its caller, which
is optimised with it anew, and so on up to the function that Python calls: a car's wrench is optimised once on every
level above it, and the body of a parallel loop four times.  Here a function's intermediate code waits.  Only where its
address is asked for, or it is to be saved, is all that it calls linked into it, each function once; then the whole is
optimised and made into machine code.  What runs is the same, and is compiled in about half the time.

Two further things make compiling faster.  Python looks seldom for garbage, of which compiling makes little.  And of
LLVM's two parts, that which writes machine code works at its second level: its third makes nothing faster here, while
the passes over the intermediate code need theirs.

An operation that may raise, such as an index into a constant tuple, can keep numba's counting of references to all
arrays of the function that it is linked into: the calls of NRT_incref in its intermediate code show it.
"""

# mypy: disable-error-code="no-untyped-call,attr-defined"
# numba's methods have no types, or declare less than they do

import gc
from typing import Any

from numba.core import event
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import lookup_environment
from numba.core.registry import cpu_target

# as numba names them: variables for what a function needs of Python, and the bodies of parallel loops
_ENVIRONMENT, _LOOP_BODY = "_ZN08NumbaEnv", "__numba_parfor_gufunc"
CODE_GENERATION = 2  # LLVM's level of optimisation there
# thresholds of Python's garbage collector while numba compiles: it makes millions of objects that stay
_SELDOM = (50_000, 50, 1000)


def _callers_first(library: Any) -> list[Any]:
    """All libraries whose code `library` needs, each once and after all that call it.

    LLVM links a function only if something that is linked already calls it.
    """
    seen, callees_first = {id(library)}, []

    def visit(callee: Any) -> None:
        """Append what `callee` calls, then `callee`."""
        if id(callee) in seen:
            return
        seen.add(id(callee))
        # machine code has all that it calls in it
        if isinstance(callee, LateLibrary) and not callee.has_machine_code:
            for further in reversed(callee.called):
                visit(further)
        callees_first.append(callee)

    for callee in reversed(library.called):
        visit(callee)
    return callees_first[::-1]


class LateLibrary(JITCodeLibrary):
    """The code of one compiled function, not optimised before its machine code is needed."""

    @property
    def called(self) -> list[Any]:
        """The libraries of the functions that this one calls itself."""
        return list(self._linking_libraries)

    @property
    def has_machine_code(self) -> bool:
        """Whether machine code has been made."""
        return bool(self._finalized)

    def finalize(self) -> None:
        """Nothing yet: numba asks for it as soon as a function is written."""

    def _ensure_finalized(self) -> None:
        """Nothing: as it is, the code can be linked into a caller's."""

    def add_linking_library(self, library: Any) -> None:
        """Remember that this code calls that of `library`."""
        self._linking_libraries.append(library)

    def _make_machine_code(self) -> None:
        """Link, optimise and translate this code with all that it calls, unless that is done already."""
        if self._finalized:
            return
        self._linking_libraries = _callers_first(self)
        super().finalize()
        for variable in self._final_module.global_variables:
            environment = lookup_environment(variable.name) if variable.name.startswith(_ENVIRONMENT) else None
            if environment is not None:
                self._codegen.set_env(variable.name, environment)

    def get_pointer_to_function(self, name: str) -> int:
        """Address of the machine code of the function `name`, made now; 0 where Python has no way to call it.

        So it is for a function compiled without a wrapper for Python, and for the body of a parallel loop.
        """
        if not self._finalized and (_LOOP_BODY in self.name or not self._defines(name)):
            return 0
        self._make_machine_code()
        return int(super().get_pointer_to_function(name))

    def _defines(self, name: str) -> bool:
        """Whether the code of the function `name` is part of this code."""
        try:
            return not self._final_module.get_function(name).is_declaration
        except NameError:
            return False

    @property
    def has_dynamic_globals(self) -> bool:
        """Whether the code holds addresses that are no longer right in another process."""
        self._make_machine_code()
        return bool(self._dynamic_globals)

    def serialize_using_object_code(self) -> Any:
        """Machine code and intermediate code, for numba's cache on disk."""
        self._make_machine_code()
        return super().serialize_using_object_code()


class LateCodegen(JITCPUCodegen):
    """Numba's generator of machine code for this processor, with late libraries."""

    _library_class = LateLibrary

    def _customize_tm_options(self, options: dict[str, Any]) -> None:
        """Write the `options` with which LLVM turns optimised intermediate code into machine code."""
        super()._customize_tm_options(options)
        options["opt"] = CODE_GENERATION

    def set_env(self, env_name: str, env: Any) -> None:
        """Connect code with what it needs of Python, if it is machine code yet; else that is done once it is."""
        if self._engine.is_symbol_defined(env_name):
            super().set_env(env_name, env)


class _SeldomCollections(event.Listener):
    """Lets Python's garbage collector run seldom while numba compiles, functions within functions."""

    def __init__(self) -> None:
        self._begun, self._usual = 0, gc.get_threshold()

    def on_start(self, event: Any) -> None:
        """Raise the thresholds as the outermost function begins."""
        if self._begun == 0:
            self._usual = gc.get_threshold()
            gc.set_threshold(*_SELDOM)
        self._begun += 1

    def on_end(self, event: Any) -> None:
        """Restore the thresholds as the outermost function ends."""
        self._begun -= 1
        if self._begun == 0:
            gc.set_threshold(*self._usual)


def install_late_code() -> None:
    """Let numba make machine code late, in this process and for all functions that it compiles from now on."""
    context = cpu_target.target_context
    if not isinstance(context.codegen(), LateCodegen):
        context._internal_codegen = LateCodegen("bcid")
        event.register("numba:compile", _SeldomCollections())
