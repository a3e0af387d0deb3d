"""Compiled Gauss–Seidel sweeps of a dense symmetric matrix; they know arrays only."""

from __future__ import annotations

from ....core.kernels.compilation import kernel


@kernel
def dense_sweeps(M, inverse_diagonal, lower, upper, z, w, count):  # type: ignore[no-untyped-def]
    """Overwrite z by `count` sweeps z_i ← mid(l_i, u_i, z_i − w_i/m_ii), and w = M z + q with it.

    M is symmetric and C-contiguous: a row that changes is added to w, one that stays at its bound costs nothing.
    `inverse_diagonal` is 0 on the rows to leave alone.
    """
    for _ in range(count):
        for i in range(z.size):
            change = min(max(z[i] - w[i] * inverse_diagonal[i], lower[i]), upper[i]) - z[i]
            if change != 0.0:
                z[i] = min(max(z[i] + change, lower[i]), upper[i])
                row = M[i]
                for j in range(z.size):
                    w[j] += change * row[j]
