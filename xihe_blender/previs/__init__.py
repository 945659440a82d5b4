"""The main job: plan, prepare, run the chain along the camera path, compare, and say what came of it."""
