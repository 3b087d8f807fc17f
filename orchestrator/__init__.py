"""Plans, drives, scans, reconstructs and evaluates with the simulated robot cell."""
