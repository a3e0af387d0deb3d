"""An affine cvxpy expression and its matrices state the same map, whatever atoms it is written with."""

import warnings

import cvxpy as cp
import numpy as np
import pytest
import scipy.sparse as sp
from tools.refusals import assert_refused, refusals

from lcp_plugin import ModelWarning, UnsupportedModel, complements
from lcp_plugin.modeling.reading import Reader

V = np.array([2.0, -1.0, 3.0, 5.0])
A = np.array([[1.0, 2.0, 0.0, -1.0], [0.0, 3.0, 1.0, 0.0], [4.0, 0.0, -2.0, 1.0]])
B = np.array([[1.0, 0.0], [-2.0, 3.0], [0.0, 5.0], [7.0, 0.0]])
S = np.array(
    [[4.0, -1.0, 0.0, 0.0], [-1.0, 4.0, -2.0, 0.0], [0.0, -1.0, 4.0, -1.0], [3.0, 0.0, -1.0, 4.0]]
)
MASK = np.array([True, False, True, True])
MASKS = np.arange(12).reshape(3, 4) % 3 == 0
SPARSE = sp.csr_array(S)
STACK = np.arange(24.0).reshape(2, 4, 3) - 7.0


class Unknowns:
    """Fresh variables and parameters for one form."""

    def __init__(self):
        self.s = cp.Variable(name="s")
        self.x = cp.Variable(4, name="x")
        self.y = cp.Variable(4, name="y")
        self.X = cp.Variable((3, 4), name="X")
        self.Y = cp.Variable((4, 4), name="Y")
        self.c = cp.Variable((4, 1), name="c")
        self.Z = cp.Variable((2, 3, 4), name="Z")
        self.p = cp.Parameter(name="p", value=3.0)
        self.v = cp.Parameter(4, name="v", value=V)
        self.P = cp.Parameter((4, 4), name="P", value=S)


