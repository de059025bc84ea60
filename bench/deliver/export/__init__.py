"""A fit delivered to a unit: embedded forms of a model, and the files that carry them."""
