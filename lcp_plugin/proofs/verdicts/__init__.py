"""Matrix classes: verdicts with evidence, and the certificates behind bounds and guarantees.

For other subpackages: :func:`comparison_certificate` (v with ⟨M⟩v ≥ margin > 0).
"""

from .h_matrix import HCertificate, HVerdict, comparison_certificate, h_verdict
from .report import MatrixReport, analyze

__all__ = [
    "HCertificate",
    "HVerdict",
    "MatrixReport",
    "analyze",
    "comparison_certificate",
    "h_verdict",
]
