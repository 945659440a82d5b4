"""The laboratory: training rooms, batches, the frontier of accuracy and time, the paper's evaluation, and workers."""
