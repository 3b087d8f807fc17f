"""Controllers of KUKA."""
