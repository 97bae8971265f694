"""Shallow depth of field: focus, lens, picture."""
