"""Squeezes of many grasps at once, and of one quickly."""