FORMS = {
    # leaves, sums, signs
    "matrix variable": lambda u: u.X,
    "n-d variable": lambda u: u.Z,
    "variable used many times": lambda u: u.x + S @ u.x - u.x[::-1] + 3 * u.x,
    "negative of a product": lambda u: -(S @ u.x + V),
    # indices
    "slice": lambda u: u.x[1:3],
    "negative step": lambda u: u.x[::-1],
    "block": lambda u: u.X[1:, ::-2],
    "list index": lambda u: u.x[[3, 0, 0, 2]],
    "boolean index": lambda u: u.x[MASK],
    "boolean matrix index": lambda u: u.X[MASKS],
    "index of a product": lambda u: (S @ u.x + V)[1:4:2],
    # shapes
    "reshape F": lambda u: cp.reshape(u.X, (2, 6), order="F"),
    "T": lambda u: u.X.T,
    "n-d transpose": lambda u: cp.transpose(u.Z, (2, 0, 1)),
    "permute_dims": lambda u: cp.permute_dims(u.Z, (1, 2, 0)),
    "hstack": lambda u: cp.hstack([u.x, V, u.y]),
    "vstack of matrices": lambda u: cp.vstack([u.X, u.Y, u.X]),
    "bmat": lambda u: cp.bmat([[u.Y, u.c], [u.X, np.ones((3, 1))]]),
    "concatenate columns": lambda u: cp.concatenate([u.Y, u.c], axis=1),
    "stack": lambda u: cp.stack([u.x, u.y], axis=1),
    "diag of a vector": lambda u: cp.diag(u.x),
    "diag of a matrix": lambda u: cp.diag(u.Y),
    "upper_tri": lambda u: cp.upper_tri(u.Y),
    "vec_to_upper_tri": lambda u: cp.vec_to_upper_tri(cp.hstack([u.x, u.y[:2]])),
    "real": lambda u: cp.real(u.x),
    "psd_wrap": lambda u: cp.psd_wrap(u.Y),
    # broadcasting
    "scalar plus vector": lambda u: u.s + u.x,
    "column plus row": lambda u: u.c + cp.reshape(u.x, (1, 4), order="F"),
    "promote": lambda u: (
        cp.promote(u.s, (3, 2)) if hasattr(cp, "promote") else u.s * np.ones((3, 2))
    ),
    "broadcast_to": lambda u: cp.broadcast_to(u.x, (3, 4)),
    # products
    "dense @": lambda u: A @ u.x,
    "sparse @": lambda u: SPARSE @ u.x,
    "vector @": lambda u: V @ u.x,
    "x @ sparse": lambda u: u.x @ SPARSE,
    "both sides": lambda u: A @ u.Y @ B,
    "outer": lambda u: cp.outer(V, u.x),
    "vdot": lambda u: cp.vdot(V, u.x),
    "scalar variable times sparse": lambda u: u.s * SPARSE,
    "stack @": lambda u: STACK @ u.Z,
    "sparse @ n-d": lambda u: SPARSE @ cp.reshape(u.Z, (2, 4, 3), order="F"),
    "multiply": lambda u: cp.multiply(V, u.x),
    "multiply sparse": lambda u: cp.multiply(SPARSE, u.Y),
    "multiply column variable": lambda u: cp.multiply(u.c, S),
    "divide vector": lambda u: (S @ u.x + V) / np.array([1.0, 2.0, -4.0, 0.5]),
    # sums
    "sum axis 0": lambda u: cp.sum(u.X, axis=0),
    "sum keepdims": lambda u: cp.sum(u.X, axis=1, keepdims=True),
    "n-d sum of two axes": lambda u: cp.sum(u.Z, axis=(0, 2)),
    "cumsum axis 1": lambda u: cp.cumsum(u.X, axis=1),
    "diff twice along axis 1": lambda u: cp.diff(u.X, k=2, axis=1),
    "convolve": lambda u: cp.convolve(np.array([1.0, -2.0, 1.0]), u.x),
    "kron, constant left": lambda u: cp.kron(B, u.X),
    "partial_trace": lambda u: cp.partial_trace(u.Y, (2, 2), axis=0),
    "partial_transpose": lambda u: cp.partial_transpose(u.Y, (2, 2), axis=1),
    "einsum": lambda u: cp.einsum("ij,jk->ik", A, u.Y),
    "power one": lambda u: cp.power(u.x, 1),
    "quadratic form of zero": lambda u: cp.quad_form(u.x, np.zeros((4, 4))) + u.s,
    # constants and parameters
    "folded sparse constants": lambda u: (
        (2 * cp.Constant(SPARSE).T @ cp.Constant(SPARSE) / 4) @ u.x
    ),
    "sparse block constant": lambda u: (
        cp.bmat([[SPARSE, -SPARSE], [SPARSE, SPARSE]]) @ cp.hstack([u.x, u.y])
    ),
    "sparse constant kron": lambda u: (
        cp.kron(cp.Constant(SPARSE), cp.Constant(np.eye(2))) @ cp.hstack([u.x, u.y])
    ),
    "parameter factor": lambda u: cp.multiply(u.v, u.x),
    "parameter matrix": lambda u: u.P @ u.x + u.p,
    "parameters, not DPP": lambda u: (u.p * u.P) @ u.x + cp.exp(u.p) * u.v,
    "parameter in a shifted product": lambda u: S @ (u.x + u.v),
}
MISSING = {"stack": "stack", "einsum": "einsum", "broadcast_to": "broadcast_to"} | {
    name: name for name in ("convolve", "permute_dims")
}


def affine_map(expression, memo=None):
    """Read an expression that should be affine."""
    rows = Reader(memo).rows(expression)
    assert rows.level == 0
    return rows


def expression(name):
    if name in MISSING and not hasattr(cp, MISSING[name]):
        pytest.skip(f"cvxpy {cp.__version__} has no {MISSING[name]}")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "conv is deprecated")
        try:
            return FORMS[name](Unknowns())
        except ValueError as error:
            # Products of n-d arrays came with cvxpy 1.8, those with vectors after 1.9.0.
            if "n-d" in name.lower() + str(error).lower() and cp.__version__ < "1.9.1":
                pytest.skip(f"cvxpy {cp.__version__} refuses the form: {error}")
            raise


def integer_point(variables, seed):
    generator = np.random.default_rng(seed)
    return {
        key: generator.integers(-9, 10, size=v.shape).astype(float) for key, v in variables.items()
    }


def value_at(F, variables, point):
    """Evaluate by cvxpy itself, the values of the variables put back."""
    before = {key: v.value for key, v in variables.items()}
    for key, v in variables.items():
        v.value = point[key]
    try:
        return np.ravel(F.value.toarray() if sp.issparse(F.value) else F.value, order="F")
    finally:
        for key, v in variables.items():
            v.value = before[key]


def by_matrices(found, point):
    return sum(
        (found.blocks[key] @ np.ravel(point[key], order="F") for key in found.blocks),
        start=found.offset,
    )


