"""Work on one part: what a `Scanner` prepares before it, and what becomes of it."""
