"""An interpreter for URScript, the language of Universal Robots controllers.

:func:`compile_program` turns a script into a :class:`Program` (lexer, parser, Python source,
byte code); ``crtk_sim_backends.ur.program.running.ProgramRuntime`` runs it, one step per control period.
"""

from crtk_sim_backends.ur.urscript.compiler import Program, compile_program
from crtk_sim_backends.ur.urscript.errors import (
    CompileError,
    Halt,
    ScriptError,
    ScriptRuntimeError,
)
from crtk_sim_backends.ur.urscript.library import PURE_BUILTINS, timing_builtins
from crtk_sim_backends.ur.urscript.manual import Dialect, available, dialect_of
from crtk_sim_backends.ur.urscript.statements import Enclosing, Statement, Statements
from crtk_sim_backends.ur.urscript.values import (
    Builtin,
    Handle,
    List,
    Pose,
    Struct,
    copy_value,
    to_text,
)

__all__ = [
    "PURE_BUILTINS",
    "Builtin",
    "CompileError",
    "Dialect",
    "Enclosing",
    "Halt",
    "Handle",
    "List",
    "Pose",
    "Program",
    "ScriptError",
    "ScriptRuntimeError",
    "Statement",
    "Statements",
    "Struct",
    "available",
    "compile_program",
    "copy_value",
    "dialect_of",
    "timing_builtins",
    "to_text",
]
