"""Choice of the coarse unknowns, and interpolation of the fine unknowns from them; compiled, arrays only.

Unknown i depends strongly on j if −m_ij ≥ strength · max_k −m_ik. The coarse unknowns are chosen by the first
pass of Ruge and Stüben: take the unknown on which most unknowns depend, interpolate its dependents from it, and prefer
the neighbors of the dependents from then on. Interpolation is direct: row i, scaled to reproduce constants if the row
of M sums to zero. Positive couplings are lumped into the diagonal, so that no weight is negative.

If couplings jump from edge to edge, many fine unknowns have no coarse neighbor. Then interpolation is extended: a fine
unknown on which i depends strongly, and which shares no coarse unknown with i, is replaced by the unknowns that
interpolate it in its row, including i. Only the largest weights of such a row are kept.

References
----------
J. W. Ruge, K. Stüben, *Algebraic multigrid*, in: Multigrid Methods, SIAM 1987, doi:10.1137/1.9781611971057.ch4.
H. De Sterck, R. D. Falgout, J. W. Nolting, U. M. Yang, *Distance-two interpolation for parallel algebraic multigrid*,
Numer. Linear Algebra Appl. 15 (2008), doi:10.1002/nla.559.
"""

from __future__ import annotations

import numpy as np

from ...core.kernels.compilation import kernel, uintp
from .vectors import LACKING

COARSE, FINE = 1, 2
LEAST_WEIGHT = 0.2  # of the largest weight, and
MOST_WEIGHTS = 3  # so many are kept in a row that interpolates through fine unknowns


@kernel
def strong_couplings(  # type: ignore[no-untyped-def]
    indptr, indices, data, strength, own, is_strong, columns, last, first_row, end_row
):
    """Mark the entries i → j, j < own, if i depends strongly on j; list these j in columns[indptr[i]:last[i]].

    Strong is what is so among all couplings of the row.
    """
    one = uintp(1)
    for i in range(uintp(first_row), uintp(end_row)):
        begin, end = uintp(indptr[i]), uintp(indptr[i + one])
        largest = 0.0
        for k in range(begin, end):
            if -data[k] > largest and uintp(indices[k]) != i:
                largest = -data[k]
        size = begin
        for k in range(begin, end):
            j = uintp(indices[k])
            is_strong[k] = (
                j < uintp(own) and largest > 0.0 and j != i and -data[k] >= strength * largest
            )
            if is_strong[k]:
                columns[size] = j
                size += one
        last[i] = size


@kernel
def unmirrored(begin, last, columns, first_row, end_row):  # type: ignore[no-untyped-def]
    """Return the number of columns right of the diagonal minus the number left of it; −n² if a mirror is missing.

    Row i holds the columns columns[begin[i]:last[i]], sorted.
    """
    one, balance = uintp(1), 0
    for i in range(uintp(first_row), uintp(end_row)):
        for m in range(uintp(begin[i]), uintp(last[i])):
            j = uintp(columns[m])
            if j <= i:
                balance -= j < i
                continue
            p, end = uintp(begin[j]), uintp(last[j])
            while p < end and uintp(columns[p]) < i:
                p += one
            if p == end or uintp(columns[p]) != i:
                return -begin.size * begin.size
            balance += 1
    return balance


@kernel
def choose_coarse(  # type: ignore[no-untyped-def]
    begin, last, columns, t_begin, t_last, dependents, is_mutual, kind, weight, entry, after, head
):
    """Fill kind with COARSE and FINE; an unknown without dependents is FINE.

    Unknown i depends on columns[begin[i]:last[i]], and dependents[t_begin[i]:t_last[i]] depend on i. If both sets agree
    for all i (`is_mutual`), all of them are FINE once i is COARSE.

    The weight of an unknown is the number of its undecided dependents, to which each dependent that became FINE adds
    again; −1 if it is decided. One list per weight contains the unknowns that had this weight at some time. When the
    search meets an entry whose unknown has lost weight, the entry moves to the list of its weight. `weight`, shape
    (n,), `entry` and `after`, each of shape (n + number of columns,), are work space; `head`, full of −1, has two
    entries more than twice the largest number of dependents.
    """
    one = uintp(1)
    n = uintp(last.size)
    heaviest = 0
    for i in range(n):
        weight[i] = t_last[i] - t_begin[i]
        heaviest = max(heaviest, weight[i])
    size = uintp(0)
    for back in range(n):
        i = n - one - back
        kind[i] = FINE
        if weight[i] == 0:
            weight[i] = -1
        else:
            entry[size], after[size] = i, head[uintp(weight[i])]
            head[uintp(weight[i])] = size
            size += one
    while heaviest > 0:
        if head[heaviest] < 0:
            heaviest -= 1
            continue
        place = uintp(head[heaviest])
        head[heaviest] = after[place]
        i = uintp(entry[place])
        if weight[i] < 0:
            continue
        if weight[i] < heaviest:
            if weight[i] == 0:
                weight[i] = -1
            else:
                after[place] = head[uintp(weight[i])]
                head[uintp(weight[i])] = place
            continue
        kind[i] = COARSE
        weight[i] = -1
        for k in range(uintp(t_begin[i]), uintp(t_last[i])):
            j = uintp(dependents[k])
            if weight[j] < 0:
                continue
            weight[j] = -1
            for m in range(uintp(begin[j]), uintp(last[j])):
                p = uintp(columns[m])
                if weight[p] >= 0:
                    weight[p] += 1
                    entry[size], after[size] = p, head[uintp(weight[p])]
                    head[uintp(weight[p])] = size
                    size += one
                    heaviest = max(heaviest, weight[p])
        if is_mutual:
            continue
        for m in range(uintp(begin[i]), uintp(last[i])):
            p = uintp(columns[m])
            if weight[p] >= 0:
                weight[p] -= 1


