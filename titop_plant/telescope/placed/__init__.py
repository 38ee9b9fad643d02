"""Sensors and actuators of a user's file at named points of the telescope."""
