"""Files in and out: pictures, frames, recordings, arrays and JSON."""
