"""The viewer of a run: one HTML page to send, with the virtual objects live beside the ground truth."""
