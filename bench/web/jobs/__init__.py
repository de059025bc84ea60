"""Long computations in separate processes: lanes, workers, a cache of results."""