@kernel
def direct_interpolation(  # type: ignore[no-untyped-def]
    indptr, indices, data, is_strong, kind, number, first_row, end_row, p_indptr, p_indices, p_data
):
    """Write rows of the interpolation in CSR; return their number of entries, and how many have no coarse neighbor.

    `number` numbers the coarse unknowns.
    """
    one = uintp(1)
    size, lonely = uintp(0), 0
    for i in range(uintp(first_row), uintp(end_row)):
        p_indptr[i - uintp(first_row)] = size
        if kind[i] == COARSE:
            p_indices[size] = number[i]
            p_data[size] = 1.0
            size += one
            continue
        count = uintp(0)
        diagonal, all_negative, interpolating = 0.0, 0.0, 0.0
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            j = uintp(indices[k])
            if data[k] > 0.0 or j == i:
                diagonal += data[k]
            else:
                all_negative += data[k]
                if is_strong[k] and kind[j] == COARSE:
                    interpolating += data[k]
                    p_indices[size + count] = k  # until it is known how much there is
                    count += one
        if not (interpolating < 0.0 and diagonal > 0.0):
            lonely += all_negative < 0.0
            continue
        factor = all_negative / interpolating
        for _ in range(count):
            k = uintp(p_indices[size])
            p_indices[size] = number[uintp(indices[k])]
            p_data[size] = factor * (-data[k] / diagonal)
            size += one
    p_indptr[end_row - first_row] = size
    return size, lonely


@kernel
def extended_interpolation(  # type: ignore[no-untyped-def]
    indptr, indices, data, is_strong, kind, number, first_row, end_row, p_indptr, p_indices, p_data
):
    """Write rows that reach through fine unknowns; return their number of entries, and how many were read for all rows.

    `p_indices` and `p_data` have space for the entries of M and MOST_WEIGHTS more a row.
    """
    one = uintp(1)
    size, read = (
        uintp(0),
        4 * indices.size,
    )  # twice to find the strong coarse ones, twice for the rows themselves
    coarse, weights = np.empty(number.size, indices.dtype), np.empty(number.size)
    place, met_by = np.zeros(number.size, indptr.dtype), np.full(number.size, -1, indptr.dtype)
    first, near = _strong_coarse(indptr, indices, is_strong, kind)
    for i in range(uintp(first_row), uintp(end_row)):
        p_indptr[i - uintp(first_row)] = size
        if kind[i] == COARSE:
            p_indices[size] = number[i]
            p_data[size] = 1.0
            size += one
            continue
        count = np.int64(0)  # numba would compile a function again for a literal 0
        diagonal = 0.0
        all_negative = 0.0
        interpolating = 0.0
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            j = uintp(indices[k])
            if data[k] > 0.0 or j == i:
                diagonal += data[k]
            else:
                all_negative += data[k]
                if is_strong[k] and kind[j] == COARSE:
                    interpolating += data[k]
                    coarse[count], weights[count] = j, data[k]
                    place[j], met_by[j] = count, i
                    count += 1
        through, back, count, scanned = _through_fine(
            indptr,
            indices,
            data,
            is_strong,
            kind,
            first,
            near,
            i,
            count,
            coarse,
            weights,
            place,
            met_by,
        )
        interpolating += through
        read += scanned
        if not (interpolating < 0.0 and diagonal > 0.0):
            continue
        factor = all_negative / interpolating
        own_share = diagonal + factor * back
        if not own_share > 0.0:
            continue
        if through < 0.0:
            count, kept = _largest_weights(count, coarse, weights)
            factor /= kept
        for k in range(count):
            p_indices[size] = number[uintp(coarse[k])]
            p_data[size] = factor * (-weights[k] / own_share)
            size += one
    p_indptr[end_row - first_row] = size
    return size, read


