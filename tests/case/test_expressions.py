"""Formulas: values, refusals, and that nothing but an ExpressionError comes out."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from isphcli.case.expressions import ExpressionError, check, evaluate

x = np.linspace(0.1, 1, 5)
y = np.linspace(-1, 1, 5)


@pytest.mark.parametrize(
    ("formula", "expected"),
    [
        ("sin(2*pi*x)*cos(2*pi*y)", np.sin(2 * np.pi * x) * np.cos(2 * np.pi * y)),
        ("-x**2 + 3/2", -(x**2) + 1.5),
        ("where(y > 0, 1, max(x, 0.5))", np.where(y > 0, 1, np.maximum(x, 0.5))),
        ("(x < 0.5) * y", (x < 0.5) * y),
        ("(x < 0.5) + (y < 0)", (x < 0.5) * 1.0 + (y < 0)),
        (" 1e-5 ", np.full(5, 1e-5)),
        ("atan2(y, x) + abs(y) + e", np.arctan2(y, x) + np.abs(y) + np.e),
    ],
)
def test_values(formula, expected):
    value = evaluate(formula, x=x, y=y)
    assert value.dtype == np.float64
    np.testing.assert_allclose(value, expected, rtol=1e-15)


def test_result_has_the_shape_of_the_variables_and_is_writable():
    value = evaluate("0", x=np.zeros((3, 1)), y=np.zeros(4))
    assert value.shape == (3, 4)
    value[0] = 1


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("__import__('os').system('true')", "not allowed"),
        ("x.real", "not allowed"),
        ("[x][0]", "not allowed"),
        ("lambda: 1", "not allowed"),
        ("x if y else 1", "not allowed"),
        ("x and y", "not allowed"),
        ("f'{x}'", "not allowed"),
        ("sin", "unknown name 'sin'"),
        ("w", "known are x, y, z, pi, e"),
        ("open(1)", "unknown function"),
        ("sin(x, y)", "takes 1 argument"),
        ("sin(x=1)", "not allowed"),
        ("x^2", r"\*\*"),
        ("'a'", "not a number"),
        ("True", "not a number"),
        ("1j", "not a number"),
        ("9" * 400, "too large"),
        ("x +", "not a formula"),
        ("", "not a formula"),
        ("x\0", "not a formula"),
        ("-" * 500 + "x", "nested|not a formula"),
        ("(" * 500 + "x" + ")" * 500, "not a formula"),
        ("+".join(["x"] * 300), "nested"),
        ("x" * 3000, "longer"),
    ],
)
def test_refused(formula, message):
    with pytest.raises(ExpressionError, match=message):
        check(formula)
    with pytest.raises(ExpressionError):
        evaluate(formula, x=x, y=y, z=x)


@pytest.mark.parametrize("formula", ["1/(x - x)", "9**9**9**9**9", "log(y)", "exp(1000*x)"])
def test_values_that_are_not_finite_are_refused_with_their_place(formula):
    with pytest.raises(ExpressionError, match=r"not finite everywhere: .* at x = "):
        evaluate(formula, x=x, y=y)


def test_check_needs_no_numpy():
    code = "import sys, isphcli.case.expressions as e; e.check('sin(x)'); sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


@settings(max_examples=150, deadline=None)
@given(st.text(max_size=40) | st.text("xyz()+-*/^.,<>=0123456789e sincoqrt", max_size=40))
def test_any_text_is_a_formula_or_an_expression_error(text):
    try:
        value = evaluate(text, x=x, y=y, z=x)
    except ExpressionError:
        return
    assert value.shape == x.shape
