"""Pictures, animations, pages and MCAP files of recorded runs."""
