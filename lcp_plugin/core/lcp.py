"""The linear complementarity problem: checked, canonical, read-only data."""

from __future__ import annotations

import sys
from operator import attrgetter
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from . import checks
from .checks import AnyMatrix, Vector, checked_bounds, checked_vector, read_only
from .entries import clip
from .errors import public
from .matrix import Matrix
from .names import Names, checked_names, describe_lcp, shared_labels
from .problem import Problem, check_labels
from .problem_classes import Door

DATA = "matrix", "n", "origin", "q", "lower", "upper", "names", "nearest_to_zero"


class LCP(Problem):
    """Find z with lower ≤ z ≤ upper and w = M z + q complementary to it.

    For every row i: w_i ≥ 0 if z_i = lower_i, w_i = 0 if lower_i < z_i < upper_i, and w_i ≤ 0
    if z_i = upper_i. With the default bounds this is the classical problem z ≥ 0, w ≥ 0, zᵀw = 0;
    a row with bounds (−∞, ∞) is an equality.

    Parameters
    ----------
    M : array or sparse array, shape (n, n)
        Real, finite. Integers, booleans and single precision become float64. A dense M is copied. A canonical
        CSR array of float64 (sorted, no duplicates, no stored zeros) is used without a copy, so do not change its
        entries while the problem is in use, or pass ``M.copy()``. Arguments are never modified.
    q : array, shape (n,)
        Real, finite.
    lower, upper : scalar or array, shape (n,)
        Bounds of z in the unit of z, lower ≤ upper; lower ≤ −1e20 and upper ≥ 1e20 mean no bound.
    names : sequence of str, or a pair of sequences, optional
        Names that messages use: of the unknowns and their rows, or a pair, names of the rows and of the unknowns. By
        default the labels of pandas objects, whose numbers must be in one order.

    Raises
    ------
    InvalidProblem
        If the data do not define such a problem.

    References
    ----------
    Cottle, Pang, Stone, *The Linear Complementarity Problem*, SIAM 2009, doi:10.1137/1.9780898719000.

    Examples
    --------
    >>> problem = LCP([[2, 1], [1, 2]], [-5, 1])
    >>> problem
    LCP(n=2, nonzeros=4, bounds 0 ≤ z)
    >>> problem.slack([2.5, 0])
    array([0. , 3.5])
    """

    matrix: Matrix
    n: int
    q: Vector
    lower: Vector
    upper: Vector
    origin: Any
    names: Names
    nearest_to_zero: Vector  # z°, the point of the bounds nearest to 0
    _facts: dict[Any, Any]

    # Their types: lcp_plugin/__init__.pyi
    from_rows, from_petsc, from_qp, from_contacts = (Door(is_static=True) for _ in range(4))
    from_game, from_cvxpy, load = (Door(is_static=True) for _ in range(3))
    to_qp, to_cvxpy, save = (Door() for _ in range(3))

    def __init__(
        self,
        M: AnyMatrix,
        q: ArrayLike,
        *,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        names: Any = None,
    ) -> None:
        if "pandas" in sys.modules:
            labels = shared_labels(self.axes, locals())
            shared_labels(("M zz", "q z", "lower z", "upper z"), locals())
            if labels and names is None:
                names = Names(labels.get("w"), labels.get("z"))
        matrix = M if isinstance(M, Matrix) else Matrix(M)
        n = matrix.n
        q, (lower, upper) = _checked_q(q, n), checked_bounds(lower, upper, n)
        names = checked_names(names, n, n, are_pairs=True)
        nearest = read_only(clip(0.0, lower, upper))
        self._keep(matrix, q, lower, upper, names, nearest)

    def _keep(self, matrix: Matrix, *data: object, origin: object = None) -> Self:
        """Write checked data into this new problem, in the order of `DATA`."""
        of = dict(zip(DATA, (matrix, matrix.n, origin, *data), strict=True))
        return checks.fill(self, **of, _facts={})

    def __setattr__(self, name: str, value: object) -> None:
        """Raise AttributeError, because facts about the problem are cached."""
        raise AttributeError(
            f"an LCP is immutable, so {name} cannot be set; write problem.with_q(q, lower=…, upper=…), or LCP(M, q)"
        )

    def with_origin(self, origin: object) -> Self:
        """Return the problem with its origin, which recovers the solution of the problem before a conversion.

        Parameters
        ----------
        origin : object
        """
        data = (getattr(self, name) for name in DATA[3:])
        return object.__new__(type(self))._keep(self.matrix, *data, origin=origin)

    M = property(attrgetter("matrix.array"), doc="Stored matrix, CSR or small and dense, (n, n).")
    csr = property(attrgetter("matrix.csr"), doc="M as canonical, read-only CSR, shape (n, n).")
    is_dense = property(attrgetter("matrix.is_dense"), doc="True if M is stored as an ndarray.")
    diagonal = property(attrgetter("matrix.diagonal"), doc="The diagonal of M, shape (n,).")
    residual_scale = property(
        attrgetter("matrix.residual_scale"), doc=Matrix.residual_scale.__doc__
    )
    nonzeros = property(attrgetter("matrix.nonzeros"), doc="Number of nonzero entries of M.")

    @property
    def is_plain(self) -> bool:
        """True for the classical problem: lower = 0 and upper = ∞ on every row."""
        return not self.lower.any() and bool(np.all(self.upper == np.inf))

    @property
    def is_kkt(self) -> bool:
        """True for the optimality conditions of a program with rows."""
        return getattr(self.origin, "form", "") == "kkt"

    def slack(self, z: ArrayLike) -> Vector:
        """Return w = M z + q, shape (n,).

        Parameters
        ----------
        z : array, shape (n,)

        Raises
        ------
        InvalidProblem
            If z is not a real vector of length n.
        """
        matrix = self.matrix
        is_vector = type(z) is np.ndarray and z.dtype == np.float64 and z.shape == (matrix.n,)
        z = z if is_vector else checked_vector(z, "z", matrix.n, is_finite=False)
        w: Vector = matrix.array @ z
        w += self.q
        return w

    @public
    def with_q(
        self, q: ArrayLike, *, lower: ArrayLike | None = None, upper: ArrayLike | None = None
    ) -> LCP:
        """Return the problem with another q (and bounds) that shares the cached properties of M.

        Parameters
        ----------
        q : array, shape (n,)
            Real, finite.
        lower, upper : scalar or array, shape (n,), optional
            The present bounds by default.

        Raises
        ------
        InvalidProblem
            As the constructor.
        """
        check_labels(self, {"q": q, "lower": lower, "upper": upper})
        if lower is not None or upper is not None:
            bounds = self.lower if lower is None else lower, self.upper if upper is None else upper
            return LCP(self.matrix, q, lower=bounds[0], upper=bounds[1], names=self.names)
        others = (getattr(self, name) for name in DATA[4:])
        return object.__new__(LCP)._keep(self.matrix, _checked_q(q, self.n), *others)

    __repr__ = describe_lcp

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without cached properties."""
        return {name: getattr(self, name) for name in DATA} | {"_facts": {}}

    __setstate__ = checks.restore_state


def _checked_q(q: ArrayLike, n: int) -> Vector:
    need = f"q must be a finite vector of length {n} (M is {n}×{n})"
    return checked_vector(q, "q", n, need=need)
