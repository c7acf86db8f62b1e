"""Control laws inside the step: `Controller`, the laws of this package, and laws that users write
in Python.
"""
