"""Training of the estimators' networks: `python -m xihenet.training`. Needs torch; start-up never imports it."""
