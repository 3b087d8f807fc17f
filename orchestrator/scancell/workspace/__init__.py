"""Work with the simulated cell: robot programs, and a cell that runs while people command it."""
