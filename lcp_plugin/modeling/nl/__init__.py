"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``.

``read_nl(path)`` gives the model, its ``solve()`` the answer in the file's own variables and rows, ``write_sol`` writes
it. `read_content` and `write_nl` read and write what the file says, text or binary.

| the file states | it becomes |
|---|---|
| rows complementary to variables, and equations, all affine | an `LCP`; ``LCP.load("m.nl")`` gives it, too |
| the same with smooth functions, or as many smooth equations as variables | a `NonlinearProblem` |
| a linear or convex quadratic objective, or none; affine rows and bounds | a `QuadraticProgram` |

**Taken:** ``+ - * / ^ sqrt exp log log10 sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh``, sums, defined
variables, ranges, fixed variables, a start. **Refused in words,** with the row: integers, logical and piecewise rows,
external functions, ``abs min max if`` and what else is not smooth, an objective beside complementarities, nonlinear
objectives, nonlinear inequalities, and a variable whose bounds are not those that its complementarity speaks of.

**What holds of a complementarity row:** it is ≥ 0 where its variable is at the lower bound, ≤ 0 at the upper one, 0
between. Its dual is its value. A dual of a program is the derivative of the objective by the row's right-hand side.
Variables that only name the value of such a row, which Pyomo adds, are put in. Equations without complementarities
keep the bounds of variables; SOLVED means that they hold. Every answer is held against the rows as they stand in the
file, by an evaluation of its own.

The file of exp(x) + y ≥ 3 ⟂ x ≥ 0, x y = ½ ⟂ y free:

>>> import pathlib, tempfile
>>> text = '''g3 1 1 0
... 2 2 0 0 1
... 2 0 1 0 0 0
... 0 0
... 2 0 0
... 0 0 0 1
... 0 0 0 0 0
... 4 0
... 0 0
... 0 0 0 0 0
... C0
... o0
... o44
... v0
... n-3
... C1
... o2
... v0
... v1
... r
... 5 1 1
... 4 0.5
... b
... 2 0
... 3
... k1
... 2
... J0 2
... 0 0
... 1 1
... J1 2
... 0 0
... 1 0
... '''
>>> with tempfile.TemporaryDirectory() as folder:
...     path = pathlib.Path(folder) / "m.nl"
...     _ = path.write_text(text)
...     model = read_nl(path)
>>> model
ComplementarityModel(NonlinearProblem(n=2, jacobian given, enclosure given))
>>> answer = model.solve(tolerance=1e-12, z0=[1, 1])
>>> answer.status.name, answer.x.round(6), answer.code
('SOLVED', array([0.8917  , 0.560727]), 0)
"""

from .answers import NLAnswer, NLModel
from .model import model_of, read_nl
from .reading import read_content
from .solution import read_sol, write_sol
from .writing import write_nl

__all__ = ["NLAnswer", "NLModel", "model_of", "read_content", "read_nl", "read_sol", "write_nl", "write_sol"]
