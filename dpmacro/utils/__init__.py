"""Command lines, files, processes and interrupts: what every part may use."""
