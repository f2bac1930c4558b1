"""Arithmetic of an untrusted file: expressions evaluated here, node by node, never by Python itself."""

from __future__ import annotations

import ast
import functools
import math
import operator
from collections.abc import Callable, Container, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

# A number, a truth value, a text, nothing, a list of these, a mapping to these, or a function of arithmetic.
Value: TypeAlias = Any

MOST_TEXT = 10_000  # characters of a text, and numbers in a list
MOST_DATA = 20_000  # values and characters of a mapping
_MOST_BITS = 1024  # of whole numbers: the range of a float
_MOST_WORK = 1_000_000  # values and characters that one expression goes through: less than a second
_BINARY: dict[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
    ast.FloorDiv: operator.floordiv,
    ast.Pow: operator.pow,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
}
_UNARY: dict[type[ast.unaryop], Callable[[Value], Value]] = {
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
    ast.Not: operator.not_,
    ast.Invert: operator.invert,
}
_COMPARE: dict[type[ast.cmpop], Callable[[Value, Value], bool]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Is: operator.is_,
    ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b,
    ast.NotIn: lambda a, b: a not in b,
}
_NODES = (
    ast.Expression,
    ast.Constant,
    ast.Name,
    ast.Load,
    ast.UnaryOp,
    ast.BinOp,
    ast.BoolOp,
    ast.And,
    ast.Or,
    ast.Compare,
    ast.IfExp,
    ast.Call,
    ast.keyword,
    ast.Subscript,
    ast.List,
    ast.Tuple,
    ast.Attribute,
    *_BINARY,
    *_UNARY,
    *_COMPARE,
)


# Python's own take minutes for a list of large whole numbers: these stop where the result is too large.
def _product(factors: Iterable[Value]) -> Value:
    return functools.reduce(lambda left, right: _bounded(left * right), factors, 1)


def _multiple(*numbers: Value) -> Value:
    return functools.reduce(lambda left, right: _bounded(math.lcm(left, right)), numbers, 1)


_MATH = {name: value for name, value in vars(math).items() if not name.startswith("_")}
_MATH |= {"prod": _product, "lcm": _multiple}
FUNCTIONS: dict[str, Value] = {
    **_MATH,
    "abs": abs,
    "min": min,
    "max": max,
    "round": round,
    "int": int,
    "float": float,
    "bool": bool,
    "len": len,
    "str": str,
    "True": True,
    "False": False,
}
# Methods that only look at a text or a mapping.
_METHODS: dict[type, dict[str, Callable[..., Value]]] = {
    str: {
        "split": str.split,
        "strip": str.strip,
        "lower": str.lower,
        "upper": str.upper,
        "startswith": str.startswith,
        "endswith": str.endswith,
    },
    dict: {
        "get": dict.get,
        "keys": lambda mapping: list(mapping.keys()),
        "values": lambda mapping: list(mapping.values()),
        "items": lambda mapping: [list(pair) for pair in mapping.items()],
    },
}
# Functions whose results grow faster than any other's, and the largest argument they may have.
_GROWING: dict[Callable[..., int], int] = {math.factorial: 170, math.comb: 1000, math.perm: 170, round: 400}


class NotArithmetic(ValueError):
    """An expression asks for more than arithmetic, or for numbers beyond all use."""


class NotPython(NotArithmetic):
    """An expression that Python cannot read."""


def parsed(expression: str) -> ast.Expression:
    """The expression as a tree of what is allowed; NotArithmetic where there is anything else."""
    if len(expression) > MOST_TEXT:
        raise NotArithmetic(f"expected an expression of at most {MOST_TEXT} characters")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotPython("expected an expression that Python can read") from None
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            raise NotArithmetic(f"only arithmetic is allowed, no {type(node).__name__}")
        if isinstance(node, ast.Name) and node.id.startswith("__"):
            raise NotArithmetic(f"the name {node.id} is not allowed")
        if isinstance(node, ast.Attribute) and node.attr.startswith("_"):
            raise NotArithmetic(f"the name {node.attr} is not allowed")
        if isinstance(node, ast.Attribute) and _is_math(node.value) and node.attr not in _MATH:
            raise NotArithmetic(f"math has no {node.attr}")
        if isinstance(node, ast.Call) and node.keywords and not _is_mapping(node):
            raise NotArithmetic("only arithmetic is allowed, no named arguments")
        if isinstance(node, ast.Constant) and not isinstance(node.value, bool | int | float | str | None):
            raise NotArithmetic(f"only numbers and texts are allowed, not {node.value!r}")
        # Texts are for comparing and joining; nothing may be assembled that reads like another expression.
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and ("$" in node.value or "%" in node.value):
            raise NotArithmetic("no text with '$' or '%' is allowed")
    return tree