#: cvxpy itself has no value where sparse constants are stacked or broadcast.
DENSE_TWIN = {
    "sparse @ n-d": lambda u: S @ cp.reshape(u.Z, (2, 4, 3), order="F"),
    "sparse block constant": lambda u: np.block([[S, -S], [S, S]]) @ cp.hstack([u.x, u.y]),
}


#: The exponential rounds.
ROUNDED = {"parameters, not DPP"}


@pytest.mark.parametrize("name", FORMS)
def test_every_affine_form_is_extracted_exactly(name):
    """M x + q equals cvxpy's own value at integer points, bit for bit where the data are dyadic."""
    F = expression(name)
    found = affine_map(F)
    twin = F
    if name in DENSE_TWIN:
        unknowns = Unknowns()
        twin = DENSE_TWIN[name](unknowns)
    assert found.shape == F.shape
    assert found.offset.shape == (F.size,)
    variables = {v.id: v for v in F.variables()}
    for key, block in found.blocks.items():
        assert block.shape == (F.size, variables[key].size)
        assert block.format == "csr"
    for seed in range(3):
        point = integer_point(variables, seed)
        twins = {v.id: v for v in twin.variables()}
        renamed = dict(zip(sorted(twins), (point[key] for key in sorted(point)), strict=True))
        expected = value_at(twin, twins, renamed)
        exact = 4e-15 * np.abs(expected).max() if name in ROUNDED else 0.0
        np.testing.assert_allclose(by_matrices(found, point), expected, rtol=0.0, atol=exact)


def test_values_of_variables_are_untouched():
    """Extraction neither reads nor writes Variable.value."""
    u = Unknowns()
    u.x.value = np.arange(4.0)
    before = u.x.value
    affine_map(S @ u.x + cp.kron(B, u.X)[0, 0] + u.y)
    assert u.x.value is before
    assert u.X.value is None
    assert u.y.value is None


def test_a_sparse_parameter_stays_sparse():
    """A parameter with a sparsity pattern is read without becoming dense and without a warning."""
    pattern = (np.array([0, 1, 3]), np.array([1, 1, 0]))
    p = cp.Parameter((4, 4), sparsity=pattern)
    p.value_sparse = sp.coo_array((np.array([1.0, 2.0, 3.0]), pattern), shape=(4, 4))
    x = cp.Variable(4)
    block = affine_map(p @ x).blocks[x.id]
    assert block.nnz == 3
    np.testing.assert_array_equal(block.toarray(), p.value_sparse.toarray())


@pytest.mark.full
def test_deep_and_long_sums_do_not_recurse():
    """Thousands of terms, side by side or nested, stay within Python's recursion limit."""
    x = cp.Variable(2)
    long = affine_map(sum((i * x for i in range(3000)), start=x))
    np.testing.assert_array_equal(long.blocks[x.id].toarray(), np.eye(2) * (1 + 2999 * 1500))
    nested = x
    for _ in range(3000):
        nested = 0.5 * nested + x
    np.testing.assert_array_equal(affine_map(nested).blocks[x.id].toarray(), 2 * np.eye(2))


def test_sparse_data_never_become_dense():
    """Constants of 10¹⁰ entries, nearly all zero, are transposed, scaled and multiplied as sparse; so are stacks."""
    n = 100_000
    M, x = cp.Constant(sp.eye_array(n, format="csr")), cp.Variable(n)
    assert affine_map((2 * M.T @ M / 4 - M) @ x).blocks[x.id].diagonal().sum() == -0.5 * n
    n = 1000  # to stack large ones takes cvxpy itself minutes with some releases of numpy
    M, x = cp.Constant(sp.eye_array(n, format="csr")), cp.Variable(n)
    block = affine_map(cp.bmat([[M, 2 * M]]) @ cp.hstack([x, x])).blocks[x.id]
    assert (block.nnz, block.diagonal().sum()) == (n, 3.0 * n)


def test_terms_that_cancel_leave_what_is_small():
    """Large numbers that cancel, inside a row or between terms, are read as they are."""
    x = cp.Variable(4)
    block = affine_map((1e10 * x + x) - 1e10 * x + 1e-6 * S @ x).blocks[x.id]
    np.testing.assert_allclose(block.toarray(), np.eye(4) + 1e-6 * S, rtol=1e-5)


