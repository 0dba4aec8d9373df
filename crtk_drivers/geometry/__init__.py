"""Rotations, poses, rates and frames as numbers."""
