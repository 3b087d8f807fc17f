"""Work with the simulated cell: robot programs, and pictures and animations of recorded runs."""
