"""The user's scene: what is read from it, what is done to it, and how it is put back."""
