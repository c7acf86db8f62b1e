"""The tasks: a module for each with its `Task`, `TASK`; `find_task` knows them by name."""
