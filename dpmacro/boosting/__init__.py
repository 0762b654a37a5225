"""The boosting loop, its losses, and what a fit leaves out."""
