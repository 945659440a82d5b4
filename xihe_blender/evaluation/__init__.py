"""Many runs at once: batches over scenes, estimators and phones, and the frontier of error against time."""
