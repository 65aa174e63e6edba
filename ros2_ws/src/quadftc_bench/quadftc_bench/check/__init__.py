"""``quadftc check``: does the theory hold for a scheme in a scenario, or along a recorded run?"""
