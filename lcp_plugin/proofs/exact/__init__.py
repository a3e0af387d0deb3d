"""What turns a float into a proof: rounding margins, rational and p-adic arithmetic."""
