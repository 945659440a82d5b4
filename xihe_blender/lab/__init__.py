"""The laboratory: training rooms, batches, the frontier of accuracy and time, and workers."""