def names(tree: ast.AST, known: Container[str] = ()) -> set[str]:
    """Names that an expression uses, but for calls of the functions ``known``, as ``load`` or ``yaml.load``."""
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    called = [node.func for node in calls if _dotted(node.func) in known or _is_mapping(node)]
    fine = {id(one.value if isinstance(one, ast.Attribute) else one) for one in called}
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and id(node) not in fine}


def evaluate(
    expression: str, names: Mapping[str, Value], functions: Mapping[str, Callable[..., Value]] = MappingProxyType({})
) -> Value:
    """The value of an expression: a number, a truth value, a text, or a list of or a mapping to these.

    Args:
        names: values of the names that it may use, beside Python's and ``math``'s functions.
        functions: others that it may call, by name, as ``load`` or ``yaml.load``.

    Raises:
        NotArithmetic: it asks for more. NameError, TypeError, ZeroDivisionError...: what Python raises for it.
    """
    return _Evaluation(names, functions).value(parsed(expression).body)


def _is_mapping(node: ast.Call) -> bool:
    """Whether a call is ``dict(name=value, ...)``."""
    called = isinstance(node.func, ast.Name) and node.func.id == "dict"
    return called and not node.args and all(one.arg for one in node.keywords)


def _is_math(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "math"


def _dotted(node: ast.expr) -> str:
    """A name, or a name in a namespace; "" for anything else."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        return f"{node.value.id}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


class _Evaluation:
    """An expression with the names and functions that it may use, and how much it has gone through so far."""

    def __init__(self, names: Mapping[str, Value], functions: Mapping[str, Callable[..., Value]]):
        self.names, self.functions = names, functions
        self.work = 0

    def value(self, node: ast.expr) -> Value:
        """The value of a part of the expression, of a kind and size that it may have; NotArithmetic for too much work.

        What is done with values takes no longer than to go through them, so that their sizes bound the time.
        """
        value = _bounded(self._value(node))
        self.work += 1 + size_of(value)
        if self.work > _MOST_WORK:
            raise NotArithmetic(f"it goes through more than {_MOST_WORK} values and characters")
        return value

    def _value(self, node: ast.expr) -> Value:
        if isinstance(node, ast.Constant):
            return node.value
        if isinstance(node, ast.Name):
            return _named(node.id, self.names)
        if isinstance(node, ast.Attribute):
            return _MATH[node.attr] if _is_math(node.value) else _item(self.value(node.value), node.attr)
        if isinstance(node, ast.UnaryOp):
            return _UNARY[type(node.op)](self.value(node.operand))
        if isinstance(node, ast.BinOp):
            return _binary(type(node.op), self.value(node.left), self.value(node.right))
        if isinstance(node, ast.BoolOp):
            for one in node.values:
                value = self.value(one)
                if bool(value) != isinstance(node.op, ast.And):
                    break
            return value
        if isinstance(node, ast.Compare):
            return self._compared(node)
        if isinstance(node, ast.IfExp):
            return self.value(node.body if self.value(node.test) else node.orelse)
        if isinstance(node, ast.Subscript):
            return self.value(node.value)[self.value(node.slice)]
        if isinstance(node, ast.List | ast.Tuple):
            return [self.value(one) for one in node.elts]
        if isinstance(node, ast.Call) and _is_mapping(node):
            made = {str(one.arg): self.value(one.value) for one in node.keywords}
            if size_of(made) > MOST_TEXT:
                raise NotArithmetic(f"a mapping of more than {MOST_TEXT} is too large")
            return made
        if isinstance(node, ast.Call):
            return self._called(node.func, [self.value(one) for one in node.args])
        raise NotArithmetic(f"only arithmetic is allowed, no {type(node).__name__}")

    def _compared(self, node: ast.Compare) -> bool:
        left = self.value(node.left)
        for kind, other in zip(node.ops, node.comparators):
            right = self.value(other)
            if not _COMPARE[type(kind)](left, right):
                return False
            left = right
        return True

    def _called(self, function: ast.expr, arguments: list[Value]) -> Value:
        name = _dotted(function)
        if name in self.functions and name.split(".")[0] not in self.names:
            return self.functions[name](*arguments)
        if isinstance(function, ast.Attribute) and not _is_math(function.value):
            of = self.value(function.value)
            method = _METHODS.get(type(of), {}).get(function.attr)
            if method is None:
                raise NotArithmetic(f"only arithmetic is allowed, no '{function.attr}' of a {type(of).__name__}")
            return method(of, *arguments)
        return _called(self.value(function), arguments)


def _item(mapping: Value, key: str) -> Value:
    """What a mapping has under a name."""
    if type(mapping) is not dict:
        raise NotArithmetic(f"only arithmetic is allowed, no '{key}' of a {type(mapping).__name__}")
    if key not in mapping:
        raise KeyError(f"no '{key}' among {', '.join(map(str, mapping))}"[:300])
    return mapping[key]


def _named(name: str, names: Mapping[str, Value]) -> Value:
    if name in names:
        return names[name]
    if name in FUNCTIONS:
        return FUNCTIONS[name]
    raise NameError(f"name '{name}' is not defined")


def _binary(kind: type[ast.operator], left: Value, right: Value) -> Value:
    numbers = isinstance(left, int | float) and isinstance(right, int | float)
    if not numbers and kind is not ast.Add:
        if kind is not ast.Mult or not isinstance(right if isinstance(left, str | list) else left, int):
            raise TypeError(f"expected numbers, got {type(left).__name__} and {type(right).__name__}")
        count, repeated = (right, left) if isinstance(left, str | list) else (left, right)
        if count * size_of(repeated) > MOST_TEXT:
            raise NotArithmetic(f"a text or list of more than {MOST_TEXT} is too long")
    if isinstance(left, int) and isinstance(right, int):
        bits = right * (left.bit_length() - 1) if kind is ast.Pow else right if kind is ast.LShift else 0
        if bits > _MOST_BITS and left:
            raise _too_large()
    result = _BINARY[kind](left, right)
    if isinstance(result, complex):
        raise ValueError("a root of a negative number")
    return result


def _called(function: Value, arguments: list[Value]) -> Value:
    if not any(function is one for one in FUNCTIONS.values()) or not callable(function):
        raise NotArithmetic("only functions of arithmetic can be called")
    most = _GROWING.get(function)
    if most is not None:
        limited = arguments[1:] if function is round else arguments
        if any(isinstance(one, int) and abs(one) > most for one in limited):
            raise NotArithmetic(f"{function.__name__} of more than {most} is too large")
    return function(*arguments)


def _bounded(value: Value) -> Value:
    """The value, where it is of a kind and size that expressions may have."""
    if isinstance(value, tuple):
        value = list(value)
    if isinstance(value, int) and not isinstance(value, bool) and value.bit_length() > _MOST_BITS:
        raise _too_large()
    if isinstance(value, str | list) and size_of(value) > MOST_TEXT:
        raise NotArithmetic(f"a text or list of more than {MOST_TEXT} is too long")
    # The size of a mapping is bounded as it is made.
    known = value is None or isinstance(value, int | float | str | list) or type(value) is dict
    if not known and not any(value is one for one in FUNCTIONS.values()):
        raise NotArithmetic(f"expected a number, a text, a list or a mapping, got {type(value).__name__}")
    return value


def _too_large() -> NotArithmetic:
    return NotArithmetic(f"a whole number of more than {_MOST_BITS} bits is too large")


def size_of(value: Value) -> int:
    """Characters of a text, or values in a list or mapping and in those in it, counted no further than to beyond the
    limits.
    """
    if isinstance(value, str):
        return len(value)
    waiting, size = [value], 0
    while waiting and size <= MOST_DATA:
        one = waiting.pop()
        if isinstance(one, list):
            size += 1 + len(one)
            waiting += one[: MOST_DATA + 1]
        elif type(one) is dict:
            size += 1 + 2 * len(one)
            waiting += [*one.keys(), *one.values()]
        elif isinstance(one, str):
            size += len(one)
    return size
