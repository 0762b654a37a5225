"""Training: options, trainer, run folder, monitor and DAgger."""
