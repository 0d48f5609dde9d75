"""Equations of effects as MathML."""

import ast
import re
from html import escape

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "theta": "θ", "lambda": "λ", "mu": "μ",
    "phi": "φ", "sigma": "σ", "tau": "τ", "omega": "ω", "w": "ω",
}  # fmt: skip
DOTS = {"qd": ("q", "˙"), "qdd": ("q", "¨"), "adot": ("a", "˙")}
UPRIGHT = {"sin", "cos", "tan", "exp", "sign", "max", "min", "clip", "tanh", "atan", "lag", "start", "duration", "side"}
UPRIGHT |= {"forward", "backward", "at"}
COMPARE = {ast.Lt: "&lt;", ast.LtE: "≤", ast.Gt: "&gt;", ast.GtE: "≥", ast.Eq: "=", ast.NotEq: "≠"}
ADD, MULTIPLY, POWER, ATOM = 1, 2, 3, 4


def mathml(equation: str) -> str:
    """An equation in Python's notation, typeset; as code if it is no expression.

    Args:
        equation: as in `Effect.equation`: "tau = -c*sign(qd)", with `^`, `abs` or bars, `J'` for a transpose,
            "for" and "if".
    """
    text = equation.replace("^", "**").replace("da/dt", "adot").replace("lambda", "lambda_")
    text = re.sub(r"\|([^|]+)\|", r"abs(\1)", text)
    text = re.sub(r"(\w+)'", r"transpose(\1)", text)
    statement, _, condition = text.partition(" for ")
    try:
        sides = [_node(ast.parse(side.strip(), mode="eval").body) for side in re.split(r"(?<![<>=!])=(?!=)", statement)]
        where = _node(ast.parse(condition, mode="eval").body) if condition else ""
    except (SyntaxError, KeyError, TypeError):
        return f'<code class="equation">{escape(equation)}</code>'
    body = "<mo>=</mo>".join(sides)
    if where:
        body += f"<mtext>&#8195;for&#160;</mtext>{where}"
    return f'<math display="inline" aria-label="{escape(equation)}"><mrow>{body}</mrow></math>'


def _node(node: ast.expr) -> str:
    """An expression."""
    match node:
        case ast.Name(id=name):
            return _name(name)
        case ast.Constant(value=value):
            return f"<mn>{value:g}</mn>"
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return f"<mrow><mo>−</mo>{_within(inner, MULTIPLY)}</mrow>"
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            return f"<mfrac>{_node(left)}{_node(right)}</mfrac>"
        case ast.BinOp(left=ast.BinOp(left=above, op=ast.Div(), right=below), op=ast.Pow(), right=right):
            ratio = f"{_within(above, POWER)}<mo>/</mo>{_within(below, POWER)}"
            return f"<msup>{_bracketed(ratio)}{_node(right)}</msup>"
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            return f"<msup>{_within(left, ATOM)}{_node(right)}</msup>"
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            first = _node(left) if isinstance(left, ast.UnaryOp) else _within(left, MULTIPLY)
            return f"<mrow>{first}<mo>&#8290;</mo>{_space(left, right)}{_within(right, MULTIPLY)}</mrow>"
        case ast.BinOp(left=left, op=op, right=right):
            sign = {ast.Add: "+", ast.Sub: "−"}[type(op)]
            return f"<mrow>{_within(left, ADD)}<mo>{sign}</mo>{_within(right, MULTIPLY)}</mrow>"
        case ast.Compare(left=left, ops=ops, comparators=others):
            rest = "".join(f"<mo>{COMPARE[type(op)]}</mo>{_node(o)}" for op, o in zip(ops, others, strict=True))
            return f"<mrow>{_node(left)}{rest}</mrow>"
        case ast.IfExp(test=test, body=body, orelse=other):
            return (
                f"<mrow>{_node(body)}<mtext>&#160;if&#160;</mtext>{_node(test)}"
                f"<mtext>&#160;else&#160;</mtext>{_node(other)}</mrow>"
            )
        case ast.Call(func=ast.Name(id="abs"), args=[inner]):
            return f'<mrow><mo stretchy="false">|</mo>{_node(inner)}<mo stretchy="false">|</mo></mrow>'
        case ast.Call(func=ast.Name(id="transpose"), args=[inner]):
            return f"<msup>{_node(inner)}<mo>⊤</mo></msup>"
        case ast.Call(func=function, args=arguments):
            listed = "<mo>,</mo>".join(map(_node, arguments))
            return f"<mrow>{_node(function)}<mo>&#8289;</mo>{_bracketed(listed)}</mrow>"
        case ast.Tuple(elts=elements):
            return _bracketed("<mo>,</mo>".join(map(_node, elements)))
    raise TypeError(f"{ast.dump(node)} has no form")


def _name(name: str) -> str:
    """A symbol: Greek, with dots, with what follows its first letter as an index, or a word."""
    name = name.rstrip("_")
    if name in DOTS:
        letter, dots = DOTS[name]
        return f'<mover><mi>{letter}</mi><mo lspace="0" rspace="0">{dots}</mo></mover>'
    if name in UPRIGHT:
        return f'<mi mathvariant="normal">{name}</mi>'
    if name in GREEK:
        return f"<mi>{GREEK[name]}</mi>"
    head, _, tail = name.partition("_")
    if not tail and len(name) == 2:
        head, tail = name
    if tail:
        return f"<msub>{_name(head)}<mi>{escape(tail)}</mi></msub>"
    return f"<mi{'' if len(name) == 1 else ' mathvariant=&quot;normal&quot;'}>{escape(name)}</mi>".replace(
        "&quot;", '"'
    )


def _space(left: ast.expr, right: ast.expr) -> str:
    """A thin space beside a word or a function."""
    last = left.right if isinstance(left, ast.BinOp) else left
    first = right.left if isinstance(right, ast.BinOp) else right
    words = isinstance(first, ast.Call) or any(isinstance(n, ast.Name) and n.id in UPRIGHT for n in (last, first))
    return '<mspace width="0.17em"/>' if words else ""


def _within(node: ast.expr, least: int) -> str:
    """With parentheses if it binds less tightly."""
    strength = ATOM
    if isinstance(node, ast.UnaryOp | ast.IfExp | ast.Compare):
        strength = 0 if not isinstance(node, ast.UnaryOp) else ADD
    elif isinstance(node, ast.BinOp):
        strength = {ast.Add: ADD, ast.Sub: ADD, ast.Pow: POWER}.get(type(node.op), MULTIPLY)
    inner = _node(node)
    return inner if strength >= least else _bracketed(inner)


def _bracketed(inner: str) -> str:
    """In parentheses, as high as a fraction if it holds one."""
    high = "true" if "<mfrac>" in inner else "false"
    return f'<mrow><mo stretchy="{high}">(</mo>{inner}<mo stretchy="{high}">)</mo></mrow>'
