"""An interpreter for URScript, the language of Universal Robots controllers.

:func:`compile_program` turns a script into a :class:`Program` (lexer, parser, Python source,
byte code); ``crtk_sim_backends.ur.program.ProgramRuntime`` runs it, one step per control period.
"""

from crtk_sim_backends.ur.urscript.compiler import Program, compile_program
from crtk_sim_backends.ur.urscript.errors import (
    CompileError,
    Halt,
    ScriptError,
    ScriptRuntimeError,
)
from crtk_sim_backends.ur.urscript.library import PURE_BUILTINS, timing_builtins
from crtk_sim_backends.ur.urscript.values import Builtin, List, Pose, copy_value, to_text

__all__ = [
    "PURE_BUILTINS",
    "Builtin",
    "CompileError",
    "Halt",
    "List",
    "Pose",
    "Program",
    "ScriptError",
    "ScriptRuntimeError",
    "compile_program",
    "copy_value",
    "timing_builtins",
    "to_text",
]
