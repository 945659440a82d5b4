"""The methods' pictures beside the ground truth."""
