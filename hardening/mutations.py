"""Small changes of a Python module, each of which a test should notice.

A mutation replaces the text of one expression or statement and leaves the rest of the file as it is, so that
its difference is short. Left alone are docstrings, annotations, assertions, imports, f-strings (they are
messages) and patterns of ``match``.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

_COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_PAIRS = (("min", "max"), ("minimum", "maximum"), ("argmin", "argmax"), ("any", "all"), ("floor", "ceil"))
_OPPOSITE = {a: b for pair in _PAIRS for a, b in (pair, pair[::-1])}
_TINY = 1e-5
"""Floats below this are tolerances: twice or half of one is rarely another program, so it becomes 0."""


@dataclass(frozen=True, slots=True)
class Mutation:
    """One change of one module.

    Attributes:
        operator: Name of the kind of change.
        line: First line of the replaced text, from 1.
        lines: First and last line of the statement, or of its head, for the test coverage.
        start: First byte of the replaced text in the UTF-8 source.
        end: Byte after it.
        text: What stands there instead.
    """

    operator: str
    line: int
    lines: tuple[int, int]
    start: int
    end: int
    text: str

    def applied(self, source: str) -> str:
        """The source with this mutation."""
        data = source.encode()
        return (data[: self.start] + self.text.encode() + data[self.end :]).decode()

    def difference(self, source: str) -> str:
        """The lines before and after the change, each with its mark."""
        data = source.encode()
        begin = data.rfind(b"\n", 0, self.start) + 1
        end = data.find(b"\n", self.end)
        tail = data[self.end : end if end >= 0 else len(data)]
        after = data[begin : self.start] + self.text.encode() + tail
        before = data[begin : self.end] + tail
        marked = (("-", before), ("+", after))
        return "\n".join(mark + line for mark, text in marked for line in text.decode().splitlines())


def mutations(source: str) -> list[Mutation]:
    """Every mutation of a module, in the order of the text; each of them can be compiled.

    Args:
        source: Text of the module.
    """
    found = {(m.start, m.end, m.text): m for m in _Finder(source).found}
    # Where arguments stand in parentheses of their own, cutting one out may leave half a pair behind.
    every = [m for _, m in sorted(found.items())]
    return [m for m in every if m.operator != "argument removed" or _compiles(m.applied(source))]


def _compiles(source: str) -> bool:
    try:
        compile(source, "mutant", "exec", dont_inherit=True)
    except SyntaxError:
        return False
    return True


class _Finder(ast.NodeVisitor):
    """Walks over a module and collects its mutations."""

    def __init__(self, source: str) -> None:
        self.found: list[Mutation] = []
        self._starts = [0]
        for line in source.encode().splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._lines = (1, 1)
        self._bound: set[str] = set()
        self._in_function = False
        self.visit(ast.parse(source))

    # What is visited, and with which lines.

    def visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.stmt):
            body = getattr(node, "body", None)
            last = body[0].lineno - 1 if body else node.end_lineno or node.lineno
            self._lines = (node.lineno, max(node.lineno, last))
            self._statement(node)
        super().visit(node)

    def generic_visit(self, node: ast.AST) -> None:
        if isinstance(node, ast.expr):
            self._expression(node)
        if not isinstance(
            node, ast.Import | ast.ImportFrom | ast.Assert | ast.JoinedStr | ast.pattern | ast.arg
        ):
            for name, content in ast.iter_fields(node):
                if name in ("annotation", "returns", "decorator_list", "bases"):
                    continue
                for child in content if isinstance(content, list) else [content]:
                    if isinstance(child, ast.AST):
                        self.visit(child)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        outside, arguments = (self._bound, self._in_function), node.args
        self._in_function = True
        self._bound = {a.arg for a in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)}
        for default in (*arguments.defaults, *arguments.kw_defaults):
            self._word(default, "default")
        self.generic_visit(node)
        self._bound, self._in_function = outside

    # Changes of statements.

    def _statement(self, node: ast.stmt) -> None:
        match node:
            case ast.Expr(value=ast.Constant()):
                pass
            case ast.Expr() | ast.Raise() | ast.Continue() | ast.Break() | ast.AugAssign():
                self._add("statement removed", node, "pass")
            case ast.Return(value=ast.expr() as given):
                if not (isinstance(given, ast.Constant) and given.value is None):
                    self._add("return None", node, "return None")
            case ast.Assign(targets=[target]):
                names = {n.id for n in ast.walk(target) if isinstance(n, ast.Name)}
                # Where a name is new, every use of it would fail: that shows nothing.
                if names <= self._bound or isinstance(target, ast.Attribute | ast.Subscript):
                    self._add("statement removed", node, "pass")
                if not self._in_function and not isinstance(node.value, ast.Subscript):  # no Literal["…"]
                    self._words(node.value)
                self._bound |= names
            case ast.AnnAssign(value=ast.expr() as given):
                self._word(given, "default")
            case ast.If() | ast.While():
                self._negated(node.test)
            case _:
                pass

    # Changes of expressions.

    def _expression(self, node: ast.expr) -> None:
        match node:
            case ast.Constant():
                self._constant(node)
            case ast.Compare():
                self._compare(node)
            case ast.BinOp() if type(node.op) in _ARITHMETIC:
                self._changed("arithmetic", node, lambda n: setattr(n, "op", _ARITHMETIC[type(n.op)]()))
            case ast.BoolOp():
                other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
                self._changed("and/or", node, lambda n: setattr(n, "op", other))
            case ast.UnaryOp(op=ast.Not() | ast.USub() | ast.Invert()):
                self._add("sign or not removed", node, f"({ast.unparse(node.operand)})")
            case ast.IfExp():
                self._negated(node.test)
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                for test in (test for loop in node.generators for test in loop.ifs):
                    self._negated(test)
            case ast.Call():
                self._call(node)
            case ast.Subscript():
                for part in node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]:
                    self._index(part)
            case ast.Attribute() if node.attr in _OPPOSITE:
                self._changed("opposite", node, lambda n: setattr(n, "attr", _OPPOSITE[n.attr]))
            case ast.Name() if node.id in _OPPOSITE and node.id not in self._bound:
                self._changed("opposite", node, lambda n: setattr(n, "id", _OPPOSITE[n.id]))
            case _:
                pass

    def _constant(self, node: ast.Constant) -> None:
        number = node.value
        if isinstance(number, bool):
            self._add("constant", node, str(not number))
        elif isinstance(number, int):
            self._add("constant", node, str(number + 1))
            self._add("constant", node, str(number - 1) if number > 0 else f"({number - 1})")
        elif isinstance(number, float):
            others = (1.0,) if number == 0 else (0.0,) if number < _TINY else (2 * number, number / 2)
            for other in others:
                self._add("constant", node, repr(other))

    def _compare(self, node: ast.Compare) -> None:
        for place, op in enumerate(node.ops):
            for other in _COMPARISONS[type(op)]:
                ops = [*node.ops[:place], other(), *node.ops[place + 1 :]]
                self._changed("comparison", node, lambda n, ops=ops: setattr(n, "ops", ops))
        for side in (node.left, *node.comparators):
            for entry in side.elts if isinstance(side, ast.Tuple | ast.List | ast.Set) else [side]:
                self._word(entry, "string")

    def _call(self, node: ast.Call) -> None:
        given: list[ast.expr | ast.keyword] = [*node.args, *node.keywords]
        given.sort(key=self._start)
        for place, one in enumerate(given):
            if not isinstance(one, ast.keyword) or one.arg is None:
                continue
            start, end = self._start(one), self._end(one)
            if place:
                start = self._end(given[place - 1])  # with the comma before it
            elif len(given) > 1:
                end = self._start(given[1])
            self.found.append(Mutation("argument removed", one.lineno, self._lines, start, end, ""))

    def _index(self, part: ast.expr) -> None:
        if isinstance(part, ast.Name):
            self._add("index", part, f"{part.id} + 1")
        if not isinstance(part, ast.Slice) or (part.lower is None) == (part.upper is None):
            return
        if part.lower is None:
            self._changed("index", part, lambda n: setattr(n, "lower", ast.Constant(1)), around="")
        else:
            self._changed("index", part, lambda n: setattr(n, "upper", ast.Constant(-1)), around="")

    def _words(self, node: ast.AST) -> None:
        self._word(node, "string")
        if not isinstance(node, ast.JoinedStr):
            for child in ast.iter_child_nodes(node):
                self._words(child)

    def _word(self, node: ast.AST | None, operator: str) -> None:
        # Text with a space is a message.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            self._add(operator, node, repr(f"?{node.value}"))

    def _negated(self, test: ast.expr) -> None:
        # The opposite of a comparison, and of a negation, is among their own mutations.
        if isinstance(test, ast.Compare | ast.UnaryOp):
            return
        self._add("condition negated", test, f"(not ({ast.unparse(test)}))")

    # The text.

    def _changed(
        self, operator: str, node: ast.expr, change: Callable[[Any], object], around: str = "()"
    ) -> None:
        other = copy.deepcopy(node)
        change(other)
        text = ast.unparse(other)
        self._add(operator, node, f"({text})" if around else text)

    def _add(self, operator: str, node: ast.expr | ast.stmt, text: str) -> None:
        start, end = self._start(node), self._end(node)
        self.found.append(Mutation(operator, node.lineno, self._lines, start, end, text))

    def _start(self, node: ast.expr | ast.stmt | ast.keyword) -> int:
        return self._starts[node.lineno - 1] + node.col_offset

    def _end(self, node: ast.expr | ast.stmt | ast.keyword) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._starts[node.end_lineno - 1] + node.end_col_offset
