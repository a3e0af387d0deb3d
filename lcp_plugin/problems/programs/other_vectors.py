"""Programs that share their matrices: what these say is computed once, and each is solved with vectors of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...core.checks import FloatVector
from ...core.errors import InvalidOption, InvalidProblem, LCPError, UnknownAlgorithm, UnsupportedModel
from ...core.settings import Status
from ...methods.interior.suited_matrix import suited
from .conversion import attempts
from .convexity import refuse_nonconvex
from .program import QuadraticProgram
from .small_programs import may_be_small
from .solving import QuadraticProgramResult, judged_program

VECTORS = {"c", "h", "b", "lower", "upper"}


def prepare_program(program: QuadraticProgram) -> None:
    """Compute what solves of the program, and of others with its matrices, ask of these."""
    refuse_nonconvex(program)
    matrices, (m, p, n, _) = program.matrices, program.matrices.sizes
    if may_be_small(n, m + p, matrices.stored):
        _ = matrices.dense
    else:
        _ = suited(next(attempts(program)).problem.matrix).symbolic


def solve_programs(
    program: QuadraticProgram, vectors: Any, algorithm: Any, **options: Any
) -> list[QuadraticProgramResult | LCPError]:
    """Return what `solve_many` does of a program: where a run is needed, it goes on from the last answer."""
    answers: list[QuadraticProgramResult | LCPError] = []
    z: FloatVector | None = None
    if isinstance(vectors, Mapping) or not isinstance(vectors, Sequence):
        raise InvalidProblem(f'a program takes a list of mappings, as [{{"b": b}}], got {type(vectors).__name__}')
    for k, one in enumerate(vectors):
        if not isinstance(one, Mapping) or (unknown := set(one) - VECTORS):
            what = f"the name {min(unknown)!r}" if isinstance(one, Mapping) else type(one).__name__
            raise InvalidProblem(f"entry {k} must map some of {', '.join(sorted(VECTORS))} to vectors, got {what}")
        try:
            found = judged_program(program.with_vectors(**one), algorithm, guess=z, **options)
            answers.append(found)
            z = found.z if found.is_solved and not found.is_compiled else z
        except (InvalidOption, UnknownAlgorithm, UnsupportedModel):  # what concerns all
            raise
        except LCPError as error:
            answers.append(error)
        if isinstance(answers[-1], QuadraticProgramResult) and answers[-1].status is Status.INTERRUPTED:
            break
    return answers
