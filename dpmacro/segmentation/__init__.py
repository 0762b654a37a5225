"""Macro-labels from per-frame costs under a strict bound on transitions, and what segments are."""
