"""Physical effects, one a file. `registry.py` lists them, `base.py` says what an effect is."""
