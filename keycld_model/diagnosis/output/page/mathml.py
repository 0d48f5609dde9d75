"""Equations of effects as MathML."""

import ast
import re

from keycld_model.diagnosis.output.page.elements import Element, element

GREEK = {
    "alpha": "α", "beta": "β", "gamma": "γ", "delta": "δ", "epsilon": "ε", "theta": "θ", "lambda": "λ", "mu": "μ",
    "phi": "φ", "sigma": "σ", "tau": "τ", "omega": "ω", "w": "ω",
}  # fmt: skip
DOTS = {"qd": ("q", "˙"), "qdd": ("q", "¨"), "adot": ("a", "˙")}
UPRIGHT = {"sin", "cos", "tan", "exp", "sign", "max", "min", "clip", "tanh", "atan", "lag", "start", "duration", "side"}
UPRIGHT |= {"forward", "backward", "at"}
COMPARE = {ast.Lt: "<", ast.LtE: "≤", ast.Gt: ">", ast.GtE: "≥", ast.Eq: "=", ast.NotEq: "≠"}
ADD, MULTIPLY, POWER, ATOM = 1, 2, 3, 4
TIMES, APPLIED = "\N{INVISIBLE TIMES}", "\N{FUNCTION APPLICATION}"
WIDE, SPACE = "\N{EM SPACE}", "\N{NO-BREAK SPACE}"


def mathml(equation: str) -> Element:
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
        where = [_node(ast.parse(condition, mode="eval").body)] if condition else []
    except (SyntaxError, KeyError, TypeError):
        return element("code", equation, class_="equation")
    if where:
        where.insert(0, element("mtext", f"{WIDE}for{SPACE}"))
    body = element("mrow", *_listed(sides, "="), *where)
    return element("math", body, display="inline", aria_label=equation)


def _node(node: ast.expr) -> Element:
    """An expression as MathML."""
    match node:
        case ast.Name(id=name):
            return _name(name)
        case ast.Constant(value=value):
            return element("mn", f"{value:g}")
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return element("mrow", _operator("−"), _within(inner, MULTIPLY))
        case ast.BinOp():
            return _binary(node)
        case ast.Compare(left=left, ops=ops, comparators=others):
            rest = [x for op, o in zip(ops, others, strict=True) for x in (_operator(COMPARE[type(op)]), _node(o))]
            return element("mrow", _node(left), *rest)
        case ast.IfExp(test=test, body=body, orelse=other):
            if_, else_ = (element("mtext", f"{SPACE}{word}{SPACE}") for word in ("if", "else"))
            return element("mrow", _node(body), if_, _node(test), else_, _node(other))
        case ast.Call(func=ast.Name(id="abs"), args=[inner]):
            return element("mrow", _operator("|", stretchy="false"), _node(inner), _operator("|", stretchy="false"))
        case ast.Call(func=ast.Name(id="transpose"), args=[inner]):
            return element("msup", _node(inner), _operator("⊤"))
        case ast.Call(func=function, args=arguments):
            listed = _listed([_node(a) for a in arguments], ",")
            return element("mrow", _node(function), _operator(APPLIED), _bracketed(*listed))
        case ast.Tuple(elts=elements):
            return _bracketed(*_listed([_node(e) for e in elements], ","))
    raise TypeError(f"{ast.dump(node)} has no form")


def _binary(node: ast.BinOp) -> Element:
    """A sum, a product, a fraction or a power."""
    left, right = node.left, node.right
    match node:
        case ast.BinOp(op=ast.Div()):
            return element("mfrac", _node(left), _node(right))
        case ast.BinOp(left=ast.BinOp(left=above, op=ast.Div(), right=below), op=ast.Pow()):
            ratio = _within(above, POWER), _operator("/"), _within(below, POWER)
            return element("msup", _bracketed(*ratio), _node(right))
        case ast.BinOp(op=ast.Pow()):
            return element("msup", _within(left, ATOM), _node(right))
        case ast.BinOp(op=ast.Mult()):
            first = _node(left) if isinstance(left, ast.UnaryOp) else _within(left, MULTIPLY)
            return element("mrow", first, _operator(TIMES), *_space(left, right), _within(right, MULTIPLY))
    sign = {ast.Add: "+", ast.Sub: "−"}[type(node.op)]
    return element("mrow", _within(left, ADD), _operator(sign), _within(right, MULTIPLY))


def _name(name: str) -> Element:
    """A symbol: Greek, with dots, with what follows its first letter as an index, or a word."""
    name = name.rstrip("_")
    if name in DOTS:
        letter, dots = DOTS[name]
        return element("mover", element("mi", letter), _operator(dots, lspace="0", rspace="0"))
    if name in GREEK:
        return element("mi", GREEK[name])
    head, _, tail = name.partition("_")
    if not tail and len(name) == 2 and name not in UPRIGHT:
        head, tail = name
    if tail:
        return element("msub", _name(head), element("mi", tail))
    return element("mi", name) if len(name) == 1 else element("mi", name, mathvariant="normal")


def _operator(sign: str, **attributes: str) -> Element:
    return element("mo", sign, **attributes)


def _listed(items: list[Element], sign: str) -> list[Element]:
    """Elements with a sign between them."""
    return [x for item in items for x in (_operator(sign), item)][1:]


def _space(left: ast.expr, right: ast.expr) -> list[Element]:
    """A thin space beside a word or a function."""
    last = left.right if isinstance(left, ast.BinOp) else left
    first = right.left if isinstance(right, ast.BinOp) else right
    by_a_word = isinstance(first, ast.Call) or any(isinstance(n, ast.Name) and n.id in UPRIGHT for n in (last, first))
    return [element("mspace", width="0.17em")] if by_a_word else []


def _within(node: ast.expr, least: int) -> Element:
    """An expression, with parentheses if it binds less tightly."""
    strength = ATOM
    if isinstance(node, ast.UnaryOp | ast.IfExp | ast.Compare):
        strength = 0 if not isinstance(node, ast.UnaryOp) else ADD
    elif isinstance(node, ast.BinOp):
        strength = {ast.Add: ADD, ast.Sub: ADD, ast.Pow: POWER}.get(type(node.op), MULTIPLY)
    inner = _node(node)
    return inner if strength >= least else _bracketed(inner)


def _bracketed(*inner: Element) -> Element:
    """Elements in parentheses, which are as high as a fraction if there is one."""
    high = "true" if any(True for child in inner for _ in child.iter("mfrac")) else "false"
    return element("mrow", _operator("(", stretchy=high), *inner, _operator(")", stretchy=high))
