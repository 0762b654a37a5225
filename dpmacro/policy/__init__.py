"""Policies: what runs, what it is saved as, and what runs it in a world."""
