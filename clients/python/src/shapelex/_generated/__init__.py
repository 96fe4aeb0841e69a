"""Written by `generate.py`."""
