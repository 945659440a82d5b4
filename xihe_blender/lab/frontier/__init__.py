"""Accuracy against time: every choice that trades one for the other, measured, and the front of them."""
