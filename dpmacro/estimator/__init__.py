"""DPBoost as an estimator: from arguments to a final fit, and what it says of new sequences."""
