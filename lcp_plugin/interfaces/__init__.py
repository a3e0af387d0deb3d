"""Interfaces of other modeling languages and packages, and the results that they get.

| you have | you write |
|---|---|
| a Pyomo model | ``import lcp_plugin.pyomo``, then ``SolverFactory("lcp_plugin")`` |
| AMPL, JuMP, an ``.nl`` file | the executable ``lcp-plugin-ampl``, ``interfaces.nl.read_nl("m.nl").solve()`` |
| qpsolvers | ``register_with_qpsolvers()`` of ``interfaces.qpsolvers``, then ``solver="lcp_plugin"`` |
| QuantEcon's games | ``LCP.from_game(game)`` |
| files of numpy, Matrix Market | ``LCP.load("m.npz")``, ``"M.mtx"`` with q.mtx next to it |
| MATLAB's files | ``m = scipy.io.loadmat("m.mat")``, ``LCP(m["M"], m["q"].ravel())`` |
| programs in ``.qps``, ``.mps``, ``.npz``; A, b of least squares | ``solve(load_problem("p.qps"))`` |
| contacts with friction in ``.h5`` of fclib (extra ``[fclib]``), ``.npz`` | ``solve(load_problem("pile.h5"))`` |
| finite elements, for example scikit-fem | ``solve(LCP(M, q, lower=psi))`` |
| F(x) in JAX or CasADi (extras ``[jax]``, ``[casadi]``) | ``NonlinearProblem.from_jax(F)``, ``.from_casadi(x, F)`` |
| cvxpy; PyTorch, JAX | ``help("lcp_plugin.modeling")``; ``help("lcp_plugin.interfaces.learn")`` |

Every interface measures a result on the data that it passed on before it reports "solved" or "optimal", and verifies
a proof before it reports "infeasible" or "unbounded". A package is imported only when its interface is used.

**Pyomo** (extra ``[pyomo]``; all of it: ``help("lcp_plugin.pyomo")``)

>>> import pyomo.environ as pyo
>>> from pyomo.mpec import Complementarity, complements
>>> import lcp_plugin.pyomo
>>> m = pyo.ConcreteModel()
>>> m.x = pyo.Var(within=pyo.NonNegativeReals, initialize=1.0)
>>> m.pair = Complementarity(expr=complements(m.x >= 0, pyo.exp(m.x) >= 3.0))
>>> pyo.assert_optimal_termination(pyo.SolverFactory("lcp_plugin").solve(m))
>>> round(m.x.value, 6)
1.098612

**AMPL and JuMP** call the executable that comes with the package. Its options are keywords, which
``lcp-plugin-ampl -=`` lists. In AMPL::

    option solver "lcp-plugin-ampl", lcp_plugin_options "tolerance=1e-10";
    solve;

and in Julia (JuMP's ``.nl`` writer takes complementarities in releases from 2026 on; not tried here)::

    using JuMP, AmplNLWriter
    model = Model(() -> AmplNLWriter.Optimizer("lcp-plugin-ampl"))
    @variable(model, x >= 0)
    @constraint(model, exp(x) - 3 ⟂ x)
    optimize!(model)

``lcp-plugin solve m.nl`` also solves the files that they write. ``certify`` accepts programs; the commands ``check``
and ``analyze`` accept LCPs.

**qpsolvers** (extra ``[qpsolvers]``) Duals are in its convention. ``solution.extras`` has the status, the residuals and
the proof. ``tolerance``, ``algorithm``, ``max_seconds`` are options of this package.

>>> import numpy as np
>>> import qpsolvers
>>> from lcp_plugin.interfaces.qpsolvers import register_with_qpsolvers
>>> register_with_qpsolvers()
>>> program = qpsolvers.Problem(2 * np.eye(2), np.array([-2.0, -4.0]), np.array([[1.0, 1.0]]), np.array([2.0]))
>>> solution = qpsolvers.solve_problem(program, solver="lcp_plugin")
>>> solution.x, solution.z, solution.extras["status"].name
(array([0.5, 1.5]), array([1.]), 'SOLVED')

`certify` verifies the result of any other solver of qpsolvers, here x = (0.5, 1.5):

>>> lcp_plugin.certify(lcp_plugin.QuadraticProgram(*program.unpack()[:6]), [0.5, 1.5]).verdict
'proved'

**QuantEcon** A game of two players, as payoffs or as a ``NormalFormGame``. ``all_solutions`` finds every equilibrium of
a small one.

>>> from lcp_plugin import LCP, solve
>>> from quantecon.game_theory import NormalFormGame, Player
>>> problem = LCP.from_game(NormalFormGame([Player([[1, -1], [-1, 1]]), Player([[-1, 1], [1, -1]])]))
>>> equilibrium = problem.origin.recover(solve(problem, "lemke"))
>>> equilibrium.row_strategy, equilibrium.regret < 1e-15
(array([0.5, 0.5]), True)

**Files** with M and q, sparse or dense, and lower and upper if wanted; on the command line ``lcp-plugin solve m.npz``.

>>> import tempfile, scipy.sparse as sp
>>> with tempfile.TemporaryDirectory() as folder:
...     np.savez(f"{folder}/m.npz", M=[[2.0, 1.0], [1.0, 2.0]], q=[-5.0, 1.0])
...     print(solve(LCP.load(f"{folder}/m.npz")).z)
[2.5 0. ]

**scikit-fem** and other assemblers: M without the rows of the boundary, the obstacle as lower bound.
``examples/obstacle_with_scikit_fem.py`` does so on an unstructured mesh, with linear and quadratic elements.

>>> from skfem import Basis, ElementTriP1, MeshTri
>>> from skfem.models.poisson import laplace
>>> basis = Basis(MeshTri().refined(4), ElementTriP1())
>>> inside = basis.complement_dofs(basis.get_dofs())
>>> obstacle = 0.5 - np.hypot(*(basis.doflocs - 0.5))
>>> problem = LCP(laplace.assemble(basis)[inside][:, inside], np.zeros(inside.size), lower=obstacle[inside])
>>> result = solve(problem)
>>> result.status.name, round(float(result.z.max()), 6), bool((result.z > problem.lower).any())
('SOLVED', 0.5, True)
"""
