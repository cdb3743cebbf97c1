"""Verification: cases with known solutions, studies of them, benchmarks beside peers."""
