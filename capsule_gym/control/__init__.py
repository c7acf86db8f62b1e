"""Control laws inside the step: `Controller`, the laws of this package, and users' own laws."""
