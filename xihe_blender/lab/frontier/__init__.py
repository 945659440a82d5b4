"""What does accuracy cost in time? Every choice that trades one for the other, measured, and the front of them."""
