"""Campaigns of a guarded cell."""
