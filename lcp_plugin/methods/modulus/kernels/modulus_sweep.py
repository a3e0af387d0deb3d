"""The compiled sweep of the modulus-based iterations, on arrays only."""

from __future__ import annotations

from ....core.kernels.compilation import kernel, uintp
from ....core.kernels.rows import halves_of_row


@kernel
def modulus_sweep(  # type: ignore[no-untyped-def]
    indptr, split, indices, data, rows, relaxation, acceleration, backward, x, new, z
):
    """Write the next modulus vector into `new` and z = lower + max(x, 0) of the incoming x into `z`.

    `rows` holds q, lower, inverse_scale, omega, inverse_pivot. With w = M max(x, 0) + q and
    c_i = Σ m_ij (new_j − x_j) over the columns j already updated:

        new_i = x_i − (2 α (w_i − Ω_i max(−x_i, 0)) + β c_i) inverse_pivot_i

    Returns max_i |min(z_i − lower_i, w_i inverse_scale_i)|.
    """
    n = uintp(rows.shape[0])
    one = uintp(1)
    largest = 0.0
    for k in range(n):
        i = n - one - k if backward else k
        first, last, rest, rest_end = halves_of_row(indptr, split, i, backward)
        w = rows[i, 0]
        c = 0.0
        for at in range(first, last):
            j = uintp(indices[at])
            old = x[j]
            w += data[at] * (0.0 if old < 0.0 else old)
            c += data[at] * (new[j] - old)
        for at in range(rest, rest_end):
            old = x[uintp(indices[at])]
            w += data[at] * (0.0 if old < 0.0 else old)
        xi = x[i]
        positive = 0.0 if xi < 0.0 else xi
        slack = w * rows[i, 2]
        r = abs(slack if slack < positive else positive)
        if r > largest or r != r or slack != slack:
            largest = r if slack == slack else slack
        z[i] = rows[i, 1] + positive
        new[i] = (
            xi
            - (2.0 * relaxation * (w - rows[i, 3] * (positive - xi)) + acceleration * c)
            * rows[i, 4]
        )
    return largest