@pytest.mark.parametrize("is_defined", [False, True])
def test_a_wrong_matrix_is_noticed_and_the_point_kept(monkeypatch, is_defined):
    """An atom whose Jacobian disagrees with its value causes a warning, in a pair and in a definition."""
    x, y = cp.Variable(4, name="x", nonneg=True), cp.Variable(4)
    F = cp.cumsum(x) + V - 10
    wrong = sp.csc_array(np.eye(4))
    monkeypatch.setattr(type(cp.cumsum(x)), "_grad", lambda _self, _values: [wrong])
    rules = [complements(x, y), y == F] if is_defined else [complements(x, F)]
    with pytest.warns(ModelWarning, match="evaluates the model to other values"):
        cp.Problem(cp.Minimize(0), rules).solve(method="LCP")
    np.testing.assert_allclose(x.value, 10 - V)  # of x + V − 10


def new_keynesian_model(periods, shock):
    """Return the problem, the rate and the slack of its lower bound."""
    gap, inflation, rate = (cp.Variable(periods) for _ in range(3))
    after = lambda v, t: v[t + 1] if t + 1 < periods else 0.0  # noqa: E731
    demand = [gap[t] - after(gap, t) + rate[t] - after(inflation, t) for t in range(periods)]
    rows = [demand[t] == (shock if t == 0 else 0.0) for t in range(periods)]
    rows += [inflation[t] == 0.9 * after(inflation, t) + 0.3 * gap[t] for t in range(periods)]
    slack = rate - 1.5 * inflation
    problem = cp.Problem(cp.Minimize(0), [*rows, complements(rate >= -0.005, slack >= 0)])
    return problem, rate, slack


def ladder_without_source(sections, steps):
    """Return the problem, the current and the voltage of an ideal diode; the source is switched off after a step."""
    v, current = cp.Variable((sections, steps)), cp.Variable(steps)
    rows = []
    for t in range(steps):
        for k in range(sections):
            before = v[k, t - 1] if t else 0.0
            into = current[t] if k == 0 else (v[k - 1, t] - v[k, t]) / 0.7
            out = (v[k, t] - v[k + 1, t]) / 0.7 if k + 1 < sections else v[k, t] / 0.3
            rows.append(0.1 * (v[k, t] - before) / 0.01 == into - out)
    source = np.r_[0.9, np.zeros(steps - 1)]
    voltage = v[0] + 0.2 * current - source
    return (
        cp.Problem(cp.Minimize(0), [*rows, complements(current >= 0, voltage >= 0)]),
        current,
        voltage,
    )


@pytest.mark.quick(1)
@pytest.mark.parametrize("size", [3, 5, 8, 12])
@pytest.mark.parametrize("made", [new_keynesian_model, ladder_without_source])
def test_values_at_rounding_level_agree(made, size):
    """Rows whose terms are all rounding errors of larger unknowns cause neither an error nor a warning."""
    problem, z, w = made(size, -0.03 if made is new_keynesian_model else 7)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        problem.solve(method="LCP")
    distance = z.value + (0.005 if made is new_keynesian_model else 0.0)
    assert problem.status == "optimal"
    assert np.abs(np.minimum(distance, w.value)).max() <= 1e-12


@refusals(r"""
S @ cp.abs(u.x) → abs\(x\) is not smooth.*and a pair
cp.lambda_max(u.Y) + u.s → lambda_max\(Y\) is not affine.*linearize
u.x + cp.Parameter(4, name="load") → parameter load has no value; set it first
u.x + np.array([1.0, np.nan, 0.0, 0.0]) → must be finite, got nan
sp.csr_array(np.diag([1.0, np.inf, 1.0, 1.0])) @ u.x → must be finite, got inf
u.x + 1j → complex
1e200 * (1e200 * u.x + 1) → overflow
1e200 * (1e200 * u.x) + 1 → overflows, or is divided by 0
u.Y + cp.Variable((4, 4), name="b", integer=True) → variable b has the attribute 'integer'
u.Y + cp.Variable((4, 4), name="b", complex=True) → variable b has the attribute 'complex'
u.Y + cp.Variable((4, 4), name="b", PSD=True) → variable b has the attribute 'PSD'
""")
def test_what_is_no_affine_map_is_refused_by_name(call, words):
    """The error names the culprit, not the whole expression, and says what to do."""
    names = {**globals(), "u": Unknowns()}
    assert_refused(f"affine_map({call})", words, names, UnsupportedModel)
