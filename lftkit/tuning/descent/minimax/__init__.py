"""Local steps for the largest of many smooth functions."""
