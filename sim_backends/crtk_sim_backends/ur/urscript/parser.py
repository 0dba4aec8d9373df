"""Tokens to the syntax tree, by recursive descent."""

from __future__ import annotations

import math
from typing import cast

from crtk_sim_backends.ur.urscript import syntax
from crtk_sim_backends.ur.urscript.errors import CompileError
from crtk_sim_backends.ur.urscript.lexer import Token, source_line, tokenize
from crtk_sim_backends.ur.urscript.values import INTEGER_LIMIT

NESTING_LIMIT = 60
"""How deep blocks and expressions may be nested; it keeps every recursion over them short."""

# How tight an operator binds; `and`, `or` and `xor` are weaker than `not`, comparisons stronger.
_BINDING = {"or": 1, "xor": 1, "and": 2} | dict.fromkeys(("==", "!=", "<", ">", "<=", ">="), 4)
_BINDING |= {"+": 5, "-": 5, "*": 6, "/": 6, "%": 6}
_NOT_BINDING = 3
_SIGN_BINDING = 7

_INTEGER_DIGITS = 18
_LITERALS = (syntax.Number, syntax.Text, syntax.Boolean)
_TARGETS = (syntax.Name, syntax.Index, syntax.Member)

_WORDS = frozenset({"break", "continue", "halt", "pass", "enter_critical", "exit_critical"})
_LOOP_WORDS = frozenset({"break", "continue"})


def parse(text: str) -> syntax.Block:
    """Return the top-level statements of a script.

    :raises CompileError: the text is not URScript; line and column are those of the first word
        that cannot stand where it stands.
    """
    return _Parser(text).program()


