r"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``.

``lcp-plugin-ampl stub -AMPL`` reads ``stub.nl`` and writes ``stub.sol``, which is how those languages call a solver;
its options are ``key=value`` on the command line or in the environment variable ``lcp_plugin_options``, and
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

**Files**, text (``g``) or binary (``b``, either byte order), are read whole: bounds, ranges, equations,
complementarity rows, expressions, defined variables, starts, suffixes, names from ``.col`` and ``.row``. What is
damaged, or contradicts itself, is an `UnreadableFile` with its line or byte, and no count of a file is believed before
it is compared with the file's length.
"""

from .answers import NLAnswer, NLModel
from .model import model_of, read_nl
from .reading import read_content
from .solution import read_sol, write_sol
from .writing import write_nl

__all__ = ["NLAnswer", "NLModel", "model_of", "read_content", "read_nl", "read_sol", "write_nl", "write_sol"]
