"""Runs of many scans: perturbations, designs, an engine that survives kills, and what their results say."""
