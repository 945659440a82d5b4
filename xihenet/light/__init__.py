"""What is made of an estimate for those who light with more than spherical harmonics."""
