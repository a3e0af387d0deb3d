"""The linear complementarity problem: checked, canonical, read-only data."""

from __future__ import annotations

from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from .checks import Vector, checked_bounds, checked_vector, read_only, restore_state
from .errors import InvalidOption
from .matrix import Matrix
from .names import Names, checked_names
from .representation import describe_lcp


class LCP:
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
        Names that messages use: of the unknowns and their rows, or a pair, names of the rows and of the unknowns.

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

    if TYPE_CHECKING:
        matrix: Matrix
        n: int
        q: Vector
        lower: Vector
        upper: Vector
        origin: Any
        names: Names
        _facts: dict[Any, Any]

    def __init__(
        self,
        M: Any,
        q: ArrayLike,
        *_bounds: ArrayLike,
        lower: ArrayLike = 0.0,
        upper: ArrayLike = np.inf,
        names: Any = None,
    ) -> None:
        if _bounds:
            raise InvalidOption("bounds are passed by name; write LCP(M, q, lower=l, upper=u)")
        given = self.__dict__
        given["matrix"] = matrix = M if isinstance(M, Matrix) else Matrix(M)
        given["n"] = n = matrix.n
        need = f"q must be a finite vector of length {n} (M is {n}×{n})"
        given["q"] = checked_vector(q, "q", n, need=need)
        given["lower"], given["upper"] = checked_bounds(lower, upper, n)
        given["names"] = checked_names(names, n, n)
        given["origin"], given["_facts"] = None, {}

    def __setattr__(self, name: str, value: Any) -> None:
        """Raise AttributeError, because facts about the problem are cached."""
        raise AttributeError(
            f"an LCP is immutable, so {name} cannot be set; write problem.with_q(q, lower=…, upper=…), or LCP(M, q)"
        )

    def with_origin(self, origin: Any) -> Self:
        """Return this new problem with its origin, which recovers the solution of the problem before a conversion.

        Parameters
        ----------
        origin : object
        """
        vars(self)["origin"] = origin
        return self

    @property
    def M(self) -> Any:
        """The stored matrix: a CSR array, or an ndarray if M is dense and small, shape (n, n)."""
        return self.matrix.array

    @property
    def csr(self) -> sp.csr_array:
        """The matrix as canonical, read-only CSR, shape (n, n)."""
        return self.matrix.csr

    @property
    def is_dense(self) -> bool:
        """True if M is stored as an ndarray."""
        return self.matrix.is_dense

    @property
    def nonzeros(self) -> int:
        """Number of nonzero entries of M."""
        return self.matrix.nonzeros

    @property
    def is_plain(self) -> bool:
        """True for the classical problem: lower = 0 and upper = ∞ on every row."""
        return not self.lower.any() and bool(np.all(self.upper == np.inf))

    @property
    def diagonal(self) -> Vector:
        """The diagonal of M, shape (n,)."""
        return self.matrix.diagonal

    @property
    def residual_scale(self) -> Vector:
        """D of the scaled residual, shape (n,); see :attr:`lcp_plugin.core.matrix.Matrix.residual_scale`."""
        return self.matrix.residual_scale

    @cached_property
    def nearest_to_zero(self) -> Vector:
        """z°, the point of [lower, upper] nearest to 0, shape (n,)."""
        # twice as quick as clip
        return read_only(np.minimum(np.maximum(0.0, self.lower), self.upper))

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
        w: Vector = matrix.array @ (
            z if is_vector else checked_vector(z, "z", matrix.n, is_finite=False)
        )
        w += self.q
        return w

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
        if lower is not None or upper is not None:
            bounds = self.lower if lower is None else lower, self.upper if upper is None else upper
            return LCP(self.matrix, q, lower=bounds[0], upper=bounds[1], names=self.names)
        other = object.__new__(LCP)
        need = f"q must be a finite vector of length {self.n} (M is {self.n}×{self.n})"
        vars(other).update(
            matrix=self.matrix,
            n=self.n,
            q=checked_vector(q, "q", self.n, need=need),
            lower=self.lower,
            upper=self.upper,
            nearest_to_zero=self.nearest_to_zero,
            origin=None,
            names=self.names,
            _facts={},
        )
        return other

    @classmethod
    def from_rows(cls, comm: Any, rows: Any, q: ArrayLike, **given: Any) -> Any:
        """Return the problem whose rows are spread over MPI ranks; see :mod:`lcp_plugin.ranks`.

        Parameters
        ----------
        comm : communicator of mpi4py; None for the whole job
        rows : sparse array, shape (own, n)
            The local rows of M with global column indices.
        q : array, shape (own,)
        **given
            lower, upper : scalar or array, shape (own,).
        """
        from ..ranks.problem import RowsOnRanks

        return RowsOnRanks.from_rows(comm, rows, q, **given)

    @classmethod
    def from_petsc(cls, A: Any, q: Any, **given: Any) -> Any:
        """Return the problem of a PETSc matrix on its communicator; see :mod:`lcp_plugin.ranks`.

        Parameters
        ----------
        A : petsc4py.PETSc.Mat
            Square, with equal parts of rows and columns. It must not change as long as the problem is in use.
        q : petsc4py.PETSc.Vec
        **given
            lower, upper : number or petsc4py.PETSc.Vec.
        """
        from ..ranks.petsc import RowsOnPETSc

        return RowsOnPETSc.from_petsc(A, q, **given)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the problem to ``path``: one ``.npz`` or ``.nl`` file, or a folder of Matrix Market files.

        A path ending in ``.npz`` gets the keys data, indices, indptr, shape (M as CSR), q, lower, upper; one ending in
        ``.nl`` becomes a file for AMPL's solvers. A path without a suffix becomes a folder with M.mtx, q.mtx,
        lower.mtx, upper.mtx. The file appears whole or not at all.

        Parameters
        ----------
        path : str or PathLike

        Raises
        ------
        UnreadableFile
            If it cannot be written, or its name belongs to another format, as a.mat.
        """
        from ..interfaces.files import save

        save(self, path)

    @classmethod
    def from_qp(
        cls,
        P: Any,
        c: ArrayLike,
        G: Any = None,
        h: ArrayLike | None = None,
        A: Any = None,
        b: ArrayLike | None = None,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
    ) -> LCP:
        """Return the LCP of min ½ xᵀP x + cᵀx over G x ≤ h, A x = b, lower ≤ x ≤ upper.

        To compute only x, use ``solve(QuadraticProgram(P, c, …))``, which is faster. For a result of this LCP,
        ``problem.origin.recover(result)`` returns x, multipliers and residuals. ``solve`` tests it by the criterion of
        LCPs, and with G or A by the duality gap. The gap is tested only on the returned problem: not after ``with_q``
        or ``load``, nor by ``solve_batch`` with `q` or bounds. There, a SOLVED result can have another objective.
        Errors: :func:`lcp_plugin.problems.programs.conversion.lcp_from_qp`.

        Parameters
        ----------
        P : array or sparse array, shape (n, n)
            Symmetric, positive semidefinite up to rounding: UnsupportedModel where it clearly is not.
        c : array, shape (n,)
        G, h : shapes (p, n) and (p,), optional
            Inequalities G x ≤ h.
        A, b : shapes (m, n) and (m,), optional
            Equations A x = b.
        lower, upper : scalar or array, shape (n,)
            Bounds of x; none by default.
        """
        from ..problems.programs.conversion import lcp_from_qp
        from ..problems.programs.program import QuadraticProgram

        return lcp_from_qp(QuadraticProgram(P, c, G, h, A, b, lower, upper))

    @classmethod
    def from_game(cls, A: Any, B: Any = None) -> LCP:
        """Return the LCP whose solutions are a two-player game's Nash equilibria.

        Parameters
        ----------
        A, B : array, shape (m, k)
            Payoffs of the row and of the column player, or one QuantEcon ``NormalFormGame`` of two players. Then
            ``problem.origin.recover(solve(problem, "lemke"))`` has the strategies.

        Raises
        ------
        InvalidProblem
            If B is missing, or A and B are not real matrices of one shape.
        """
        from ..problems.reformulations import lcp_from_bimatrix_game

        return lcp_from_bimatrix_game(A, B)

    @classmethod
    def from_contacts(
        cls,
        contacts: Any,
        friction: ArrayLike,
        velocities: ArrayLike,
        directions: int = 4,
        *,
        gaps: ArrayLike | None = None,
        time_step: float | None = None,
    ) -> LCP:
        """Return the LCP of rigid bodies in contact with friction; ``origin.recover(result)`` has impulses and slip.

        See :func:`lcp_plugin.problems.contact.contact_data` for shapes, units and errors.
        :class:`lcp_plugin.FrictionalContact` uses the exact friction cone instead of a pyramid.

        Parameters
        ----------
        contacts : array W, shape (d k, d k), or (mass matrix, normals, tangents)
        friction : number or array, shape (k,)
        velocities : array, shape (k, d), or (v,) with a mass matrix
            Without the impulses.
        directions : int
            Edges of each friction pyramid.
        gaps : number or array, shape (k,), optional
            Distances at the beginning of the step, in m. Add none to `velocities`.
        time_step : float, optional
            Length of the step in s, required with `gaps`: a contact may close by gap / time step.

        Raises
        ------
        InvalidProblem
            As `contact_data`.
        """
        from ..problems.contact import contact_data

        given = contact_data(
            contacts, friction, velocities, directions, gaps=gaps, time_step=time_step
        )
        return cls(*given.arrays).with_origin(given)

    def to_qp(self) -> Any:
        """Return a quadratic program with the same solutions; see ``problems.programs.conversion.qp_from_lcp``."""
        from ..problems.programs.conversion import qp_from_lcp

        return qp_from_lcp(self)

    @classmethod
    def from_cvxpy(cls, problem: Any) -> LCP:
        """Return the LCP that a cvxpy problem of complementarities states; its ``origin`` leads back to variables.

        Parameters
        ----------
        problem : cvxpy.Problem
            Model that consists of :func:`lcp_plugin.complements` and equalities.
        """
        from ..modeling.registration import lcp_stated_by

        return lcp_stated_by(problem)

    def to_cvxpy(self) -> Any:
        """Return a ``cvxpy.Problem`` in one variable that states this problem."""
        from ..modeling.registration import stated_in_cvxpy

        return stated_in_cvxpy(self)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> LCP:
        """Return a problem written by :meth:`save` or ``numpy.savez(path, M=M, q=q)``, or in ``M.mtx`` and ``q.mtx``.

        A ``.npz`` file holds q and M (dense), or M's CSR arrays as data, indices, indptr, shape; lower and upper where
        they are not 0 and ∞. Matrix Market files of these names lie in a folder. MATLAB's ``.mat``
        (to version 7.2) holds M, q and the bounds, which may be called lb and ub there. A bound of 1e20 or more in
        absolute value means ∞. Pickled content is never read, and of ``.mat`` files nothing but numbers; scipy,
        which reads these, may end the process on a corrupt one. For other models in AMPL's ``.nl`` format use
        :func:`lcp_plugin.interfaces.nl.read_nl`.

        Parameters
        ----------
        path : str or PathLike

        Raises
        ------
        UnreadableFile
            If the file is missing, corrupt, or not a linear complementarity problem.
        UnsupportedModel
            If a ``.nl`` file contains another model.
        """
        from ..interfaces.program_files import load_lcp

        return load_lcp(path)

    __repr__ = describe_lcp

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without cached properties."""
        computed = {name for name, value in vars(LCP).items() if isinstance(value, cached_property)}
        state = {name: value for name, value in self.__dict__.items() if name not in computed}
        return state | {"_facts": {}}

    __setstate__ = restore_state
