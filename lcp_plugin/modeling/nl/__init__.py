"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``."""

from .answers import NLAnswer, NLModel
from .model import model_of, read_nl
from .reading import read_content
from .solution import read_sol, write_sol
from .writing import write_nl

__all__ = ["NLAnswer", "NLModel", "model_of", "read_content", "read_nl", "read_sol", "write_nl", "write_sol"]
