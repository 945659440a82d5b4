"""Renders of Cycles as arrays: what the phone would see, and the light that really arrives."""
