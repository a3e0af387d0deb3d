"""solve(): the clock, the incumbent, the ledger and the judge of a run; batches."""
