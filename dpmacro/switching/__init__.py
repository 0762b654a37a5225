"""Switch functions: when a running policy changes its macro-action."""
