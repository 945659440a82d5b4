"""Over many scenes: batch evaluation of estimators and phones, and the frontier of error against time."""
