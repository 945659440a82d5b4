"""A recording of a phone in the open file: its camera, its pictures behind that, and a scan of what they show."""
