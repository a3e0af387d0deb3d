"""What kind of matrix is it? Verdicts with evidence, and the certificates that bounds and guarantees stand on.

For other subpackages: :func:`comparison_certificate` (v with ⟨M⟩v ≥ margin > 0), and :func:`comparison_weights` (the
same where v is no vector of doubles).
"""

from .h_matrix import (
    HCertificate,
    HVerdict,
    Weights,
    comparison_certificate,
    comparison_weights,
    h_verdict,
)
from .report import MatrixReport, analyze

__all__ = [
    "HCertificate",
    "HVerdict",
    "MatrixReport",
    "Weights",
    "analyze",
    "comparison_certificate",
    "comparison_weights",
    "h_verdict",
]
