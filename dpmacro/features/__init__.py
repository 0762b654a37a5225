"""Observations to feature columns, and columns to sorted levels."""
