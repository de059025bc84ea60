"""Models, figures, comparisons and diagnoses of the page."""
