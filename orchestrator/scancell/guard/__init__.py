"""Protection of a moving robot from collisions: its motion is identified and predicted, and a stop is proved."""
