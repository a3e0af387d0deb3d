"""AMPL's ``.nl`` files, which Pyomo, AMPL and JuMP write: read, written, solved, answered by ``.sol``."""

from .reading import read_nl
from .writing import write_nl

__all__ = ["read_nl", "write_nl"]
