"""`xihe evaluate`: scenes, phones, estimators and seeds, spread over workers, and what they say together."""
