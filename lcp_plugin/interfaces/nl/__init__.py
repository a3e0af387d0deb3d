r"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``.

``lcp-plugin-ampl stub -AMPL`` reads ``stub.nl`` and writes ``stub.sol``: modeling languages call a solver so. The
options are ``key=value`` on the command line or in the environment variable ``lcp_plugin_options``, and
``lcp-plugin-ampl -=`` lists them. The same in Python:

>>> import tempfile
>>> from pathlib import Path
>>> head = ["g3 1 1 0", " 2 2 0 0 0", " 0 0 2 0 0 0", " 0 0", " 0 0 0", " 0 0 0 1", " 0 0 0 0 0", " 4 0", " 0 0"]
>>> rows = [" 0 0 0 0 0", "C0", "n-5", "C1", "n1", "r", "5 1 1", "5 1 2", "b", "2 0", "2 0", "k1", "2"]
>>> pairs = ["J0 2", "0 2", "1 1", "J1 2", "0 1", "1 2", ""]
>>> with tempfile.TemporaryDirectory() as folder:
...     path = Path(folder, "m.nl")
...     _ = path.write_text("\n".join([*head, *rows, *pairs]))
...     model = read_nl(path)
>>> model
ComplementarityModel(LCP(n=2, nonzeros=4, bounds 0 ≤ z))
>>> answer = model.solve()
>>> answer.x, answer.duals, answer.code
(array([2.5, 0. ]), array([0. , 3.5]), 0)

| the file states | it becomes |
|---|---|
| rows complementary to variables, and equalities, all affine | an `LCP`; also ``LCP.load("m.nl")`` |
| the same with smooth functions, or as many smooth equations as variables | a `NonlinearProblem` |
| a linear or convex quadratic objective, or none; affine rows and bounds | a `QuadraticProgram` |
| any smooth objective or integers, with complementarities: the best of all | an `EquilibriumProgram` |

**Supported:** ``+ - * / ^ sqrt exp log log10 sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh``, sums,
defined variables, ranges, fixed variables, a start. **Rejected,** with an error that names the row: piecewise rows,
``abs min max if`` and other functions that are not smooth. Without
complementarities also integers, objectives that are not convex quadratic, and nonlinear rows, except systems of as many
equations as unknowns without an objective. With an objective also ``atan asin acos``, which SCIP lacks.
`read_content` raises UnsupportedModel for logical constraints and external functions; ``lcp-plugin-ampl`` then writes
no ``.sol`` file.

**A complementarity row** is ≥ 0 if its variable is at the lower bound, ≤ 0 at the upper bound, and 0 between. Its dual
is its value. A dual of a program is the derivative of the objective by the row's right-hand side. Variables that only
name the value of such a row, which Pyomo adds, are substituted if all rows are affine. Without an objective all bounds
of a variable belong to its complementarity, as PATH and AMPL take them, and the message names a bound that the
complementarity does not state if a variable stops at it. Inequalities without a partner, and bounds of a variable
without a complementarity, are checked at the solution of the complementarities and equations. If a condition is
violated, the model is solved as with an objective: another solution is searched, or proved not to exist. With an
objective they are constraints like others, as are bounds that a complementarity does not state.

**Files**, text (``g``) or binary (``b``, either byte order), are read whole: bounds, ranges, equations,
complementarity rows, expressions, defined variables, starts, names from ``.col`` and ``.row``. What is
corrupt, or contradicts itself, is an `UnreadableFile` with its line or byte, and no count of a file is used before
it is compared with the file's length.
"""

from .model import NLAnswer, NLModel, model_of, read_nl
from .reading import read_content
from .writing import write_nl, write_sol

__all__ = ["NLAnswer", "NLModel", "model_of", "read_content", "read_nl", "write_nl", "write_sol"]
