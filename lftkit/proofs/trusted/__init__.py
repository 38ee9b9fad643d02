"""All that a check of strips trusts of this repository: it imports nothing else of it (a test reads the imports).

What finds scalings, reads files or chooses coordinates is elsewhere: what it gives is checked here.
"""
