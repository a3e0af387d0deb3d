"""The formulas of our docstrings, written in Unicode, as MathML, which browsers set without a script.

A formula is a run of operands and operators within a sentence that holds a relation, an operation, a norm or an index,
or a letter on its own: in "solved where ‖z − z*‖∞ ≤ tolerance · ‖z‖∞ holds" it begins after "where" and ends before
"holds". What is not recognised stays as it is written, and of what is no sign is lost.

>>> mathml("x_i²")
'<math><msubsup><mi>x</mi><mi>i</mi><mn>2</mn></msubsup></math>'
>>> set_formulas("where w_i ≥ 0 and a row of M has ‖M z‖∞ < tolerance · √n, say", "[{}]".format)
'where [w_i ≥ 0] and a row of [M] has [‖M z‖∞ < tolerance · √n], say'
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape

HIGH = dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺ᵀⁿᵏ*′°", "0123456789−+Tnk∗′°", strict=True))
LOW = dict(zip("₀₁₂₃₄₅₆₇₈₉₊₋ᵢⱼₖ", "0123456789+−ijk", strict=True))
PARTNER = {"(": ")", "[": "]", "⟨": "⟩", "‖": "‖", "|": "|"}
TOKEN = re.compile(
    rf"""(?P<function>(?:max|min|mid|diag|det|sin|cos|exp|log|sign)(?![A-Za-z]))
    |(?P<index>_(?:[A-Za-zα-ω]{{1,3}}(?![A-Za-z0-9_])|\d(?!\w)|\{{[^}}\s]*\}}))|(?P<low>[{"".join(LOW)}]+|(?<=‖)∞)|(?P<high>[{"".join(HIGH)}]+)
    |(?P<power>\^(?:\([^()]*\)|−?[A-Za-zα-ω0-9]+(?:_[A-Za-z0-9])?))
    |(?P<number>[½¼¾]|\d+(?:[ ]\d{{3}}(?!\d))*(?:\.\d+)?(?:e[-+]?\d+)?)
    |(?P<relation>[=<>]=|[=≠≤≥<>≈≪≫≡⊥∈→⇒⇔])|(?P<sign>[+−·×÷/])|(?P<prefix>[√∇∂Σ∑])|(?P<bar>‖|(?<![ \n])[|]|[|](?![ \n]))
    |(?P<open>[(\[⟨])|(?P<close>[)\]⟩])
    |(?P<letter>[α-ωΑ-Ω∞𝒜𝓜]|[A-Za-z](?![A-Za-zα-ω'’-]))|(?P<word>[A-Za-z](?:[A-Za-z’'-]|_(?![ijk]\b))*)
    |(?P<comma>,)|(?P<space>[ ]|\n[ ]*(?=\S))|(?P<other>.|\n)""",
    re.X,
)
PROSE = {
    *(
        "a",
        "an",
        "and",
        "are",
        "as",
        "at",
        "be",
        "between",
        "beyond",
        "both",
        "but",
        "by",
        "each",
        "ends",
        "every",
    ),
    *(
        "for",
        "from",
        "has",
        "have",
        "holds",
        "if",
        "in",
        "is",
        "it",
        "its",
        "means",
        "needs",
        "no",
        "not",
        "of",
        "on",
    ),
    *(
        "only",
        "or",
        "so",
        "than",
        "that",
        "the",
        "then",
        "there",
        "they",
        "to",
        "up",
        "was",
        "were",
        "what",
        "where",
    ),
    *("which", "while", "with", "within"),
}
SPACE = '<mspace width="0.2em"/>'
SHORT = 24  # characters: a formula that no line is broken in
OPERATION = {"relation", "sign"}
OPERAND = {"letter", "number", "function", "close", "index", "low", "high", "power", "word"}


@dataclass
class Token:
    """A piece of a sentence and what it is."""

    kind: str
    text: str


def tokens_of(text: str) -> list[Token]:
    """Return the pieces of a text; nothing is left out between them."""
    return [Token(str(found.lastgroup), found[0]) for found in TOKEN.finditer(text)]


def neighbour(tokens: list[Token], k: int, step: int) -> str:
    """Return what kind of token stands before (−1) or after (1) one, spaces and indices aside."""
    k += step
    while 0 <= k < len(tokens) and tokens[k].kind in ("space", "index"):
        k += step
    return tokens[k].kind if 0 <= k < len(tokens) else "other"


def is_article(tokens: list[Token], k: int) -> bool:
    """Whether an "A" stands before a word."""
    return tokens[k].text == "A" and neighbour(tokens, k, 1) == "word"


def belongs(tokens: list[Token], k: int, depth: int) -> bool:
    """Whether a token may be part of a formula that is open so many brackets deep."""
    token, before, after = tokens[k], neighbour(tokens, k, -1), neighbour(tokens, k, 1)
    is_marked = k + 1 < len(tokens) and tokens[k + 1].kind in ("index", "low", "high", "bar")
    if token.kind == "word" or (token.text in PROSE and not is_marked) or is_article(tokens, k):
        is_argument = depth > 0 and before in ("open", "comma") and after in ("close", "comma")
        beside = (
            OPERATION & {before, after}
            if token.text not in PROSE
            else before in OPERATION and after in OPERATION
        )
        return is_argument or bool(beside) or (k > 0 and tokens[k - 1].kind == "prefix")
    return token.kind != "other" and (token.kind != "comma" or depth > 0)


def end_of_run(tokens: list[Token], first: int) -> int:
    """Return where the formula ends that begins at a token; the same place if none does."""
    expected: list[str] = []
    end = first
    for k in range(first, len(tokens)):
        token = tokens[k]
        if not belongs(tokens, k, len(expected)):
            break
        if expected and token.text == expected[-1]:
            expected.pop()
            token = Token("close", token.text)
        elif token.kind in ("open", "bar"):
            expected.append(PARTNER[token.text])
        elif token.kind == "close":
            break
        if not expected and token.kind in OPERAND:
            end = k + 1
    return end


def is_formula(run: list[Token]) -> bool:
    """Whether a run is more than a number, a name and a remark in brackets."""
    kinds = [token.kind for token in run]
    if {"letter", "high"} <= {*kinds}:
        return True
    has_operand = any(kind in ("letter", "function", "bar", "prefix", "relation") for kind in kinds)
    return (
        bool({"relation", "index"} & {*kinds[1:]} or {"bar", "sign", "prefix"} & {*kinds})
        and has_operand
    )


def is_variable(tokens: list[Token], k: int) -> bool:
    """Whether a token is a letter on its own: no article, no unit, no initial, no part of a compound."""
    before, after = (tokens[i].text if 0 <= i < len(tokens) else " " for i in (k - 1, k + 1))
    is_alone = before[0] in " (\n" and after[0] in " ,;:.)?\n"
    words = "".join(token.text for token in tokens[max(k - 2, 0) : k])
    is_initial = after == "." and re.search(r"[A-Z,:.;][\w.]*\s*$", words)
    is_word = tokens[k].text in PROSE or is_article(tokens, k)
    is_unit = neighbour(tokens, k, -1) == "number"
    return tokens[k].kind == "letter" and is_alone and not (is_initial or is_word or is_unit)


def set_formulas(text: str, put: Callable[[str], str]) -> str:
    """Return a text with each formula in it replaced by what `put` makes of it."""
    tokens, out, k = tokens_of(text), "", 0
    while k < len(tokens):
        end = (
            end_of_run(tokens, k)
            if tokens[k].kind not in ("space", "index", "low", "high", "comma")
            else k
        )
        run = tokens[k:end]
        if run and is_formula(run) and not (k and tokens[k - 1].text.endswith("*")):
            out += put("".join(token.text for token in run))
            k = end
        elif is_variable(tokens, k):
            out += put(tokens[k].text)
            k += 1
        else:
            out += tokens[k].text
            k += 1
    return out


@dataclass
class Node:
    """An element of a formula, with what is set below and above it."""

    markup: str
    low: str = ""
    high: str = ""

    def __str__(self) -> str:
        parts = [self.markup, *(row for row in (self.low, self.high) if row)]
        name = {
            (False, False): "",
            (True, False): "msub",
            (False, True): "msup",
            (True, True): "msubsup",
        }
        element = name[bool(self.low), bool(self.high)]
        return f"<{element}>{''.join(parts)}</{element}>" if element else self.markup


def leaf(text: str) -> str:
    """Return the element of a name, a number or an operator."""
    name = "mn" if text[0].isnumeric() else "mi" if text[0].isalpha() or text in "∞∇∂" else "mo"
    return f"<{name}>{escape(text)}</{name}>"


def row(leaves: list[str]) -> str:
    """Return one element that holds these."""
    return leaves[0] if len(leaves) == 1 else f"<mrow>{''.join(leaves)}</mrow>"


def inside(text: str) -> str:
    """Return a formula within another one as one element."""
    return row([str(node) for node in nodes(iter(tokens_of(text)))])


def nodes(waiting: Iterator[Token], until: str = "") -> list[Node]:
    """Return the elements up to a closing bracket, which is taken too."""
    out: list[Node] = []
    for token in waiting:
        if token.text == until:
            break
        hangs = bool(out) and out[-1].markup != SPACE
        if token.kind in ("open", "bar"):
            inner = "".join(map(str, nodes(waiting, PARTNER[token.text])))
            left, right = (
                f'<mo stretchy="false">{sign}</mo>' for sign in (token.text, PARTNER[token.text])
            )
            out.append(Node(f"<mrow>{left}{inner}{right}</mrow>"))
        elif token.kind == "low" and hangs:
            out[-1].low = row([leaf(LOW.get(c, c)) for c in token.text])
        elif token.kind == "index" and hangs:
            index = token.text[1:]
            out[-1].low = (
                row([leaf(letter) for letter in index])
                if len(index) == 2
                else inside(index.strip("{}"))
            )
        elif token.kind == "power" and hangs:
            out[-1].high = inside(token.text[1:])
        elif token.kind == "high" and hangs:
            out[-1].high = row([leaf(HIGH[c]) for c in token.text])
        else:
            before = next((node.markup for node in out[::-1] if node.markup != SPACE), "<mo>")
            mark = SPACE if token.kind == "space" else leaf(token.text)
            if token.text in "+−" and before.startswith("<mo"):
                mark = mark.replace("<mo>", '<mo form="prefix">')
            out.append(Node(mark))
        if len(out) > 1 and out[-2].markup == "<mo>√</mo>" and not (out[-1].low or out[-1].high):
            out[-2:] = [Node(f"<msqrt>{out[-1]}</msqrt>")]
    signs = [Node("<mo></mo>"), *out, Node("<mo></mo>")]
    return [
        node
        for before, node, after in zip(signs, out, signs[2:], strict=False)
        if node.markup != SPACE
        or not any(beside.markup.startswith("<mo") for beside in (before, after))
    ]


def mathml(formula: str) -> str:
    """Return a formula as MathML; a long one as an element a relation, between which a line may be broken."""
    parts: list[str] = []
    for node in nodes(iter(tokens_of(formula))):
        is_relation = re.fullmatch(r"<mo>(?:[=≠≤≥≈≪≫≡⊥∈→⇒⇔]|&[lg]t;)</mo>", node.markup)
        if is_relation and parts and len(formula) > SHORT:
            parts += [node.markup.replace("<mo>", '<mo form="infix">')]
        else:
            parts[-1:] = ["".join(parts[-1:]) + str(node)]
    return "<wbr>".join(f"<math>{part}</math>" for part in parts)
