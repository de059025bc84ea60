"""Long work in processes of its own: lanes, workers, results kept for a while."""
