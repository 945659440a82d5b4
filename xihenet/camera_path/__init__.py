"""A camera path that is known: what was seen along it, what is around an object, and where to stand or look next."""