class _Parser:
    def __init__(self, text: str) -> None:
        self._text = text
        self._tokens = tokenize(text)
        self._position = 0
        self._token = self._tokens[0]
        self._nesting = 0
        self._loops = 0

    # words

    def _error(self, token: Token) -> CompileError:
        return CompileError.syntax(source_line(self._text, token.line), token.line, token.column)

    def _advance(self) -> Token:
        token = self._token
        if token.kind != "end":
            self._position += 1
            self._token = self._tokens[self._position]
        return token

    def _at(self, word: str) -> bool:
        return self._token.text == word and self._token.kind != "string"

    def _accept(self, word: str) -> bool:
        if self._at(word):
            self._advance()
            return True
        return False

    def _expect(self, word: str) -> None:
        if not self._accept(word):
            raise self._error(self._token)

    def _name(self) -> Token:
        if self._token.kind != "name":
            raise self._error(self._token)
        return self._advance()

    def _enter(self) -> None:
        self._nesting += 1
        if self._nesting > NESTING_LIMIT:
            raise self._error(self._token)

    # statements

    def program(self) -> syntax.Block:
        statements = []
        while self._token.kind != "end":
            statements.append(self._statement())
        return tuple(statements)

    def _block(self) -> syntax.Block:
        """Parse statements up to, without, the word that ends them: end, elif or else."""
        self._expect(":")
        self._enter()
        statements = []
        while not (self._at("end") or self._at("elif") or self._at("else")):
            statements.append(self._statement())
        self._nesting -= 1
        return tuple(statements)

    def _closed_block(self) -> syntax.Block:
        body = self._block()
        self._expect("end")
        return body

    def _statement(self) -> syntax.Statement:
        token = self._token
        if token.kind == "keyword":
            word = token.text
            if word in ("def", "sec", "thread"):
                return self._function()
            if word == "if":
                return self._if()
            if word == "while":
                return self._while()
            if word == "return":
                return self._return()
            if word in ("local", "global"):
                return self._declaration()
            if word in ("kill", "join"):
                self._advance()
                control = cast(syntax.ThreadWord, word)
                return syntax.ThreadControl(control, self._expression(), token.line, token.column)
            if word in _WORDS:
                if word in _LOOP_WORDS and not self._loops:
                    raise self._error(token)
                self._advance()
                return syntax.Word(word, token.line, token.column)
        elif token.kind == "operator" and token.text == "$":
            return self._label()
        value = self._expression()
        if not self._at("="):
            return syntax.Evaluate(value, token.line, token.column)
        if not isinstance(value, _TARGETS) or not isinstance(syntax.root(value), syntax.Name):
            raise self._error(self._token)
        self._advance()
        return syntax.Assign("", value, self._expression(), token.line, token.column)

    def _function(self) -> syntax.Function:
        start = self._advance()
        name = self._name().text
        parameters = self._parameters()
        loops, self._loops = self._loops, 0
        body = self._closed_block()
        self._loops = loops
        kind = cast(syntax.Kind, start.text)
        return syntax.Function(kind, name, parameters, body, start.line, start.column)

    def _parameters(self) -> tuple[syntax.Parameter, ...]:
        self._expect("(")
        parameters: dict[str, syntax.Parameter] = {}
        optional = False
        while not self._at(")"):
            token = self._name()
            default = self._expression() if self._accept("=") else None
            if token.text in parameters or (optional and default is None):
                raise self._error(token)
            optional = default is not None
            parameters[token.text] = syntax.Parameter(token.text, default)
            if not self._accept(","):
                break
        self._expect(")")
        return tuple(parameters.values())

    def _if(self) -> syntax.If:
        start = self._token
        arms: list[tuple[syntax.Expression, syntax.Block]] = []
        otherwise: syntax.Block = ()
        while self._accept("if" if not arms else "elif"):
            condition = self._expression()
            arms.append((condition, self._block()))
        if self._accept("else"):
            otherwise = self._block()
        self._expect("end")
        return syntax.If(tuple(arms), otherwise, start.line, start.column)

    def _while(self) -> syntax.While:
        start = self._advance()
        condition = self._expression()
        self._loops += 1
        body = self._closed_block()
        self._loops -= 1
        return syntax.While(condition, body, start.line, start.column)

    def _return(self) -> syntax.Return:
        """Parse ``return``: its value, if any, begins on the same line."""
        start = self._advance()
        bare = self._token.line != start.line or self._token.text in ("end", "elif", "else", "")
        return syntax.Return(None if bare else self._expression(), start.line, start.column)

    def _declaration(self) -> syntax.Assign:
        start = self._advance()
        token = self._name()
        target = syntax.Name(token.text, token.line, token.column)
        value = self._expression() if self._accept("=") else None
        scope = cast(syntax.Qualifier, start.text)
        return syntax.Assign(scope, target, value, start.line, start.column)

    def _label(self) -> syntax.Word:
        """Parse a program label as PolyScope writes them: ``$ 3 "Waypoint 7" "noBreak"``."""
        start = self._advance()
        if self._token.kind != "number":
            raise self._error(self._token)
        self._advance()
        while self._token.kind == "string":
            self._advance()
        return syntax.Word("pass", start.line, start.column)

    # expressions

    def _expression(self, weakest: int = 1) -> syntax.Expression:
        self._enter()
        token = self._token
        left: syntax.Expression
        if self._accept("not") or self._accept("!"):
            operand = self._expression(_NOT_BINDING)
            left = syntax.Unary("not", operand, token.line, token.column)
        elif self._accept("-"):
            operand = self._expression(_SIGN_BINDING)
            left = syntax.Unary("-", operand, token.line, token.column)
        elif self._accept("+"):
            left = self._expression(_SIGN_BINDING)
        else:
            left = self._postfix()
        while (operator := self._token).kind in ("operator", "keyword"):
            binding = _BINDING.get(operator.text, 0)
            if binding < weakest:
                break
            if operator.text in ("and", "or"):
                operands = [left]
                while self._accept(operator.text):
                    operands.append(self._expression(binding + 1))
                left = syntax.Logical(operator.text, tuple(operands), left.line, left.column)
            else:
                self._advance()
                right = self._expression(binding + 1)
                left = syntax.Binary(operator.text, left, right, left.line, left.column)
        self._nesting -= 1
        return left

    def _postfix(self) -> syntax.Expression:
        value = self._atom()
        while not isinstance(value, _LITERALS):
            if self._accept("["):
                value = syntax.Index(value, self._indices(), value.line, value.column)
            elif self._accept("."):
                value = self._member(value)
            else:
                break
        return value

    def _member(self, value: syntax.Expression) -> syntax.Expression:
        if self._token.kind not in ("name", "keyword"):  # there are members named sec
            raise self._error(self._token)
        name = self._advance().text
        if not self._at("("):
            return syntax.Member(value, name, value.line, value.column)
        arguments, keywords = self._arguments()
        return syntax.MethodCall(value, name, arguments, keywords, value.line, value.column)

    def _indices(self) -> tuple[syntax.Expression, ...]:
        if self._at("]"):
            raise self._error(self._token)
        return self._items("]")

    def _atom(self) -> syntax.Expression:
        token = self._advance()
        line, column = token.line, token.column
        if token.kind == "name":
            if self._at("("):
                return self._call(token)
            if token.text == "p" and self._at("["):
                return self._pose_or_index(token)
            return syntax.Name(token.text, line, column)
        if token.kind == "number":
            return self._number(token)
        if token.kind == "string":
            return syntax.Text(token.text[1:-1], line, column)
        if token.text in ("True", "False"):
            return syntax.Boolean(token.text == "True", line, column)
        if token.text == "run":
            return syntax.Run(self._call(self._name()), line, column)
        if token.text == "(":
            value = self._expression()
            self._expect(")")
            return value
        if token.text == "[":
            return syntax.ListLiteral(self._items("]"), False, line, column)
        raise self._error(token)

    def _number(self, token: Token) -> syntax.Number:
        """Read a number; a decimal integer too long for 64 bits counts as floating-point."""
        text = token.text
        value: int | float
        if text[:2] in ("0x", "0X"):
            value = int(text, 16)
        elif text.isdigit() and len(text) <= _INTEGER_DIGITS:
            value = int(text)
        else:
            value = float(text)
        if value == math.inf or (isinstance(value, int) and value >= INTEGER_LIMIT):
            raise self._error(token)
        return syntax.Number(value, token.line, token.column)

    def _pose_or_index(self, token: Token) -> syntax.Expression:
        """Parse ``p[``: six items make a pose, fewer index a variable named p."""
        self._advance()
        items = self._items("]")
        if len(items) == 6:
            return syntax.ListLiteral(items, True, token.line, token.column)
        if not items:
            raise self._error(token)
        variable = syntax.Name(token.text, token.line, token.column)
        return syntax.Index(variable, items, token.line, token.column)

    def _items(self, closing: str) -> tuple[syntax.Expression, ...]:
        items = []
        while not self._at(closing):
            items.append(self._expression())
            if not self._accept(","):
                break
        self._expect(closing)
        return tuple(items)

    def _call(self, name: Token) -> syntax.Call:
        arguments, keywords = self._arguments()
        return syntax.Call(name.text, arguments, keywords, name.line, name.column)

    def _arguments(
        self,
    ) -> tuple[tuple[syntax.Expression, ...], tuple[tuple[str, syntax.Expression], ...]]:
        """Parse ``(a, b, key=c)``: the positional ones, then those with a name."""
        self._expect("(")
        arguments: list[syntax.Expression] = []
        keywords: dict[str, syntax.Expression] = {}
        while not self._at(")"):
            token = self._token
            value = self._expression()
            if self._at("=") and isinstance(value, syntax.Name) and token.text not in keywords:
                self._advance()
                keywords[token.text] = self._expression()
            elif keywords:
                raise self._error(token)
            else:
                arguments.append(value)
            if not self._accept(","):
                break
        self._expect(")")
        return tuple(arguments), tuple(keywords.items())
