"""Policies run in a world: success rates, reports and videos."""
