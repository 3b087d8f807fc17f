"""Tests, benchmarks and comparisons with other programs."""
