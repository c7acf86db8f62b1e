"""The tasks: a module for each, with its `Task` named `TASK`, and `find_task`, which knows them by
name.
"""
