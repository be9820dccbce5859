"""Formulas: of x, y and z for initial fields, such as ``sin(2*pi*x)*cos(2*pi*y)``, of t for forces and walls.

A formula is parsed by Python's own parser and then every node of the tree must be on a short list, so
a case file cannot run code. Numbers become float64 before anything is computed with them: a tower of
powers overflows to infinity, which is refused, instead of filling the memory with digits.
"""

from __future__ import annotations

import ast
import math
import warnings
from functools import lru_cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

MAX_LENGTH = 2000  # characters
MAX_DEPTH = 100  # nested operations; a sum of n terms is n - 1 deep
CONSTANTS = {"pi": math.pi, "e": math.e}
# name -> (numpy function, number of arguments)
FUNCTIONS = {
    "sin": ("sin", 1),
    "cos": ("cos", 1),
    "tan": ("tan", 1),
    "asin": ("arcsin", 1),
    "acos": ("arccos", 1),
    "atan": ("arctan", 1),
    "atan2": ("arctan2", 2),
    "sinh": ("sinh", 1),
    "cosh": ("cosh", 1),
    "tanh": ("tanh", 1),
    "exp": ("exp", 1),
    "log": ("log", 1),
    "sqrt": ("sqrt", 1),
    "abs": ("abs", 1),
    "sign": ("sign", 1),
    "min": ("minimum", 2),
    "max": ("maximum", 2),
    "where": ("where", 3),
}
OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "add",
    ast.Sub: "subtract",
    ast.Mult: "multiply",
    ast.Div: "divide",
    ast.Pow: "power",
    ast.UAdd: "positive",
    ast.USub: "negative",
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Gt: "greater",
    ast.GtE: "greater_equal",
}


class ExpressionError(ValueError):
    """A formula that cannot be read, or that has no finite value somewhere."""


def check(expression: str, variables: tuple[str, ...] = ("x", "y", "z")) -> None:
    """Raise `ExpressionError` unless `expression` is a formula of `variables`; needs no numpy."""
    _check_node(_parse(expression), variables, depth=0)


def evaluate(expression: str, **variables: Any) -> np.ndarray:
    """Value of a formula, float64, of the shape to which the variables broadcast.

    Raises `ExpressionError` for anything that `check` refuses and where the result is not finite.
    """
    import numpy as np

    tree = _parse(expression)
    _check_node(tree, tuple(variables), depth=0)
    arrays = {name: np.asarray(value, dtype=np.float64) for name, value in variables.items()}
    with np.errstate(all="ignore"):
        result = _value(tree, arrays)
    shape = np.broadcast_shapes(*(array.shape for array in arrays.values()))
    result = np.array(np.broadcast_to(result, shape), dtype=np.float64)
    if not np.isfinite(result).all():
        raise ExpressionError(f"{_shown(expression)} is not finite everywhere: {_first_bad(result, arrays)}")
    return result


@lru_cache(maxsize=64)
def _parse(expression: str) -> ast.expr:
    if len(expression) > MAX_LENGTH:
        raise ExpressionError(f"longer than {MAX_LENGTH} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python's hints about odd literals; they are refused below
            return ast.parse(expression.strip(), mode="eval").body
    except SyntaxError as error:
        raise ExpressionError(f"{_shown(expression)} is not a formula ({error.msg})") from None
    except (ValueError, RecursionError, MemoryError):
        raise ExpressionError(f"{_shown(expression)} is not a formula") from None


def _check_node(node: ast.AST, variables: tuple[str, ...], depth: int) -> None:
    """Raises `ExpressionError` for a node that is not on the list, with its name."""
    if depth > MAX_DEPTH:
        raise ExpressionError(f"nested more than {MAX_DEPTH} deep")
    for child in _operands(node, variables):
        _check_node(child, variables, depth + 1)


def _operands(node: ast.AST, variables: tuple[str, ...]) -> list[ast.expr]:
    """The sub-formulas of an allowed node; an `ExpressionError` for any other node."""
    match node:
        case ast.Constant(value=value):
            _number(value)
            return []
        case ast.Name(id=name):
            if name not in variables and name not in CONSTANTS:
                known = ", ".join((*variables, *CONSTANTS))
                raise ExpressionError(f"unknown name {_shown(name)}; known are {known}")
            return []
        case ast.UnaryOp(op=op, operand=operand) if type(op) in OPERATORS:
            return [operand]
        case ast.BinOp(op=op, left=left, right=right) if type(op) in OPERATORS:
            return [left, right]
        case ast.BinOp(op=ast.BitXor()):
            raise ExpressionError("a power is written **, not ^")
        case ast.Compare(ops=[op], left=left, comparators=[right]) if type(op) in OPERATORS:
            return [left, right]
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            return _arguments(name, args)
    raise ExpressionError(f"{_shown(ast.unparse(node))} is not allowed in a formula")


def _arguments(name: str, args: list[ast.expr]) -> list[ast.expr]:
    if name not in FUNCTIONS:
        raise ExpressionError(f"unknown function {_shown(name)}; known are {', '.join(FUNCTIONS)}")
    count = FUNCTIONS[name][1]
    if len(args) != count:
        raise ExpressionError(f"{name} takes {count} argument{'s' * (count > 1)}, not {len(args)}")
    return args


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ExpressionError(f"{_shown(str(value))} is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ExpressionError("a number is too large")
    return number


def _value(node: ast.AST, arrays: dict[str, np.ndarray]) -> Any:
    """Value of a node that `_check_node` has let through."""
    import numpy as np

    match node:
        case ast.Constant(value=value):
            return np.float64(_number(value))
        case ast.Name(id=name):
            return arrays[name] if name in arrays else np.float64(CONSTANTS[name])
        case ast.UnaryOp(op=op, operand=operand):
            function, operands = OPERATORS[type(op)], [operand]
        case ast.BinOp(op=op, left=left, right=right) | ast.Compare(ops=[op], left=left, comparators=[right]):
            function, operands = OPERATORS[type(op)], [left, right]
        case ast.Call(func=ast.Name(id=name), args=args):
            function, operands = FUNCTIONS[name][0], args
    values = [_value(operand, arrays) for operand in operands]
    if function != "where":  # a comparison used as a number counts 1 where it holds
        values = [np.asarray(value, dtype=np.float64) for value in values]
    return getattr(np, function)(*values)


def _first_bad(result: np.ndarray, arrays: dict[str, np.ndarray]) -> str:
    import numpy as np

    first = np.flatnonzero(~np.isfinite(result))[0]
    point = ", ".join(f"{k} = {np.broadcast_to(v, result.shape).flat[first]:g}" for k, v in arrays.items())
    return f"{result.flat[first]} at {point}"


def _shown(text: str) -> str:
    return repr(text if len(text) <= 60 else text[:57] + "...")
