"""LU of a sparse matrix of small dense blocks, compiled: order, structure, factor, solution.

Nodes are bodies or contacts, and a block of the matrix stands where two of them are linked, on both sides of the
diagonal. They are eliminated in the order of least degree (Tinney and Walker), blocks on the diagonal without pivoting:
what a factor is worth shows in the residual of the step that it gives. Links are sets of bits, 64 nodes a word.

The rows of a node are a panel of U: its own block, then those of the nodes linked to it that are eliminated later, in
their order. Lᵀ has panels of the same shape.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import helper

ONE, ODD, PAIRS = np.uint64(1), np.uint64(0x5555555555555555), np.uint64(0x3333333333333333)
FOURS, BYTES = np.uint64(0x0F0F0F0F0F0F0F0F), np.uint64(0x0101010101010101)


@helper
def count_bits(word):  # type: ignore[no-untyped-def]
    """Return how many bits of a word are set."""
    word = word - ((word >> ONE) & ODD)
    word = (word & PAIRS) + ((word >> np.uint64(2)) & PAIRS)
    word = (word + (word >> np.uint64(4))) & FOURS
    return np.int64((word * BYTES) >> np.uint64(56))


@helper
def link(links, i, j):  # type: ignore[no-untyped-def]
    """Link two nodes."""
    links[i, j >> 6] |= ONE << np.uint64(j & 63)
    links[j, i >> 6] |= ONE << np.uint64(i & 63)


@helper
def members(row, found):  # type: ignore[no-untyped-def]
    """Write the nodes of a row of links, in order; return how many there are."""
    count = 0
    for k in range(row.size):
        word = row[k]
        while word != np.uint64(0):
            rest = word & (word - ONE)
            found[count] = 64 * k + count_bits((word ^ rest) - ONE)
            count += 1
            word = rest
    return count


@helper
def eliminate_in_order(links, nodes, place, degrees, near):  # type: ignore[no-untyped-def]
    """Write into `place` when each node is eliminated, and into its links those that are later; return their number."""
    total = 0
    for i in range(nodes):
        links[i, i >> 6] &= ~(ONE << np.uint64(i & 63))
        degrees[i], place[i] = members(links[i], near), -1
    for turn in range(nodes):
        least, best = nodes + 1, 0
        for i in range(nodes):
            if place[i] < 0 and degrees[i] < least:
                least, best = degrees[i], i
        place[best] = turn
        count = members(links[best], near)
        total += count
        for a in range(count):
            i = near[a]
            degree = 0
            for k in range(links.shape[1]):
                links[i, k] |= links[best, k]
            links[i, i >> 6] &= ~(ONE << np.uint64(i & 63))
            links[i, best >> 6] &= ~(ONE << np.uint64(best & 63))
            for k in range(links.shape[1]):
                degree += count_bits(links[i, k])
            degrees[i] = degree
    return total


@helper
def lay_out(  # type: ignore[no-untyped-def]
    links, nodes, place, sizes, begins, later, columns, widths, panels, firsts, near
):
    """Write the panels' structure, by places; return how long U is.

    The p-th panel has the blocks `later` begins[p] … begins[p + 1] − 1, which begin at `columns`, and its `widths` and
    place in U; its unknowns begin at `firsts`, and `sizes` of nodes become those of places.
    """
    own = np.empty(nodes, np.int64)
    node_of = np.empty(nodes, np.int64)
    for i in range(nodes):
        node_of[place[i]], own[place[i]] = i, sizes[i]
    begins[0], panels[0], firsts[0] = 0, 0, 0
    for p in range(nodes):
        sizes[p] = own[p]
        count, first = members(links[node_of[p]], near), begins[p]
        for a in range(count):
            where, at = place[near[a]], first + a
            while at > first and later[at - 1] > where:
                later[at] = later[at - 1]
                at -= 1
            later[at] = where
        width = own[p]
        for at in range(first, first + count):
            columns[at] = width
            width += own[later[at]]
        begins[p + 1], widths[p], firsts[p + 1] = first + count, width, firsts[p] + own[p]
        panels[p + 1] = panels[p] + own[p] * width
    return panels[nodes]


@helper
def column_of(p, other, begins, later, columns):  # type: ignore[no-untyped-def]
    """Return where the block of another place begins in the panel of p, which is its own or has it."""
    if other == p:
        return 0
    low, high = begins[p], begins[p + 1] - 1
    while low < high:
        middle = (low + high) // 2
        if later[middle] < other:
            low = middle + 1
        else:
            high = middle
    return columns[low]


@helper
def _subtract(first, width, size, left, column, rows, right, targets, panel, wide):  # type: ignore[no-untyped-def]
    """Subtract from the rows of a panel the sums over `size` rows of left[:, column + row] · right[:, first:]."""
    if first == width:
        return
    begin, is_run = targets[first], targets[width - 1] - targets[first] == width - 1 - first
    for a in range(0, size, 3):  # three products at once
        b, c = min(a + 1, size - 1), min(a + 2, size - 1)
        x, y = (
            right[a * width + first : (a + 1) * width],
            right[b * width + first : (b + 1) * width],
        )
        z = right[c * width + first : (c + 1) * width]
        for r in range(rows):
            one, two, three = (
                left[a * width + column + r],
                left[b * width + column + r],
                left[c * width + column + r],
            )
            if c == b:
                three = 0.0
            if b == a:
                two = 0.0
            if is_run:
                row = panel[r * wide + begin : r * wide + begin + x.size]
                for i in range(x.size):
                    row[i] -= one * x[i] + two * y[i] + three * z[i]
            else:
                for i in range(x.size):
                    panel[r * wide + targets[first + i]] -= one * x[i] + two * y[i] + three * z[i]


@helper
def _factor_own(size, width, own, lower):  # type: ignore[no-untyped-def]
    """Eliminate within the panels of a node; return whether no pivot was 0 or not a number."""
    for a in range(size):
        pivot, above = own[a * width + a], own[a * width + a + 1 : (a + 1) * width]
        if not abs(pivot) > 0.0:
            return False
        for b in range(a + 1, size):
            factor, row = own[b * width + a] / pivot, own[b * width + a + 1 : (b + 1) * width]
            own[b * width + a] = factor
            for c in range(row.size):
                row[c] -= factor * above[c]
        row = lower[a * width + size : (a + 1) * width]
        for b in range(a):
            factor, above = own[b * width + a], lower[b * width + size : (b + 1) * width]
            for c in range(row.size):
                row[c] -= factor * above[c]
        for c in range(row.size):
            row[c] /= pivot
    return True


@helper
def factor_blocks(  # type: ignore[no-untyped-def]
    nodes, sizes, begins, later, columns, widths, panels, U, L, targets, total
):
    """Factor in place; return whether no pivot was 0 or not a number."""
    for p in range(nodes):
        size, width = sizes[p], widths[p]
        own, lower = U[panels[p] : panels[p + 1]], L[panels[p] : panels[p + 1]]
        if not _factor_own(size, width, own, lower):
            return False
        for at in range(begins[p], begins[p + 1]):
            q, first = later[at], columns[at]
            theirs = begins[q]
            for c in range(sizes[q]):
                targets[first + c] = c
            for other in range(at + 1, begins[p + 1]):
                while later[theirs] != later[other]:
                    theirs += 1
                for c in range(sizes[later[other]]):
                    targets[columns[other] + c] = columns[theirs] + c
            theirs_U, theirs_L = U[panels[q] : panels[q + 1]], L[panels[q] : panels[q + 1]]
            _subtract(first, width, size, lower, first, sizes[q], own, targets, theirs_U, widths[q])
            _subtract(
                first + sizes[q],
                width,
                size,
                own,
                first,
                sizes[q],
                lower,
                targets,
                theirs_L,
                widths[q],
            )
    return True


@helper
def solve_blocks(nodes, sizes, begins, later, columns, widths, panels, firsts, U, L, x):  # type: ignore[no-untyped-def]
    """Overwrite the right-hand side, in the order of places, with the solution."""
    for p in range(nodes):
        size, width = sizes[p], widths[p]
        own, lower, mine = (
            U[panels[p] : panels[p + 1]],
            L[panels[p] : panels[p + 1]],
            x[firsts[p] : firsts[p + 1]],
        )
        for a in range(size):
            for b in range(a):
                mine[a] -= own[a * width + b] * mine[b]
        for at in range(begins[p], begins[p + 1]):
            q = later[at]
            for r in range(sizes[q]):
                for a in range(size):
                    x[firsts[q] + r] -= lower[a * width + columns[at] + r] * mine[a]
    for p in range(nodes - 1, -1, -1):
        size, width = sizes[p], widths[p]
        own, mine = U[panels[p] : panels[p + 1]], x[firsts[p] : firsts[p + 1]]
        for a in range(size - 1, -1, -1):
            total = mine[a]
            for b in range(a + 1, size):
                total -= own[a * width + b] * mine[b]
            for at in range(begins[p], begins[p + 1]):
                q = later[at]
                for r in range(sizes[q]):
                    total -= own[a * width + columns[at] + r] * x[firsts[q] + r]
            mine[a] = total / own[a * width + a]
