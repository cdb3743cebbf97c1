"""Benchmarks: how long things take, beside other codes where they are installed. They state, they never judge."""
