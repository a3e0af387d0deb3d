"""What kind of matrix is it? Verdicts with evidence, and the certificates that bounds and guarantees stand on.

For other subpackages: :func:`comparison_certificate` (v with ⟨M⟩v ≥ margin > 0), :func:`comparison_weights` (the same
where v is no vector of doubles), :func:`comparison_solve` (approximate solutions of systems with ⟨M⟩).
"""

from ...systems.comparison import comparison_solve
from .h_matrix import HCertificate, HVerdict, Weights, comparison_certificate, comparison_weights, h_verdict
from .report import MatrixReport, analyze

__all__ = [
    "HCertificate",
    "HVerdict",
    "MatrixReport",
    "Weights",
    "analyze",
    "comparison_certificate",
    "comparison_solve",
    "comparison_weights",
    "h_verdict",
]
