"""Accuracy of a point z: residuals of rows, the stopping criterion, the certificate."""