@kernel
def _strong_coarse(indptr, indices, is_strong, kind):  # type: ignore[no-untyped-def]
    """Return the positions of the strong couplings to coarse unknowns: near[first[i]:first[i + 1]] of row i."""
    one, size = uintp(1), uintp(0)
    first, near = np.empty(indptr.size, indptr.dtype), np.empty(indices.size, indptr.dtype)
    for i in range(uintp(indptr.size - 1)):
        first[i] = size
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            if is_strong[k] and kind[uintp(indices[k])] == COARSE:
                near[size] = k
                size += one
    first[indptr.size - 1] = size
    return first, near


@kernel
def _through_fine(  # type: ignore[no-untyped-def]
    indptr, indices, data, is_strong, kind, first, near, i, count, coarse, weights, place, met_by
):
    """Distribute the strong couplings of row i to fine unknowns without a common coarse neighbor.

    Such a coupling is distributed over the unknowns that interpolate the fine unknown. Returns the sum of these
    couplings, the part that returns to i, the number of coarse unknowns of row i, and the number of entries read. All
    these unknowns are local, so that no rank needs the neighbors of its neighbors.
    """
    one = uintp(1)
    direct, own = count, uintp(indptr.size - 1)
    through, back, read = 0.0, 0.0, 0
    for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
        j = uintp(indices[k])
        if not is_strong[k] or kind[j] == COARSE or j >= own:
            continue
        total, to_i, is_alone = 0.0, 0.0, True
        for a in range(uintp(first[j]), uintp(first[j + one])):
            c = uintp(indices[uintp(near[a])])
            total += data[uintp(near[a])]
            read += 1
            if c >= own or (met_by[c] == i and place[c] < direct):
                is_alone = False
                break
        if total == 0.0 or not is_alone:
            continue
        for m in range(uintp(indptr[j]), uintp(indptr[j + one])):
            if uintp(indices[m]) == i:
                to_i = min(data[m], 0.0)
        read += indptr[j + one] - indptr[j] + first[j + one] - first[j]
        share = data[k] / (total + to_i)
        through += data[k]
        back += share * to_i
        for a in range(uintp(first[j]), uintp(first[j + one])):
            c = uintp(indices[uintp(near[a])])
            if met_by[c] != i:
                coarse[count], weights[count] = c, 0.0
                place[c], met_by[c] = count, i
                count += 1
            weights[place[c]] += share * data[uintp(near[a])]
    return through, back, count, read


@kernel
def _largest_weights(count, coarse, weights):  # type: ignore[no-untyped-def]
    """Keep at most MOST_WEIGHTS weights, none below LEAST_WEIGHT; return their number and share of the sum."""
    total, kept = 0.0, 0.0
    for k in range(count):  # all are negative: the largest ones first
        total += weights[k]
    least = 0.0
    for end in range(count):
        first = end
        for k in range(end + 1, count):
            if weights[k] < weights[first]:
                first = k
        weights[end], weights[first] = weights[first], weights[end]
        coarse[end], coarse[first] = coarse[first], coarse[end]
        least = LEAST_WEIGHT * weights[0]
        if end == MOST_WEIGHTS or weights[end] > least:
            return end, kept / total
        kept += weights[end]
    return count, kept / total


@kernel
def couplings_by_sign(indptr, indices, data):  # type: ignore[no-untyped-def]
    """Return the sums of the positive and of all absolute off-diagonal entries, and the number of lacking rows.

    A row is lacking if its sum is noticeably negative: negative couplings outweigh the diagonal and positive couplings.
    """
    one = uintp(1)
    positive, total, lacking = 0.0, 0.0, 0.0
    for i in range(uintp(indptr.size - 1)):
        row_positive, row_total, diagonal = 0.0, 0.0, 0.0
        largest = 0.0
        for k in range(uintp(indptr[i]), uintp(indptr[i + one])):
            if uintp(indices[k]) != i:
                size = abs(data[k])
                row_total += size
                if data[k] > 0.0:
                    row_positive += data[k]
                largest = max(largest, size)
            else:
                diagonal = data[k]
        if diagonal + row_positive < (1.0 - LACKING) * (row_total - row_positive):
            lacking += 1.0
        if largest > 0.0:  # all rows have equal weight in any units
            positive += row_positive / largest
            total += row_total / largest
    return positive, total, lacking
