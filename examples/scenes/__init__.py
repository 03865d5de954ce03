"""Example scenes, built by code: each module's ``scene(width, height)`` returns a Mitsuba dictionary."""
