"""Open benchmark of algorithms for laser profile scanning: ``python -m benchmarks --help``; see docs/benchmarks.md."""
