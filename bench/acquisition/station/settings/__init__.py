"""The station file by its sections, checked whole before anything is opened."""
