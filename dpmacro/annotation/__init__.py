"""A policy's segmentation of demonstrations: labels, scores, pictures and a page."""
