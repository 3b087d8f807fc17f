"""Recordings of real sensors on real robots: reconstruction, and comparison with the simulation."""
