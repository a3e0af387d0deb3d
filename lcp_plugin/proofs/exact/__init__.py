"""Exact arithmetic for proofs: rounding margins, rational and p-adic arithmetic."""
