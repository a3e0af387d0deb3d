"""Check a proof file of lcp_plugin, without lcp_plugin: ``python check_proof.py < p.json`` prints yes or no."""

import json
from fractions import Fraction


def at(row, x):  # a row: columns with coefficients, and a constant
    return sum(a * x[j] for j, a in row[0]) + row[1]


def is_excluded(rows, signs, y, radius=None):
    """Farkas: Σ y_i w_i < 0 for all x (or |x_j| ≤ radius), y_i ≥ 0 where w_i ≥ 0, y_i ≤ 0 where w_i ≤ 0."""
    slopes, total = {}, sum(value * rows[i][1] for i, value in y)
    for i, value in y:
        for j, a in rows[i][0]:
            slopes[j] = slopes.get(j, 0) + value * a
    left, r = sum(map(abs, slopes.values())), radius or 0  # at most left · r in size
    fits = all(signs[i] in ("=", ">=" if value > 0 else "<=") for i, value in y)
    return fits and total + left * r < 0 <= r and (not left or radius is not None)


def is_exhausted(rows, signs, node, n):  # a split covers w_i = 0 and the bounds of x_i
    if "y" in node:
        return is_excluded(rows, signs, node["y"])
    i, below = node["row"], node["branches"]
    pieces = ("zero", i, "="), ("lower", n + i, ">="), ("upper", 2 * n + i, "<=")
    return i in range(n) and all(
        name in below and is_exhausted(rows, signs | {i: sign, row: "="}, below[name], n)
        for name, row, sign in pieces
        if row in rows
    )


def is_ray(rows, signs, P, c, point, d):  # rows hold at and along it, P d = 0, cᵀd < 0
    along = {i: (at(row, point), at((row[0], 0), d)) for i, row in rows.items() if signs[i]}
    is_kept = all(v == 0 or (v > 0 and signs[i] == ">=") for i in along for v in along[i])
    return is_kept and not any(at((row, 0), d) for row in P) and at((enumerate(c), 0), d) < 0


def is_solution(rows, z, n):  # within the bounds, at the one that permits w_i if w_i ≠ 0
    w = {k: at(row, z) for k, row in rows.items()}
    at_bound = (not w[i] or w.get(n + i if w[i] > 0 else 2 * n + i) == 0 for i in range(n))
    return all(at_bound) and all(value >= 0 for k, value in w.items() if k >= n)


def checksum(text: str) -> int:  # the remainder by a prime, so that each character counts
    return int.from_bytes(text.encode(), "big") % ((1 << 61) - 1)


def number(found):  # {"0x": "3/a"} is 3/10, in hexadecimal
    return Fraction(*(int(part, 16) for part in found["0x"].split("/"))) if "0x" in found else found


def is_proved(text: str) -> bool:  # about the data in it: compare these with yours
    head, _, last = text.rpartition(', "checksum": ')
    if int(last.strip("}\n")) != checksum(head):
        return False
    data = json.loads(text, object_hook=number, parse_float=Fraction, parse_constant=Fraction)
    rows, signs = ({} if "M" in data else dict(enumerate(data[key])) for key in ("rows", "signs"))
    M, q, lows, highs = (data.get(name, []) for name in ("M", "q", "lower", "upper"))
    for i, (row, low, high) in enumerate(zip(M, lows, highs, strict=True)):
        rows[i], signs[i] = (row, q[i]), ("", ">=", "<=", "=")[(high is None) + 2 * (low is None)]
        for k, bound, slope in ((len(q) + i, low, 1), (2 * len(q) + i, high, -1)):
            if bound is not None:
                rows[k], signs[k] = ([[i, slope]], -slope * bound), ">="
    if "point" in data and "M" not in data:
        return is_ray(rows, signs, data["P"], data["c"], data["point"], data["direction"])
    if "y" in data:
        return is_excluded(rows, signs, data["y"], data["radius"])
    if "z" in data:
        return is_solution(rows, data["z"], len(q))
    return "M" in data and is_exhausted(rows, signs, data["tree"], len(q))


if __name__ == "__main__":
    try:
        limit = "in its radius" * (json.loads(text := input()).get("radius") is not None)
        print(*("yes", limit) if is_proved(text) else ("no",))
    except (ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError):
        print("no: this is not the text of a proof file")
