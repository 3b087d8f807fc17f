"""From a part to a checked motion: scan paths, constraints, trajectories, programs."""
