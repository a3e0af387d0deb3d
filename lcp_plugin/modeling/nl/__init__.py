"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``."""

from .reading import read_nl
from .solution import read_sol, write_sol
from .writing import write_nl

__all__ = ["read_nl", "read_sol", "write_nl", "write_sol"]
